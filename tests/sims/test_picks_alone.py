"""Picks alone: a bin is emptied pick by pick, and what was brought is told by the true world."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from twin_diagram import load_scenario

SCRIPT = Path(__file__).resolve().parents[2] / "sims" / "benchmarks" / "picks_alone.py"
pytestmark = pytest.mark.long


def test_a_bin_of_one_thing_is_emptied_at_the_first_try(tmp_path: Path) -> None:
    command = [sys.executable, str(SCRIPT), "--seeds", "0", "--objects", "1", "--out", str(tmp_path / "picks")]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert told[0] == "0: thing_0 after 0 tries that failed"
    assert told[1].startswith("0: 0 tries failed, left nothing, 0 contacts, ")
    (line,) = (tmp_path / "picks" / "picks.jsonl").read_text().splitlines()
    kept = json.loads(line)
    assert kept["rows"] == [{"thing": "thing_0", "told": "", "shoved": {}, "failed": 0}] and kept["left"] == []


def test_a_cracker_box_lies_flat_across_another_thing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    from real2sim_truth.laid_across import lay_across

    base, below = load_scenario("bin_picking"), set[str]()
    for seed in range(12):
        things = lay_across(base, seed).world.objects
        assert list(things) == ["below", "across"] and things["across"].asset == "objects/cracker_box"
        lower, upper = (np.array(things[name].X_WO.translation) for name in things)
        assert np.abs(upper - lower)[:2].max() <= 0.06 and upper[2] - 0.03 > 0.05, "over it, its short side upright"
        assert things["across"].X_WO.rpy[1] == pytest.approx(np.pi / 2)
        assert str(things) == str(lay_across(base, seed).world.objects)
        below.add(things["below"].asset)
    assert len(below) >= 3
