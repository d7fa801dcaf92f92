"""What cannot be learned in is refused at the start, in one line that names the field."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from twin_diagram.errors import ScenarioError
from twin_diagram.runs.learning.start import check_cell
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.file import load_scenario


def changed(*overrides: str) -> Scenario:
    return load_scenario("bin_picking", overrides)


def test_the_scenario_that_comes_along_can_be() -> None:
    learning = check_cell(changed().twin)
    assert learning.bin_camera == "bin" and learning.tries == 3


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: check_cell(changed("twin.learning=null").twin), "twin.learning: is missing"),
        (lambda: check_cell(changed("twin.cameras.bin.X_WC.translation=[0.4, 0.9, 0.9]").twin), "not see the bin"),
        (lambda: check_cell(changed("twin.cameras.scan.X_WC.rpy=[0.0, 0.0, 0.0]").twin), "not see the platform"),
        (
            lambda: check_cell(changed("twin.learning.scan_camera=other").twin),
            "scan_camera.*none of twin.cameras: bin, scan",
        ),
        (lambda: check_cell(changed("twin.learning.from_bin=[[1, 1, 1], [0, 0, 0]]").twin), "twin.learning.from_bin"),
        (lambda: check_cell(changed("twin.learning.tries=0").twin), "twin.learning.tries"),
    ],
)
def test_refusals(make: Callable[[], object], words: str) -> None:
    with pytest.raises(ScenarioError, match=words) as error:
        make()
    assert "\n" not in str(error.value)


def test_the_command_ends_with_2_and_writes_nothing(tmp_path: Path) -> None:
    out = tmp_path / "run"
    command = [sys.executable, "-m", "twin_diagram", "learn", "tabletop", "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 and done.stderr.startswith("error: twin.learning") and done.stderr.count("\n") == 1
    assert not out.exists()
