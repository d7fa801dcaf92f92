"""Currents become torques by constants that somebody tells, and by nothing else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin_diagram.errors import LogError
from twin_diagram.logs import Log, log_from_columns
from twin_diagram.logs.torque_constants import torque_constants


def currents() -> Log:
    columns = {"time": np.arange(20) / 100.0}
    for k, joint in enumerate(("a", "b")):
        columns[f"position_measured.{joint}"] = np.linspace(0.0, 1.0, 20)
        columns[f"current_measured.{joint}"] = np.full(20, 1.0 + k)
    return log_from_columns(columns, "log", str)


def test_currents_are_no_torques_until_constants_are_told() -> None:
    log = currents()
    with pytest.raises(LogError, match="holds currents; --torque-constants"):
        _ = log.motor_torque
    for given in (["3", "5"], ["3,5"], ["b=5", "a=3"]):
        torque = torque_constants(given).applied(log, ("a", "b")).motor_torque
        np.testing.assert_array_equal(torque[0], [3.0, 10.0])
    np.testing.assert_array_equal(torque_constants(["5", "3"]).applied(log, ("b", "a")).motor_torque[0], [3.0, 10.0])


def test_constants_are_read_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "constants.yaml"
    for text in ("[3, 5]", "{a: 3.0, b: 5}"):
        file.write_text(text)
        np.testing.assert_array_equal(torque_constants([str(file)]).of(("a", "b")), [3.0, 5.0])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["1", "2", "3"], "3 given; the arm has 2: a, b"),
        (["a=1", "c=2"], "'c' is no joint of the arm"),
        (["a=1"], "b is missing"),
        (["1", "x"], "'x' is no torque constant"),
        (["1", "0"], "'0' is no torque constant"),
        (["a=1", "b=nan"], "b: 'nan' is no torque constant"),
        (["none.yaml"], "No such file"),
        ([","], "is a list of numbers"),
    ],
)
def test_what_cannot_be_is_said_in_a_line(given: list[str], said: str) -> None:
    with pytest.raises(LogError, match=said):
        torque_constants(given).of(("a", "b"))


def test_where_there_are_torques_currents_are_left_out() -> None:
    columns = currents().columns() | {"current_measured.a": np.ones(20), "current_measured.b": np.ones(20)}
    log = log_from_columns(columns, "log", str)
    assert not log.currents and log.motor_torque[0, 1] == 2.0
