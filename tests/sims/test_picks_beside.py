"""`sims/benchmarks/picks_beside.py`: what stands beside is near, in the world, and in nobody's library."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

from twin_diagram import load_scenario
from twin_diagram.runs.drawn_picks import draw_picks

BENCHMARKS = Path(__file__).resolve().parents[2] / "sims" / "benchmarks"


@pytest.mark.parametrize("seed", range(4))
def test_what_stands_beside_is_near_and_unknown(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    benchmark = importlib.import_module("picks_beside")
    base = load_scenario("pick_and_place")
    plan, told = benchmark.draw(base, seed)
    name, plain = told.split()[0], draw_picks(base, seed)
    target = plan.twin.task.steps[0].object
    assert name in plan.world.objects and name not in plan.twin.library and target in plan.twin.library
    apart = np.subtract(*(plan.world.objects[key].X_WO.translation[:2] for key in (target, name)))
    assert 0.06 < np.linalg.norm(apart) < 0.17, "within the reach of a hand"
    assert plan.world.objects[target].X_WO == plain.world.objects[target].X_WO
    assert benchmark.draw(base, seed)[1] == told
