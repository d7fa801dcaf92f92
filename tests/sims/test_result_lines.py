"""Results of a benchmark that was killed as it wrote one: the others are read, and the next has a line of its own."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

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
    code = result_lines.code()
    assert result_lines.read(file) == [{"seed": 1, "error": 0.5, "code": code}, {"seed": 3, "code": code}]
    assert Trials(file).find(seed=3) is not None and Trials(file).find(seed=2) is None


def test_results_of_other_code_are_not_read_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "results.jsonl"
    file.write_text('{"seed": 1, "of": "before results told their code"}\n')
    with monkeypatch.context() as before:
        before.setattr(result_lines, "code", lambda: "other")
        result_lines.append(file, {"seed": 2})
    result_lines.append(file, {"seed": 3})
    assert result_lines.read(file) == [{"seed": 3, "code": result_lines.code()}]
    assert f"{file}: 2 results of other code" in capsys.readouterr().err
    assert [one["seed"] for one in result_lines.read(file, of_any_code=True)] == [1, 2, 3]


def test_the_code_is_told_by_every_source_of_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "inner").mkdir()
    source = tmp_path / "inner" / "module.py"
    monkeypatch.setattr(result_lines, "PACKAGE", tmp_path)
    seen = set()
    for text in ("a = 1\n", "a = 2\n"):
        source.write_text(text)
        result_lines.code.cache_clear()
        seen.add(result_lines.code())
    result_lines.code.cache_clear()
    assert len(seen) == 2
