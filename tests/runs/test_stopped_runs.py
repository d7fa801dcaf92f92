"""Runs that are stopped or killed: what was recorded is there and replays, and nothing goes on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import twin_diagram
from tests.small_loop import small_scenario
from twin_diagram.logs import read_log
from twin_diagram.runs import replay_log, run_scenario
from twin_diagram.runs import run as runs
from twin_diagram.runs.many_seeds import run_one
from twin_diagram.runs.run_folder import EVENTS
from twin_diagram.scenario import ArmModel, EffectSpec, Healing, Scenario
from twin_diagram.scenario.file import load_scenario, save_scenario
from twin_diagram.station.replay.recording_folder import FILES, MESSAGES, UNFINISHED

UR5E = {"model": "arms/ur5e.urdf", "tool_frame": "tool0"}
FOR_EVER = 1000.0


def pushed(duration: float = FOR_EVER) -> Scenario:
    """A UR5e at rest that is pushed after 0.8 s, which its model does not know, so that it looks for what it lacks."""
    plan = Scenario(seed=1001, duration=duration)
    push = EffectSpec("external_force", [], ["wrist_3_link"], {"wrench": [0.0, 0.0, 0.0, 0.0, 0.0, -60.0]}, onset=0.8)
    plan.twin.arm, plan.world.arm = ArmModel(**UR5E), ArmModel(**UR5E, effects=[push])
    plan.twin.home, plan.twin.camera = [0.0, -1.3, 1.4, -1.6, -1.4, 0.0], None
    plan.twin.drift.learning_time = 0.4
    plan.twin.planner.rate = 1.0
    plan.world.objects, plan.world.fixtures = {}, []
    return plan


SEARCH = """
    import sys
    from twin_diagram.twin.healing import gap_process
    # It neither looks for its end nor heeds a plain request for it.
    gap_process.WORKER = (sys.executable, "-c", "import os, pathlib, signal, sys, time; "
        "[signal.signal(n, signal.SIG_IGN) for n in (2, 15)]; "
        "pathlib.Path('pid').write_text(str(os.getpid())); time.sleep(1000)")
"""
REGISTRATION = """
    import pathlib, time
    from twin_diagram.perception.registration import pose_system
    def update(self, context, discrete):
        pathlib.Path("pid").write_text("0")
        while context.get_time() > 0.2:
            time.sleep(0.01)
    pose_system.IcpPoseEstimator._update = update
"""
COMMAND = """
    import sys
    from twin_diagram import cli
    sys.exit(cli.main())
"""


def start(place: Path, plan: Scenario, *argv: str, before: str = "") -> subprocess.Popen[str]:
    save_scenario(plan, place / "plan.yaml")
    environment = {**os.environ, "PYTHONPATH": str(Path(twin_diagram.__file__).parents[1])}
    script = textwrap.dedent(before) + textwrap.dedent(COMMAND)
    command = [sys.executable, "-c", script, "run", "plan.yaml", "--record", "recording", *argv]
    return subprocess.Popen(
        command, cwd=place, env=environment, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def until(process: subprocess.Popen[str], there: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120.0
    while not there():
        assert process.poll() is None and time.monotonic() < deadline, process.communicate()
        time.sleep(0.02)


def messages(place: Path) -> int:
    """How many are written."""
    file = place / "recording" / UNFINISHED / MESSAGES
    return file.read_bytes().count(b"\n") if file.is_file() else 0


def ended(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def replayed(place: Path) -> dict[str, Any]:
    return replay_log(place / "recording", say=lambda text: None)


@pytest.mark.parametrize(
    ("number", "status", "log"),
    [(signal.SIGINT, 130, "log.csv"), pytest.param(signal.SIGTERM, 143, "log.npz", marks=pytest.mark.slow)],
)
def test_a_stopped_run_closes_all_that_is_open(number: int, status: int, log: str, tmp_path: Path) -> None:
    """While a search goes on that the run waits for."""
    plan = pushed()
    plan.twin.healing = Healing(seconds=0.4, answer_after=0.1, nice=0, patience=FOR_EVER)
    process = start(tmp_path, plan, "--out", "out", "--log", log, before=SEARCH)
    until(process, lambda: (tmp_path / "pid").is_file() and (tmp_path / "pid").read_text() != "")
    time.sleep(0.5)
    process.send_signal(number)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err.splitlines()[-1]) == (status, "stopped")
    assert ended(int((tmp_path / "pid").read_text()))
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["stopped"] is True and 1.0 < summary["duration_s"] < 100.0
    events = [json.loads(line)["event"] for line in (tmp_path / "out" / EVENTS).read_text().splitlines()]
    assert "gap_started" in events and events[-1] == "gap_stopped"
    recorded = read_log(tmp_path / "recording" / "log.csv")
    assert np.array_equal(read_log(tmp_path / log).columns()["time"], recorded.time)
    assert recorded.time[-1] > summary["duration_s"] - 0.02
    assert not (tmp_path / "recording" / UNFINISHED).exists()
    duration = load_scenario(tmp_path / "recording" / "scenario.yaml").duration
    assert duration == pytest.approx(summary["duration_s"], abs=0.11)
    assert replayed(tmp_path)["time_s"] == duration


@pytest.mark.long
def test_a_registration_is_broken_off(egl: None, tmp_path: Path) -> None:
    plan = small_scenario(f"duration={FOR_EVER}", objects=("can",))
    process = start(tmp_path, plan, "--out", "out", before=REGISTRATION)
    until(process, lambda: messages(tmp_path) > 70)
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 130
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["stopped"] is True
    assert (tmp_path / "recording" / "log.csv").is_file()


def killed(place: Path, plan: Scenario, seconds: float) -> None:
    """A run that is killed so long after its first message, and what its recording must then be."""
    process = start(place, plan)
    until(process, lambda: messages(place) > 1)
    time.sleep(seconds)
    count = messages(place) - 1
    process.kill()
    process.communicate()
    before = (place / "recording" / UNFINISHED / MESSAGES).read_text().splitlines()
    assert len(before) - 1 >= count
    last = float(before[-1].split(",")[1])
    assert replayed(place)["time_s"] > last - 0.02


@pytest.mark.long
def test_a_killed_run_replays_to_its_last_message(egl: None, tmp_path: Path) -> None:
    plan = small_scenario(f"duration={FOR_EVER}", objects=("can",))
    killed(tmp_path, plan, 1.0)
    killed(tmp_path, pushed(), 0.1)  # into the same folder


@pytest.mark.slow
def test_runs_killed_at_twenty_random_times_replay(egl: None, tmp_path: Path) -> None:
    plan = small_scenario(f"duration={FOR_EVER}")
    for seconds in np.random.default_rng(18).uniform(0.0, 8.0, 20):
        killed(tmp_path, plan, seconds)


def test_in_a_process_of_ones_own_ctrl_c_closes_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from twin_diagram.twin.healing import Healer

    def interrupt(self: Healer, context: Any) -> None:
        if context.get_time() > 0.3:
            raise KeyboardInterrupt

    monkeypatch.setattr(Healer, "poll", interrupt)
    for name in ("first", "second"):
        paths = {"out": tmp_path / "out", "record": tmp_path / "rec", "log": tmp_path / f"{name}.csv"}
        with pytest.raises(KeyboardInterrupt):
            run_scenario(pushed(1.0), **paths, quiet=True, say=lambda text: None)
        assert read_log(tmp_path / f"{name}.csv").time[-1] == pytest.approx(0.3, abs=0.03)
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["stopped"] is True
    assert (tmp_path / "first.csv").read_bytes() == (tmp_path / "rec" / "log.csv").read_bytes()
    listed = (tmp_path / "rec" / FILES).read_text().splitlines()
    assert {*listed, FILES} == {path.name for path in (tmp_path / "rec").iterdir()}


def test_a_run_that_is_stopped_before_it_began(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("twin_diagram.runs.run.make_closed_loop", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run_scenario(pushed(1.0), out=tmp_path / "out", record=tmp_path / "rec", log=tmp_path / "log.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert json.loads((tmp_path / "out" / "summary.json").read_text()) == {"stopped": True}


def test_a_seed_that_was_stopped_runs_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twin_diagram.runs.many_seeds.run_scenario", lambda *_, **__: {"again": True})
    folder = tmp_path / "seed_0001"
    folder.mkdir()
    task = ("tabletop", [], 1, str(folder))
    for summary, found in (({"seed": 1}, {"seed": 1}), ({"stopped": True}, {"again": True})):
        (folder / "summary.json").write_text(json.dumps(summary))
        assert run_one(task) == found


def test_what_was_not_picked_up_yet_when_a_run_was_stopped_is_not_carried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "summarize", lambda record, **figures: figures)
    plan = Scenario(duration=5.0)
    plan.world.arm.effects = [EffectSpec("payload", parameters={"mass": [0.8]}, onset=2.0)]
    for stop, end, carried in ((None, 5.0, 0.8), (KeyboardInterrupt(), 1.0, 0.0), (KeyboardInterrupt(), 3.0, 0.8)):
        trial: Any = SimpleNamespace(stop=stop, record=SimpleNamespace(time=np.array([0.0, end])))
        loop: Any = SimpleNamespace(scenario=plan)
        figures = runs.summary_of(loop, trial, {})
        assert figures["duration"] == end
        assert figures["payload_true"] == carried
