"""`sims/benchmarks/open_loop_picks.py`: what a blind arm does at less than full speed, and how it is counted."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twin_diagram.planning.paths.time_optimal import profile
from twin_diagram.planning.tasks.step_state import Phase, TaskState

BENCHMARKS = Path(__file__).resolve().parents[2] / "sims" / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module


def test_slower_ways_are_the_same_ways_and_fingers_keep_their_time(benchmark: Any) -> None:
    Script = benchmark("picking_blind.script").Script
    points = np.array([[0.0, 0.0], [0.4, -0.2], [0.5, 0.3]])
    there = profile(points, np.full(2, 1.0), np.full(2, 4.0))
    back = profile(points[::-1], np.full(2, 1.0), np.full(2, 4.0))
    closes, sets_off = there.duration, there.duration + 0.35
    script = Script(points[0], [(0.0, there), (sets_off, back)])
    script.states = [
        (0.0, TaskState()),
        (closes, TaskState(phase=Phase.CLOSE)),
        (sets_off, TaskState(phase=Phase.LIFT)),
    ]
    script.took = sets_off + back.duration

    half = script.stretched(0.5)
    assert half.took == pytest.approx(2 * there.duration + 0.35 + 2 * back.duration)
    for time in np.linspace(0.0, there.duration, 12):
        np.testing.assert_allclose(half.at(2 * time), script.at(time), atol=1e-12)
    for time in np.linspace(0.0, back.duration, 12):
        np.testing.assert_allclose(half.at(half.ways[1][0] + 2 * time), script.at(sets_off + time), atol=1e-12)
    assert half.state_at(2 * closes - 0.01).phase is Phase.START
    assert half.state_at(2 * closes + 0.01).phase is Phase.CLOSE
    assert half.state_at(2 * closes + 0.36).phase is Phase.LIFT
    np.testing.assert_array_equal(script.stretched(1.0).at(0.7), script.at(0.7))


def test_the_fastest_that_mostly_succeeds_is_what_the_twin_is_set_beside(benchmark: Any) -> None:
    told = benchmark("open_loop_picks").told
    fails, slow, quick = (False, 3.0, 2), (True, 10.0, 0), (True, 6.0, 0)
    results = {"50 %": [slow, slow], "75 %": [quick, quick], "100 %": [fails, (True, 3.0, 0)], "twin": [(True, 3.0, 0)]}
    lines = told(results).splitlines()
    assert lines[2].split()[:5] == ["100", "%", "1", "of", "2"] and lines[2].endswith("100 collisions in 100 runs")
    assert lines[-1].startswith("the twin takes 50 % less time")
    assert told({"100 %": [fails], "twin": [quick]}).endswith("no blind arm succeeds in 82 %")


@pytest.mark.slow
def test_one_table() -> None:
    command = [
        sys.executable,
        str(BENCHMARKS / "open_loop_picks.py"),
        "--first",
        "40",
        "--seeds",
        "1",
        "--speeds",
        "100",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1500, check=True)
    assert "100 %  1 of 1" in done.stdout and "twin  1 of 1" in done.stdout, done.stdout
