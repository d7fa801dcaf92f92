"""What goes with a bare log is refused beside a recording, which names its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from twin_diagram.errors import TwinError
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
