"""Torques of another sign or unit are said to be such before anything is fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.gap.made import ARM, record, swing
from twin_diagram.errors import LogError
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.torque_sense import checked


def scaled(factor: float | np.ndarray) -> Records:
    """A log with friction, its torques times something."""
    _, _, v, _ = motion = swing(5.0)
    made = record(ARM, *motion, extra=2.0 * np.sign(v) + 3.0 * v)
    return Records(ARM, (replace(made, torque=made.torque * factor),))


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (-1.0, "opposite sign of those that the description needs"),
        (1e3, "it looks like mN·m"),
        (1e-3, "it looks like kN·m"),
        (0.01, "before the gear, or currents"),
    ],
)
def test_another_sign_or_unit_is_refused(factor: float, said: str) -> None:
    with pytest.raises(LogError, match=said):
        checked(scaled(factor))


def test_an_arm_that_is_described_wrongly_is_no_wrong_unit() -> None:
    for factor in (1.0, 0.5, 3.0):
        assert checked(scaled(factor)) == []
    (odd,) = checked(scaled(0.1))
    assert "if they are currents" in odd


def test_a_single_joint_of_the_other_sign_is_named() -> None:
    sign = np.ones(6)
    sign[2] = -1.0
    (odd,) = checked(scaled(sign))
    assert "the torque of elbow_joint has the opposite sign" in odd


def test_an_arm_that_hangs_is_no_wrong_sign() -> None:
    """Gravity pulls the other way, but friction still takes power."""
    time, q, v, a = swing(5.0)
    made = record(ARM, time, q, v, a)
    rest = ARM.inverse_dynamics(q, 0.0 * v, 0.0 * a, time=time)
    hanging = made.torque - 2.0 * rest + 2.0 * np.sign(v) + 3.0 * v
    checked(Records(ARM, (replace(made, torque=hanging),)))
