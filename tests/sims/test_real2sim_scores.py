"""What a run of learning lost on its way to the other bin does not count as finished, though it has an asset."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

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


def test_the_true_object_is_shown_as_the_learned_one_lies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    half, turn = np.array([0.03, 0.045, 0.06]), Rotation.from_euler("xyz", [0.05, -0.04, 0.06]).as_matrix()
    signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    hull = ConvexHull(signs * half)
    corners = (signs * half)[hull.simplices]
    inward = (
        np.einsum("fi,fi->f", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners[:, 0]) < 0
    )
    corners[inward] = corners[inward][:, ::-1]
    centre, inertia = np.array([0.001, 0.002, -0.003]), np.diag([3e-4, 1e-4, 2e-4])
    true: Any = SimpleNamespace(X_WO=np.eye(4), corners=corners, mass=0.4, centre=centre, inertia=inertia)
    monkeypatch.setattr(scores, "matched", lambda scenario, out: [scores.Matched({"name": "a"}, true, np.eye(4))])
    monkeypatch.setattr(scores, "triangles", lambda path: (corners - [0.004, 0.0, -0.003]) @ turn)
    (cloud,) = scores.true_clouds(Scenario(), tmp_path).values()
    back = cloud.points @ turn.T + [0.004, 0.0, -0.003]
    assert cloud.centre is not None and cloud.mass == 0.4 and cloud.moments == pytest.approx([1e-4, 2e-4, 3e-4])
    assert turn @ cloud.centre + [0.004, 0.0, -0.003] == pytest.approx(centre, abs=1e-3), "where it is in the asset"
    assert cloud.off is not None and 0.0 <= cloud.off < 5e-4
    assert np.abs(np.abs(back) / half).max(axis=1) == pytest.approx(1.0, abs=0.02), "on the box"
    assert cloud.colours.shape == back.shape and 0.0 <= cloud.colours.min() <= cloud.colours.max() <= 1.0
    outward, on = cloud.normals @ turn.T, np.abs(back) / half
    sides = np.take_along_axis(outward * np.sign(back), on.argmax(axis=1)[:, None], axis=1)[:, 0]
    clear = np.sort(on, axis=1)[:, 1] < 0.95
    assert clear.mean() > 0.8 and sides[clear] == pytest.approx(1.0, abs=0.01), "each is lit as its side is"
