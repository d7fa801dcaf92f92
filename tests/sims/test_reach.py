"""`sims/reach.py`: a run is read back where it is of what is asked, and made anew where it is not."""

from __future__ import annotations

import importlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from twin_diagram import load_scenario

SIMS = Path(__file__).resolve().parents[2] / "sims"


def test_a_run_of_another_scenario_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was read back whatever was asked for: `--set` seemed to change nothing."""
    monkeypatch.syspath_prepend(str(SIMS))
    reach = importlib.import_module("reach")
    runs: list[float] = []

    def run_scenario(scenario: Any, out: Path, **how: Any) -> dict[str, Any]:
        runs.append(scenario.duration)
        done = {"duration_s": scenario.duration}
        out.mkdir(exist_ok=True)
        (out / "summary.json").write_text(json.dumps(done))
        return done

    monkeypatch.setattr(reach, "draw_reach", lambda base, seed: base)
    monkeypatch.setattr(reach, "run_scenario", run_scenario)
    for seconds in (0.5, 0.5, 0.7, 0.7):
        base = load_scenario("tabletop", [f"duration={seconds}"])
        assert reach.run(base, 3, tmp_path / "3") == {"duration_s": seconds}
    assert runs == [0.5, 0.7]


def test_goals_that_leave_no_room_are_drawn_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seed 47 ended the whole count: its first goal leaves six things no room on the table."""
    monkeypatch.syspath_prepend(str(SIMS / "benchmarks"))
    drawing = importlib.import_module("reaching.drawing")
    monkeypatch.setattr(drawing, "TUNING", replace(drawing.TUNING, draws=20))
    ways, asked = drawing._ways, []

    def no_room_at_first(sizes: Any, start: Any, goal: Any, rng: Any) -> Any:
        asked.append(tuple(goal))
        return None if len(asked) <= 20 else ways(sizes, start, goal, rng)

    monkeypatch.setattr(drawing, "_ways", no_room_at_first)
    drawn = drawing.draw_reach(load_scenario("tabletop"), 40)
    assert tuple(drawn.twin.task.X_WG.translation[:2]) == asked[-1] != asked[0]
