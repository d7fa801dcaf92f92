"""The formulas of SyncTwin's Table I, and the motions that it scores."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "sims" / "benchmarks"))

from synctwin_truth import motions, table_one

from twin_diagram.signals import rotations


def turned(angle: float, axis: int) -> np.ndarray:
    return rotations.matrix(rotations.exp(angle * np.eye(3)[axis]))


def test_motions_are_those_of_the_paper() -> None:
    stops = motions.rests(turned(0.3, 2), np.array([0.1, 0.2, 0.3]))
    assert [stop.picture for stop in stops] == [motions.STEPS * k for k in range(7)]
    for k in range(3):
        np.testing.assert_allclose(stops[k + 1].p - stops[k].p, 0.15 * np.eye(3)[k])
        np.testing.assert_allclose(stops[k + 4].R @ stops[k + 3].R.T, turned(np.pi / 2, k), atol=1e-12)
    poses = list(motions.way(stops))
    assert len(poses) == 6 * motions.STEPS + 1
    for stop in stops:
        np.testing.assert_allclose(poses[stop.picture][0], stop.R, atol=1e-12)
        np.testing.assert_allclose(poses[stop.picture][1], stop.p, atol=1e-12)


def test_accuracy_is_one_less_the_mean_error_over_the_displacement(tmp_path: Path) -> None:
    stops = motions.rests(np.eye(3), np.zeros(3))
    lag = turned(0.1, 0)  # the asset's axes may be others than the mesh's, from first to last
    rows = []
    for k, stop in enumerate(stops):
        p = stop.p + [0.003 * (k == 1), 0, 0]
        R = stop.R @ lag if k < 6 else turned(0.2, 1) @ stop.R @ lag
        q = rotations.from_matrix(R)
        rows.append({"frame": stop.picture, "objects": [{"asset": "cup", "p_WO": p.tolist(), "q_WO": q.tolist()}]})
    rows.append({"frame": stops[-1].picture + 1, "objects": []})
    file = tmp_path / "objects.jsonl"
    file.write_text("".join(json.dumps(row) + "\n" for row in rows))
    poses = table_one.tracked(file, "cup")
    np.testing.assert_allclose(poses[stops[-1].picture + 1][1], stops[-1].p)  # what is not seen stays where it was
    errors = table_one.motion_errors(stops, poses)
    np.testing.assert_allclose(errors, [0.003, 0.003, 0, 0, 0, 0.2], atol=1e-9)
    assert table_one.accuracy(np.array([errors])) == pytest.approx((1 - 0.002 / 0.15, 1 - (0.2 / 3) / (np.pi / 2)))
    np.testing.assert_allclose(table_one.off_true(stops, poses)[:6], 0.1, atol=1e-9)
    never = table_one.motion_errors(stops, {})
    assert table_one.accuracy(np.array([never])) == pytest.approx((0, 0))
