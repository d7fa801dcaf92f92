"""The scenario of a replay: of a recording, or of a bare log with a model of its arm.

Cheap to import, so that a log that is not there is told at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from twin_diagram import scenario as schema
from twin_diagram.errors import TwinError, expect_path
from twin_diagram.logs import read_log
from twin_diagram.logs.torque_constants import torque_constants
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.file import load_scenario, override_scenario


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    shortest: float = 1e-3
    """Run of a recording that was killed at its first message [s]: a scenario lasts for some time."""


TUNING = Tuning()


def replay_scenario(
    log: str | Path,
    model: str | None = None,
    overrides: Iterable[str] = (),
    columns: str | Path | None = None,
    joints: Sequence[str] = (),
    constants: Sequence[str] = (),
) -> Scenario:
    """Return the scenario that replays a recording, or a bare log with a model of its arm.

    Args:
        log: folder of a recording, or a measured log.
        model: of a bare log's arm.
        overrides: of the scenario's fields, `field=value`.
        columns: what a bare log's columns mean, see `read_log`.
        joints: of one arm, in order, of a robot that has more; empty: all.
        constants: of the motors, where a bare log holds currents, see `torque_constants`.

    Raises:
        TwinError: no such log, or what goes with the other kind.
    """
    expect_path(log, "log", "a recording or a measured log")
    log = Path(log)
    if not log.exists():
        raise TwinError(f"{log}: no such recording or log")
    from twin_diagram.station.replay.reading import recorded_until
    from twin_diagram.station.replay.recording_folder import SCENARIO_FILE, place_of

    overrides = list(overrides)
    if log.is_dir():
        place = place_of(log)
        if not (place / SCENARIO_FILE).is_file():
            raise TwinError(f"{log}: no recording: it has no {SCENARIO_FILE}")
        for option, told in (("--model", model), ("--columns", columns), ("--joints", joints or None)):
            if told is not None:
                raise TwinError(f"{option} goes with a bare log; {log} is a recording and names its own")
        if constants:
            raise TwinError(f"--torque-constants goes with a bare log; {log} is a recording and holds torques")
        scenario = load_scenario(place / SCENARIO_FILE)
        if place != log:  # its run was killed
            scenario.duration = min(scenario.duration, max(recorded_until(place), TUNING.shortest))
        scenario = override_scenario(scenario, overrides)
    else:
        if model is None:
            raise TwinError(f"{log}: a bare log needs --model, the arm's description")
        arm = schema.ArmModel(model=str(model), tool_frame="", joints=list(joints))
        measured = read_log(log, columns)
        driver = schema.Driver(rate=1.0 / measured.period)
        twin = schema.Twin(arm=arm, camera=None, driver=driver)
        scenario = schema.Scenario(twin=twin, duration=float(measured.time[-1] - measured.time[0]))
        if columns is not None:
            scenario.replay.columns = str(Path(columns).resolve() if Path(columns).exists() else columns)
        if constants:
            torque_constants(constants)  # what is no number is told at once
            scenario.replay.torque_constants = [str(Path(c).resolve()) if Path(c).is_file() else c for c in constants]
        scenario = override_scenario(scenario, overrides)
    scenario.station = "replay"
    scenario.replay.log = str(log.resolve())
    return scenario
