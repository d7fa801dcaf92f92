"""Picks alone: a bin is emptied pick by pick, and what was brought is told by the true world."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

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
