"""What a run of learning lost on its way to the other bin does not count as finished, though it has an asset."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twin_diagram.runs.learning.record import Learned, LearningRecord, RunState
from twin_diagram.scenario import Scenario

BENCHMARKS = Path(__file__).resolve().parents[2] / "sims" / "benchmarks"
sys.path[:0] = [str(BENCHMARKS)]

from real2sim_truth import scores  # noqa: E402


def test_what_was_lost_after_it_was_weighed_is_not_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures = {"X_WS": np.eye(4).tolist(), "R_OS": np.eye(3).tolist(), "p_OS": [0.0, 0.0, 0.0]}
    put, lost = (Learned(f"object_{k:02d}", "finished", figures=figures) for k in (1, 2))
    put.standing, lost.why = [0.4, 0.4, 0.05, 0.1], "no place is reached; it lies outside of the bins"
    out = tmp_path / "000000"
    out.mkdir()
    LearningRecord(out, Scenario()).save(RunState([put, lost]))
    notes = [json.dumps({"object": one.name, "positions": []}) for one in (put, lost)]
    out.with_suffix(".truth.jsonl").write_text("\n".join(notes))
    true: Any = SimpleNamespace(X_WO=np.eye(4))
    monkeypatch.setattr(scores, "true_objects", lambda scenario, positions: [true])
    assert [each.true for each in scores.matched(Scenario(), out)] == [true, None]
