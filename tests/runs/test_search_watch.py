"""A run whose search for ways is killed or hangs: the arm brakes, it is told in one line, and the arm goes on."""

from __future__ import annotations

import json
import logging
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import Context

from twin_diagram import scenario
from twin_diagram.planning.paths import search_process
from twin_diagram.runs import run_scenario
from twin_diagram.runs.run_folder import EVENTS
from twin_diagram.runs.search_watch import SearchWatch

HOME = [0.55, 0.1, 0.0, -2.0, 0.0, 2.1, 1.33]
GOAL = scenario.Pose([0.5, -0.25, 0.2], [np.pi, 0.0, 0.0])
WALL = """<sdf version="1.9"><model name="wall"><link name="wall">
<collision name="wall"><geometry><box><size>0.3 0.02 0.35</size></box></geometry></collision></link></model></sdf>"""


def behind_a_wall(folder: Path) -> scenario.Scenario:
    """The demo's arm, blind, and a goal behind a wall, so that the way must be searched for."""
    plan = scenario.Scenario(seed=3, duration=3.6)
    plan.twin.camera, plan.world.objects, plan.twin.library = None, {}, {}
    plan.twin.home = list(HOME)
    (folder / "wall.sdf").write_text(WALL)
    table, wall = scenario.Fixture(), scenario.Fixture(str(folder / "wall.sdf"), scenario.Pose([0.55, 0.0, 0.175]))
    plan.twin.fixtures, plan.world.fixtures = [table, wall], [table, wall]
    plan.twin.task = scenario.Task(X_WG=GOAL, start=0.3)
    return plan


class Struck:
    """Ends or stops the process that searches at a time, and notes which processes there were and how the arm went."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, number: signal.Signals | None, when: float) -> None:
        self.processes: dict[int, Any] = {}
        self.speed: list[tuple[float, bool, float]] = []
        poll, struck = SearchWatch.poll, []

        def polled(watch: SearchWatch, context: Context) -> None:
            mpc = watch._twin.mpc
            assert mpc is not None
            process = mpc.planner.searcher._child.process  # type: ignore[attr-defined]
            self.processes[process.pid] = process
            if number is not None and not struck and context.get_time() >= when:
                struck.append(True)
                process.send_signal(number)
            poll(watch, context)
            own = watch._twin.diagram.GetMyContextFromRoot(context)
            own = watch._twin.diagram.GetSubsystemContext(mpc, own)
            memory, now = mpc.memory(own), context.get_time()
            v = memory.trajectory.at(np.array([now]))[1]
            self.speed.append((now, memory.braked, float(np.abs(v).max())))

        monkeypatch.setattr(SearchWatch, "poll", polled)


@pytest.mark.long
@pytest.mark.parametrize(("number", "told"), [(signal.SIGKILL, "Killed"), (signal.SIGSTOP, "within 8 s")])
def test_the_arm_brakes_is_told_of_and_goes_on(
    number: signal.Signals, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    quick = replace(search_process.TUNING, patience=8.0, beginning=8.0, pauses=(0.3, 0.6))
    monkeypatch.setattr(search_process, "TUNING", quick)
    struck = Struck(monkeypatch, number, 0.2)
    with caplog.at_level(logging.WARNING, "twin_diagram"):
        out, plan = tmp_path / "out", behind_a_wall(tmp_path)
        summary = run_scenario(plan, out=out, pictures=False, quiet=True, say=lambda line: None)
    events = [json.loads(line) for line in (out / EVENTS).read_text().splitlines()]
    searches = [event for event in events if event["event"].startswith("search_")]
    assert [event["event"] for event in searches] == ["search_failed", "search_resumed"]
    assert told in searches[0]["why"] and searches[1]["after_s"] > 0.0
    (lack,) = (lack for lack in summary["health"] if lack["reason"] == "search_failed")
    assert lack["what"] == searches[0]["why"] and lack["first"] == searches[0]["time"] <= lack["last"]
    (line,) = (line for line in caplog.messages if "searches for ways" in line)
    assert told in line and line.endswith("it is started anew in 0.3 s, the arm brakes")
    assert len(struck.processes) == 2 and all(process.poll() is not None for process in struck.processes.values())
    assert max(speed for _, braked, speed in struck.speed if braked) < 0.02, "it rests while nothing searches"
    assert max(speed for now, _, speed in struck.speed if now > searches[1]["time"]) > 0.2, "and goes on"
    assert summary["contacts"] == 0
