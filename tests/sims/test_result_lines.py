"""Results of a benchmark that was killed as it wrote one: the others are read, and the next has a line of its own."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

BENCHMARKS = Path(__file__).resolve().parents[2] / "sims" / "benchmarks"
sys.path[:0] = [str(BENCHMARKS)]

import result_lines  # noqa: E402
from synctwin_truth.table_two_rows import Trials  # noqa: E402


def test_a_line_that_was_cut_off_costs_that_line_alone(tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    assert result_lines.read(file) == []
    result_lines.append(file, {"seed": 1, "error": np.float32(0.5)})
    with file.open("a") as written:
        written.write('{"seed": 2, "kind": {"a": 1}')
    result_lines.append(file, {"seed": 3})
    assert result_lines.read(file) == [{"seed": 1, "error": 0.5}, {"seed": 3}]
    assert Trials(file).find(seed=3) is not None and Trials(file).find(seed=2) is None
