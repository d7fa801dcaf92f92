"""A signal has what is held set down where it was taken if there is time and a way, else it stays in the hand."""

from __future__ import annotations

import os
import signal
import time
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin_diagram.runs.learning import ending
from twin_diagram.runs.learning.ending import end_early
from twin_diagram.runs.learning.motion import NoWay, TimedPath, pointing, pose
from twin_diagram.runtime import stopping
from twin_diagram.runtime.stopping import Stopped, stoppable

DOWN = pointing(np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]))


class Arm:
    """An arm whose joint angles are the place of its tool, and its fingers; it notes what it is told."""

    def __init__(self, shut: bool = True, opening: float = 0.05, took: float = 1.0, barred: bool = False) -> None:
        self.done: list[str] = []
        self.commanded, self.shut_at = np.array([0.5, 0.0, 0.4]), np.array([0.4, -0.3, 0.1])
        self.shut, self.opening, self.pace, self.took, self.barred = shut, opening, 1.0, took, barred
        self.wait = 0.0

    def follow(self, times: Any, q: Any) -> None:
        time.sleep(self.wait)
        stopping.check()
        self.commanded = q[-1]
        self.done.append(f"to {np.round(self.commanded, 3).tolist()}")

    def brake(self) -> None:
        self.done.append("brake")

    def grip(self, opened: float, seconds: float) -> float:
        self.done.append("open" if opened else "shut")
        self.opening = 0.1
        return self.opening

    @contextmanager
    def about(self, phase: str, place: Any) -> Any:
        self.done.append(phase)
        yield

    @property
    def tools(self) -> Any:
        mover = SimpleNamespace(
            tool=lambda q: pose(DOWN, q),
            goals=lambda X, q: X[None, :3, 3],
            line=lambda q, X: np.array([q, X[:3, 3]]),
            path=lambda q, goals: np.array([q, goals[0]]),
            bare_free=lambda line, clearance: not self.barred,
            timed=lambda path: TimedPath(np.array([0.0, self.took]), path),
            timed_line=lambda line, speed: TimedPath(np.array([0.0, self.took]), line),
            hold=lambda points: self.done.append("held nothing"),
        )
        cell = SimpleNamespace(wait=lambda seconds: None)
        for name in ("follow", "brake", "grip", "about"):
            setattr(cell, name, getattr(self, name))
        for name in ("commanded", "shut_at", "shut", "opening", "pace"):
            setattr(cell, name, getattr(self, name))
        return SimpleNamespace(cell=cell, mover=mover)


def test_what_is_held_goes_back_to_where_it_was_taken() -> None:
    arm = Arm()
    ended = end_early(arm.tools)
    assert ended.empty and ended.told == "it was set down where it was taken"
    down = np.round(arm.shut_at + [0, 0, ending.TUNING.gap], 3).tolist()
    above = np.round(arm.shut_at + [0, 0, ending.TUNING.gap + ending.TUNING.above], 3).tolist()
    assert arm.done == ["brake", f"to {above}", "release", f"to {down}", "open", "held nothing"]


def test_straight_over_it_the_arm_goes_down_at_once() -> None:
    arm = Arm()
    arm.commanded = arm.shut_at + [0.0, 0.0, 0.15]
    assert end_early(arm.tools).empty
    assert [step for step in arm.done if step.startswith("to")] == ["to [0.4, -0.3, 0.104]"]


@pytest.mark.parametrize("arm", [Arm(shut=False), Arm(opening=0.001)])
def test_an_empty_hand_ends_at_once(arm: Arm) -> None:
    assert end_early(arm.tools).empty and arm.done == ["brake"]


@pytest.mark.parametrize(
    ("arm", "words"), [(Arm(took=30.0), "it is held: to set it down takes 60 s"), (Arm(barred=True), "in the way down")]
)
def test_what_cannot_be_set_down_in_time_or_safely_is_held(arm: Arm, words: str) -> None:
    ended = end_early(arm.tools)
    assert not ended.empty and words in ended.told and "open" not in arm.done


def test_no_way_there_holds_it() -> None:
    arm = Arm()
    tools = arm.tools

    def barred(q: Any, goals: Any) -> Any:
        raise NoWay("no way past what stands about")

    tools.mover.path = barred
    assert end_early(tools).told == "it is held: no way past what stands about"


def test_time_that_runs_out_on_the_way_leaves_it_in_the_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ending, "TUNING", replace(ending.TUNING, spare=-5.0))
    arm = Arm(took=0.01)
    arm.wait = 0.3
    with pytest.raises(Stopped), stoppable():
        try:
            with stopping.steps():
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.01)
                stopping.check()
        finally:
            begun = time.monotonic()
            ended = end_early(arm.tools, within=0.25)
            took = time.monotonic() - begun
    assert "held" in ended.told and not ended.empty and "open" not in arm.done and took < 1.0


def test_what_was_just_taken_may_touch_what_it_lay_on_as_the_arm_comes_to_rest() -> None:
    arm = Arm()
    arm.commanded = arm.shut_at + [0.0, 0.0, 0.02]
    end_early(arm.tools)
    assert arm.done[:2] == ["release", "brake"]
    arm = Arm()
    end_early(arm.tools)
    assert arm.done[0] == "brake", "elsewhere no step asks for a contact"
