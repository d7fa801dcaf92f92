"""Searches in a process of their own: the answers are the same to the bit, and whatever happens to it is told."""

from __future__ import annotations

import logging
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.planning.collision.collision_scene import load_scene
from twin_diagram.planning.paths.guide import Guide, GuideSettings, Question
from twin_diagram.planning.paths.search_process import SearchProcess
from twin_diagram.planning.paths.searching import Here
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.hand import Hand
from twin_diagram.signals.layouts import ObjectStatus, Track

HOME = np.array([0.55, 0.1, 0.0, -2.0, 0.0, 2.1, 1.33])
GOAL = np.array([0.0, 1.0, 0.0, 0.0, 0.5, -0.25, 0.16])
BETWEEN = Track(ObjectStatus.TRACKED, 0.0, np.array([1.0, 0, 0, 0, 0.5, 0.05, 0.25]), np.zeros(6), np.zeros((6, 6)))
QUESTION = Question((0, 5, 1), HOME, GOAL, np.zeros((0, 7)), True, BETWEEN.pack())


class Stuck(Guide):
    """Takes for ever over seed 13, and falls over seed 14."""

    def __reduce__(self):  # type: ignore[no-untyped-def]
        return Stuck, (self.scene, self.settings)

    def answer(self, question: Question):  # type: ignore[no-untyped-def]
        if question.seed[1] == 13:
            time.sleep(600.0)
        if question.seed[1] == 14:
            raise ArithmeticError("the search fell over")
        return super().answer(question)


@pytest.fixture(scope="module")
def guide() -> Guide:
    asset = Asset.load(models_dir() / "objects" / "mover")
    scene = load_scene(scenario.ArmModel(), [scenario.Fixture()], {"mover": asset})
    return Stuck(scene, GuideSettings(np.full(7, 0.8), 0.04, [tuple(asset.convex_pieces)]))


@pytest.fixture
def beside(guide: Guide) -> Iterator[SearchProcess]:
    with SearchProcess(guide, patience=60.0) as searcher:
        yield searcher


def test_answers_are_those_that_are_found_here(guide: Guide, beside: SearchProcess) -> None:
    held = Hand(held=0, X_TO=np.array([1.0, 0, 0, 0, 0, 0, 0.05])).pack().tobytes()
    questions = [replace(QUESTION, seed=(0, k, 1), hand=hand) for k, hand in ((1, b""), (2, b""), (3, held))]
    for question in questions:
        beside.ask(question)
    for question in reversed(questions):
        here, there = Here(guide).answer(question), beside.answer(question)
        assert there is not None and len(there.goals) > 1
        np.testing.assert_array_equal(there.goals, here.goals)
        np.testing.assert_array_equal(there.points, here.points)
        # The same again, and for a copy of the question.
        again = beside.answer(pickle.loads(pickle.dumps(question)))
        assert again is not None and np.array_equal(again.points, there.points)
    chain = guide.scene.chain
    for q in here.goals:
        np.testing.assert_allclose(chain.tool(chain.place(q[None]))[0, :3, 3], GOAL[4:], atol=1e-4)


def ended(searcher: SearchProcess) -> bool:
    deadline = time.monotonic() + 10.0
    while searcher._child.process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    return searcher._child.process.poll() is not None


@pytest.mark.parametrize(
    ("seed", "patience", "told"),
    [(14, 60.0, "the search fell over"), pytest.param(13, 3.0, "within 3 s", marks=pytest.mark.long)],
)
def test_one_that_crashes_or_hangs_is_told_of_in_one_line(
    guide: Guide, seed: int, patience: float, told: str, caplog: pytest.LogCaptureFixture
) -> None:
    with (
        SearchProcess(guide, patience=patience, pauses=()) as searcher,
        caplog.at_level(logging.WARNING, "twin_diagram"),
    ):
        assert searcher.answer(replace(QUESTION, seed=(0, seed, 1))) is None
        assert searcher.answer(QUESTION) is None and not searcher.works()  # nor are there any from then on
        assert ended(searcher)
    assert len(caplog.messages) == 1 and told in caplog.messages[0] and "\n" not in caplog.messages[0]
    assert caplog.messages[0].endswith("the arm brakes")


def waited_for(searcher: SearchProcess) -> bool:
    deadline = time.monotonic() + 10.0
    while not searcher.works() and time.monotonic() < deadline:
        time.sleep(0.01)
    return searcher.works()


@pytest.mark.long
@pytest.mark.parametrize("how", ["killed", "hangs"])
def test_it_is_started_anew_after_pauses_that_grow_and_then_no_more(
    guide: Guide, how: str, caplog: pytest.LogCaptureFixture
) -> None:
    pauses, processes = (0.05, 0.4), []
    with SearchProcess(guide, patience=60.0, pauses=pauses) as searcher, caplog.at_level(logging.WARNING):
        expected = searcher.answer(QUESTION)
        for k in range(3):
            processes.append(searcher._child.process)
            if how == "killed":
                searcher._child.process.kill()
            else:
                searcher._patience = 0.2
            assert searcher.answer(replace(QUESTION, seed=(0, 13, k))) is None
            searcher._patience = 60.0
            assert searcher.ready(QUESTION) and not searcher.works()  # the pause is on
            if k < 2:
                failed_at = time.monotonic()
                assert waited_for(searcher) and time.monotonic() - failed_at > 0.8 * pauses[k]
                assert searcher._child.process.pid != processes[-1].pid and processes[-1].poll() is not None
                again = searcher.answer(replace(QUESTION))
                assert again is not None and expected is not None and np.array_equal(again.points, expected.points)
                assert searcher.answer(replace(QUESTION, more_goals=False)) is not None, "the new one answers"
        time.sleep(0.5)
        assert not searcher.works() and searcher.answer(QUESTION) is None
        assert len(searcher.failures) == 3 and searcher.last_failure == searcher.failures[-1]
    assert all(process.poll() is not None for process in processes)
    assert [("started anew in" in line) for line in caplog.messages] == [True, True, False]
    assert "in 0.05 s" in caplog.messages[0] and "in 0.4 s" in caplog.messages[1]
    assert "3 times in all, it is not started again" in caplog.messages[2]
    assert all(line.endswith("the arm brakes") and "\n" not in line for line in caplog.messages)


def test_one_that_is_closed_is_not_started_anew(guide: Guide) -> None:
    searcher = SearchProcess(guide, pauses=(0.0,))
    searcher.close()
    assert not searcher.works() and searcher._child.process.poll() is not None


def test_one_that_is_killed_is_told_of(beside: SearchProcess, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, "twin_diagram"):
        beside._child.process.kill()
        assert beside.answer(QUESTION) is None
    assert len(caplog.messages) == 1 and "Killed" in caplog.messages[0]


def test_who_does_not_wait_is_told_of_one_that_hangs(guide: Guide, caplog: pytest.LogCaptureFixture) -> None:
    stuck = replace(QUESTION, seed=(0, 13, 1))
    with SearchProcess(guide, waits=False, patience=0.3) as searcher, caplog.at_level(logging.WARNING, "twin_diagram"):
        assert not searcher.ready(stuck), "nobody asked"
        searcher.ask(stuck)
        assert not searcher.ready(stuck)
        time.sleep(0.4)
        assert searcher.ready(stuck) and searcher.answer(stuck) is None
        assert ended(searcher)
    assert len(caplog.messages) == 1 and "within 0.3 s" in caplog.messages[0]


def test_it_ends_with_its_user_however_busy_it_is(guide: Guide, caplog: pytest.LogCaptureFixture) -> None:
    with SearchProcess(guide) as searcher:
        searcher.ask(replace(QUESTION, seed=(0, 13, 1)))
        begin = time.monotonic()
    assert searcher._child.process.poll() is not None and time.monotonic() - begin < 2.0
    assert not caplog.messages  # that is no failure


@pytest.mark.long
def test_who_does_not_wait_is_told_whether_an_answer_is_there(guide: Guide) -> None:
    with SearchProcess(guide, waits=False, patience=60.0) as searcher:
        assert not searcher.ready(QUESTION)
        searcher.ask(QUESTION)
        deadline = time.monotonic() + 60.0
        while not searcher.ready(QUESTION) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert searcher.ready(QUESTION) and searcher.answer(QUESTION) is not None
        assert not searcher.ready(replace(QUESTION, seed=(0, 9, 1)))
        searcher._child.process.kill()
        searcher.ask(replace(QUESTION, seed=(0, 9, 1)))
        while not searcher.ready(replace(QUESTION, seed=(0, 9, 1))) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert searcher.answer(replace(QUESTION, seed=(0, 9, 1))) is None  # braked, and nobody waits


PARENT = """
import sys, time
from tests.planning.paths.test_search_process import *
asset = Asset.load(models_dir() / "objects" / "mover")
scene = load_scene(scenario.ArmModel(), [scenario.Fixture()], {"mover": asset})
guide = Stuck(scene, GuideSettings(np.full(7, 0.8), 0.04))
searcher = SearchProcess(guide)
searcher.ask(replace(QUESTION, seed=(0, 13, 1)))
print(searcher._child.process.pid, flush=True)
time.sleep(600)
"""


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_it_does_not_outlive_its_starter(number: signal.Signals) -> None:
    parent = subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    time.sleep(0.5)
    parent.send_signal(number)
    parent.wait(20.0)
    deadline = time.monotonic() + 20.0
    while alive(child) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not alive(child)


def alive(number: int) -> bool:
    """Whether a process runs; one that has ended and that nobody asked after does not."""
    try:
        os.kill(number, 0)
        with open(f"/proc/{number}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except (ProcessLookupError, FileNotFoundError):
        return False
