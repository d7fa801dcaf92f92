"""What a pose may be mistaken for is compared with it; what stays likely is listed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.registration_bench import turn
from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration.alternatives import PoseHypothesis
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import RegisteredPose, register
from twin_diagram.perception.registration.settling import apart, beside, likeliest, settle
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.scenario.resources import models_dir

PARAMS = scenario.Registration()


def at(*p: float, R: Any = None) -> RegisteredPose:
    return RegisteredPose(np.eye(3) if R is None else R, np.array(p), 1e-6 * np.eye(6), 0.9, 0.9, 1.0, 300.0)


@pytest.mark.parametrize(
    ("shift", "angle", "other"), [(0.0079, 0.0, False), (0.0081, 0.0, True), (0.0, 0.119, False), (0.0, 0.121, True)]
)
def test_poses_are_apart_by_eight_millimetres_or_seven_degrees(shift: float, angle: float, other: bool) -> None:
    assert apart(at(0.0, 0.0, 0.0), at(shift, 0.0, 0.0, R=turn(0.0, 0.0, angle))) == other


def test_rivals_are_listed_as_likely_as_their_costs_say() -> None:
    own = (PoseHypothesis(np.eye(3), np.zeros(3), np.eye(6), 1.0),)
    rivals = [at(0.0, 0.0, 0.0), at(0.1, 0.0, 0.0), at(0.2, 0.0, 0.0), at(0.3, 0.0, 0.0)]
    found = beside(own, rivals, np.array([5.0, 7.0, 6.0, 15.0]))
    assert [float(one.p[0]) for one in found] == [0.0, 0.2, 0.1], "the fourth is too unlikely"
    whole = 1.0 + np.exp(-1.0) + np.exp(-2.0)
    np.testing.assert_allclose([one.probability for one in found], [1 / whole, np.exp(-1) / whole, np.exp(-2) / whole])


@pytest.mark.parametrize(
    ("angle", "shares", "shown"),
    [(1.0, (0.1, 0.6, 0.3), 1), (1.0, (0.3, 0.45, 0.25), 0), (1.0, (0.6, 0.3, 0.1), 0), (0.1, (0.1, 0.6, 0.3), 0)],
)
def test_a_turn_likelier_than_all_else_is_shown_and_a_slide_stays_at_its_mean(
    angle: float, shares: tuple[float, ...], shown: int
) -> None:
    turns = (np.eye(3), turn(0.0, 0.0, angle), turn(0.0, 0.0, -2.0))
    poses = [PoseHypothesis(R, np.zeros(3), np.eye(6), share) for R, share in zip(turns, shares, strict=True)]
    assert likeliest(poses) == shown


@pytest.fixture(scope="module")
def box() -> ModelCloud:
    return ModelCloud.of(Asset.load(models_dir() / "objects" / "sugar_box"), 600)


def test_a_box_is_much_the_same_after_half_turns(box: ModelCloud) -> None:
    turns = [np.round(R, 9) for R in box.turns]
    for wanted in (np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, -1.0]), np.diag([-1.0, -1.0, 1.0])):
        assert any(np.allclose(R, wanted) for R in turns)
    can = ModelCloud.of(Asset.load(models_dir() / "objects" / "can"), 60)
    assert can.turns.shape[1:] == (3, 3) and not any(np.allclose(R[2, 2], 1.0) for R in can.turns)


def test_a_box_found_back_to_front_is_turned_where_colours_tell_and_doubted_where_not(box: ModelCloud) -> None:
    view = camera()
    R, p = yawed(0.3), np.array([0.5, 0.0, box.asset.size[2] / 2])
    rgb, depth, _ = picture(view, [Thing(box.asset, 7, R, p)])
    segments = segment(rgb, depth, 0.0, Grid.of(view, 2), scenario.Perception())
    back = register(box, Frame.of(segments), yawed(0.3 + np.pi), p, PARAMS, points_W=segments.points_W[::20])
    frame = Frame.of(segments)
    kept = settle(box, frame, [back], segments.points_W, PARAMS)
    assert np.trace(kept.registration.R.T @ R) < 0.0 and sum(h.probability for h in kept.hypotheses) == pytest.approx(1)
    found = settle(box, frame, [back], segments.points_W, PARAMS, turns=True)
    assert found.moved and np.trace(found.registration.R.T @ R) > 2.99
    np.testing.assert_array_equal(found.hypotheses[0].p, found.registration.p)
    grey = segment(np.full_like(rgb, 128), depth, 0.0, Grid.of(view, 2), scenario.Perception())
    plain = ModelCloud.of(Asset(**{**vars(box.asset), "colours": np.full_like(box.asset.colours, 0.5)}), 600)
    doubted = settle(plain, Frame.of(grey), [back], grey.points_W, PARAMS, turns=True)
    traces = [float(np.trace(h.R.T @ R)) for h in doubted.hypotheses if h.probability > 0.05]
    assert max(traces) > 2.9 and min(traces) < 0.0
