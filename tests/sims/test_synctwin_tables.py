"""The formulas of SyncTwin's Table I, and the motions that it scores."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "sims" / "benchmarks"))

from braking_bench.counting import wilson
from synctwin_truth import avoidance, motions, table_one, table_two

from twin_diagram.signals import rotations
from twin_diagram.station.sim.movers import Path as Path_


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


# Table II.


def test_contact_is_an_edge_where_it_moves_the_obstacle_little() -> None:
    assert table_two.outcome(False, 0.0, 0.0) == "FA"
    assert table_two.outcome(True, 0.0049, np.radians(1.9)) == "EA"
    assert table_two.outcome(True, 0.0051, 0.0) == "CO"
    assert table_two.outcome(True, 0.0, np.radians(2.1)) == "CO"


def test_a_run_counts_for_the_papers_weight_and_nothing_where_it_made_too_few_visits() -> None:
    worth = [table_two.score({"outcome": kind, "visits": 6}, 10) for kind in ("FA", "EA", "CO")]
    assert worth == [1.0, 0.8, 0.0]
    assert table_two.score({"outcome": "FA", "visits": 5}, 10) == 0.0
    paper = 18 + 16 + 15 + 13 + 0.8 * (1 + 4 + 5 + 6)
    assert 100 * paper / 80 == pytest.approx(93.5), "the paper's first row, by its formula"


@pytest.mark.parametrize("motion", avoidance.MOTIONS)
def test_draws_are_the_four_boxes_in_the_arms_way(motion: str) -> None:
    draws = [avoidance.drawn(seed, motion) for seed in range(16)]
    assert {draw.box for draw in draws} == set(avoidance.BOXES) and {draw.targets for draw in draws} == {0, 1, 2, 3}
    for draw in draws:
        path, times = Path_(draw.path, "path"), np.arange(0.0, avoidance.DURATION, 0.01)
        states = [path.state(t) for t in times]
        place, rate = np.array([x for x, _ in states]), np.array([v for _, v in states])
        assert path.z == pytest.approx(avoidance.BOXES[draw.box][2] / 2)
        in_way = (place[:, 0] < 0.66) & (np.abs(place[:, 1]) < 0.09)
        speed = np.linalg.norm(rate[:, :2], axis=1)
        if motion == "SelfRot":
            assert in_way.all() and speed.max() < 1e-9
            assert 0.25 < np.abs(rate[100:-100, 2]).min() and np.abs(rate[:, 2]).max() < 1.5
        else:
            assert not in_way[0] and 0.15 < in_way.mean() < 0.8
            assert 0.1 < speed.max() < 0.5
    assert avoidance.drawn(3, motion) == avoidance.drawn(3, motion) != avoidance.drawn(7, motion)


def test_rows_differ_in_what_the_twin_is_told(tmp_path: Path) -> None:
    draw = avoidance.drawn(1, "SelfRot")
    assets = avoidance.library(tmp_path)
    seen, unseen, blind, still = (
        avoidance.scenario_of(draw, assets, row) for row in ("seen", "unseen", "ignore all", "stand still")
    )
    assert set(seen.twin.library) == set(avoidance.BOXES) and not unseen.twin.library
    assert seen.world == unseen.world and seen.twin.stop_monitor is not None
    assert blind.twin.camera is None and blind.twin.stop_monitor is None and blind.twin.task == seen.twin.task
    assert not still.twin.task.steps and still.twin.task.X_WG is None
    assert seen.world.objects[draw.box].push == avoidance.PUSH <= 15.0
    assert not avoidance.scenario_of(draw, assets, "seen", present=False).world.objects


def test_wilsons_interval_is_the_textbooks() -> None:
    assert wilson(0, 100) == pytest.approx((0.0, 0.0370), abs=1e-4)
    assert wilson(45, 50) == pytest.approx((0.7864, 0.9565), abs=1e-4)
    assert wilson(0, 0) == (0.0, 1.0)
