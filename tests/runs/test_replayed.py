"""What goes with a bare log is refused beside a recording, which names its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twin_diagram.errors import TwinError
from twin_diagram.logs import write_columns
from twin_diagram.runs import replay_log, run
from twin_diagram.runs.replayed import replay_scenario
from twin_diagram.station.replay.recording_folder import SCENARIO_FILE


@pytest.mark.parametrize(
    ("option", "told"),
    [
        ("--model", {"model": "arms/panda.urdf"}),
        ("--columns", {"columns": "libfranka"}),
        ("--joints", {"joints": ["panda_joint1"]}),  # it was passed over in silence
        ("--torque-constants", {"constants": ["1.0"]}),
    ],
)
def test_what_a_recording_names_itself_is_refused(option: str, told: dict[str, Any], tmp_path: Path) -> None:
    (tmp_path / SCENARIO_FILE).write_text("duration: 1.0\n")
    assert replay_scenario(tmp_path).station == "replay"
    with pytest.raises(TwinError, match=f"{option} goes with a bare log"):
        replay_scenario(tmp_path, **told)


def test_python_takes_all_that_the_command_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Currents, and one arm of several, could be replayed by the command alone."""
    path = tmp_path / "log.csv"
    names = [f"{signal}.{joint}" for signal in ("position_measured", "current_measured") for joint in ("a", "b")]
    write_columns({"time": np.arange(50) / 250.0, **{name: np.zeros(50) for name in names}}, path)
    monkeypatch.setattr(run, "run_scenario", lambda scenario, **how: {"scenario": scenario})
    scenario = replay_log(path, model="arm.urdf", joints=["b"], constants=["b=2.5"])["scenario"]
    assert scenario.twin.arm.joints == ["b"] and scenario.replay.torque_constants == ["b=2.5"]
