"""A run of learning that a signal or a kill ends: what is held is set down in time, and the run goes on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin_diagram
from twin_diagram.assets import Asset
from twin_diagram.runs.learning.drawn_bins import draw_bin
from twin_diagram.runs.learning.record import LearningRecord
from twin_diagram.scenario.file import dump_scenario, load_scenario

KILLS = 20
"""In a row."""
LONGEST = 60.0
"""Processor time [s] within which a kill comes at first: enough for an object on an idle machine."""
LONGER = 1.5
"""By which that grows with five kills before which nothing was finished: on a busy machine a second does less."""
IDLE = 600.0
"""A run that needs no processor for so long [s] waits in vain: reconstructions beside it take a minute of one."""
pytestmark = pytest.mark.slow


def begin(out: Path, *more: str, scenario: str = "bin_picking") -> subprocess.Popen[str]:
    environment = {**os.environ, "PYTHONPATH": str(Path(twin_diagram.__file__).parents[1])}
    command = [sys.executable, "-m", "twin_diagram", "learn", scenario, "--out", str(out), *more]
    return subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environment)


def until(process: subprocess.Popen[str], words: str) -> None:
    assert process.stderr is not None
    for line in process.stderr:
        if words in line:
            return
    pytest.fail(f"it ended before {words!r}: status {process.wait()}")


def events(out: Path) -> list[dict[str, Any]]:
    text = (out / "events.jsonl").read_text()
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]  # of a kill half a line may be left


def test_a_signal_has_what_is_held_set_down_and_the_run_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "run"
    process = begin(out)
    until(process, "display ·")
    time.sleep(4.0)
    begun = time.monotonic()
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=30.0)
    assert process.returncode == 130 and time.monotonic() - begun < 10.0
    last = events(out)[-1]
    assert last["stage"] == "stop"
    if last["outcome"] != "it was set down where it was taken":
        assert last["outcome"].startswith("it is held: "), "on a busy machine there is no time"
    # Killed in the midst of the next try: nothing is half-written, and what lay in the bin lies there.
    process = begin(out, "--resume")
    until(process, "pick ·")
    time.sleep(np.random.default_rng(0).uniform(0.0, 5.0))
    process.kill()
    process.communicate()
    assert (out / "state.npz").is_file() and not list(out.glob(".*"))
    process = begin(out, "--resume")
    until(process, "display ·")  # it was found in its bin, and taken
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=30.0)
    assert process.returncode == 143


def at_work(folder: Path) -> list[str]:
    """Processes whose command line names a folder."""
    told = [file.read_bytes() for file in Path("/proc").glob("[0-9]*/cmdline") if file.exists()]
    return [line.decode(errors="replace") for line in told if str(folder).encode() in line]


def spent(process: subprocess.Popen[str]) -> float:
    """Processor time of a run [s], of those of its children with it that have ended."""
    told = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, told[11:15])) / os.sysconf("SC_CLK_TCK")


def ended_within(process: subprocess.Popen[str], seconds: float) -> bool:
    """Whether a run ends by itself within so much processor time: by the clock a busy machine takes any time for it."""
    used, since = 0.0, time.monotonic()
    while True:
        try:
            process.communicate(timeout=0.2)
            return True
        except subprocess.TimeoutExpired:
            now = spent(process)
        if now >= seconds:
            return False
        if now > used + 0.1:
            used, since = now, time.monotonic()
        assert time.monotonic() - since < IDLE, "it waits for something that does not come"


def killed(process: subprocess.Popen[str], seconds: float) -> bool:
    """Kill a run after so much processor time; whether it was still at work."""
    if ended_within(process, seconds):
        assert process.returncode == 0, "it ended by itself, and not well"
        return False
    process.kill()
    process.communicate()
    return True


def finished_in(out: Path, scenario: Path) -> dict[str, Any]:
    """The figures of what a run has finished, each with an asset that can be read."""
    if not (out / "state.npz").is_file():
        return {}
    state = LearningRecord(out, load_scenario(str(scenario)))._read_state()
    found = {one.name: one.figures for one in state.learned if one.state == "finished"}
    assert all(Asset.load(out / "library" / name).mass > 0.0 for name in found)
    return found


def test_runs_that_are_killed_at_drawn_times_lose_nothing_that_was_finished(tmp_path: Path) -> None:
    """Twenty kills in a row: into picks, displays, what is put away, reconstructions and the start; then to the end."""
    quick = ["grasps=1", "most_grasps=1", "weigh_seconds=0.0", "frames=8", "turn_speed=2.0"]
    scenario = draw_bin(load_scenario("bin_picking", [f"twin.learning.{one}" for one in quick]), 2, 2)
    file, rng = tmp_path / "bin.yaml", np.random.default_rng(7)
    file.write_text(dump_scenario(scenario))
    kills, most, longest = 0, 0, LONGEST
    while kills < KILLS:
        out, finished, at_its_end = tmp_path / f"run_{kills}", dict[str, Any](), False
        while kills < KILLS and not at_its_end:
            process = begin(out, *(["--resume"] if (out / "state.npz").is_file() else []), scenario=str(file))
            at_its_end = not killed(process, rng.uniform(3.0, longest))
            kills += not at_its_end
            time.sleep(1.0)
            assert not at_work(out), "what it started ends with it"
            now = finished_in(out, file)
            assert {name: now.get(name) for name in finished} == finished, "a finished object was lost, or made anew"
            finished, most = now, max(most, 0 if at_its_end else len(now))
            longest *= LONGER if not most and kills % 5 == 0 else 1.0
        process = begin(out, *(["--resume"] if (out / "state.npz").is_file() else []), scenario=str(file))
        assert ended_within(process, 600.0) and process.returncode == 0
        assert sorted(finished_in(out, file)) == ["object_01", "object_02"]
        assert not list(out.glob(".*")) and not list((out / "library").glob(".*"))
    assert most, "no kill came after something was finished"
