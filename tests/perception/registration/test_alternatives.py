"""What else an image allows is weighed; what nothing holds is claimed so."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.registration.alternatives import (
    Profile,
    compare,
    distinct,
    profile,
    settled,
    weights,
    widened,
)
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.scenario.resources import models_dir

Array = npt.NDArray[np.float64]


def test_weights_are_of_cells_and_sum_to_one() -> None:
    offset = np.array([-2.0, -1.0, 0.0, 0.5, 1.0])
    np.testing.assert_allclose(weights(np.zeros(5), offset), np.array([0.5, 1.0, 0.75, 0.5, 0.25]) / 3.0)
    likely = weights(np.array([9.0, 3.0, 1.0, 1.0, 9.0]), offset)
    assert likely[2] / likely[1] == pytest.approx(0.75 * np.exp(2.0))


def test_a_profile_gives_a_step_and_its_spread() -> None:
    """A Gaussian of deviation 0.3 about 0.2, and a level stretch from -1 to 1 along another way."""
    fine = np.linspace(-2.0, 2.0, 401)
    fine = fine[fine != 0.0]
    level = np.linspace(-1.0, 1.0, 201)
    level = level[level != 0.0]
    one, two = np.array([0.1, 0, 0, 0, 0, 0]), np.array([0, 0, 0, 0, 0.02, 0])
    cost = np.concatenate([[0.5 * (0.2 / 0.3) ** 2], 0.5 * ((fine - 0.2) / 0.3) ** 2])
    along = np.concatenate([[-1], np.zeros(len(fine))])
    poses = Poses(np.eye(3)[None], np.zeros((1, 3)))
    step, spread = settled(Profile(poses, cost, along, np.concatenate([[0.0], fine]), [one]))
    np.testing.assert_allclose(step, 0.2 * one, atol=1e-4)
    np.testing.assert_allclose(spread, 0.09 * np.outer(one, one), atol=1e-5)
    step, spread = settled(
        Profile(poses, np.zeros(201), np.concatenate([[-1], np.zeros(200)]), np.concatenate([[0.0], level]), [two])
    )
    np.testing.assert_allclose(spread[4, 4], 0.02**2 / 3.0, rtol=0.02)


def test_a_claim_is_widened_to_what_a_profile_says_and_never_narrowed() -> None:
    covariance = np.diag([1e-4, 1e-4, 1e-4, 1e-6, 1e-6, 1e-6])
    way = np.array([0.0, 0.0, 0.6, 0.0, 0.8, 0.0])
    wide = widened(covariance, 0.04 * np.outer(way, way))
    assert 1.0 / (way @ np.linalg.solve(wide, way)) == pytest.approx(0.04, rel=1e-6)
    np.testing.assert_allclose(widened(covariance, 1e-9 * np.outer(way, way)), covariance)
    np.testing.assert_allclose(widened(covariance, np.zeros((6, 6))), covariance)


@pytest.fixture(scope="module")
def mug() -> ModelCloud:
    asset = Asset.load(models_dir() / "objects" / "mug")
    grey = type(asset)(**{**vars(asset), "colours": np.full_like(asset.colours, 0.5)})
    return ModelCloud.of(grey, 600)


def turns_allowed(mug: ModelCloud, yaw: float) -> tuple[Array, Array]:
    """Step and spread of a mug that stands turned by `yaw`, at its true pose."""
    view = camera()
    R, p = yawed(yaw), np.array([0.5, 0.0, mug.asset.size[2] / 2])
    rgb, depth, _ = picture(view, [Thing(mug.asset, 11, R, p)])
    segments = segment(np.full_like(rgb, 128), depth, 0.0, Grid.of(view, 2), scenario.Perception())
    image, at = Frame.of(segments), Poses(R[None], p[None])
    found = profile(mug, image, at, segments.points_W, look(mug, image, at, 600, FINE), 0.3)
    return settled(found)


@pytest.mark.long
def test_a_mug_whose_handle_is_out_of_sight_may_be_turned(mug: ModelCloud) -> None:
    """The camera looks from the front: the handle is seen at its side and hidden behind it."""
    spreads = [float(np.sqrt(turns_allowed(mug, yaw)[1][2, 2])) for yaw in np.arange(8) * np.pi / 4]
    assert max(spreads) > np.radians(12.0) and min(spreads) < np.radians(4.0), np.degrees(spreads)


def test_hypotheses_are_apart_and_likely_and_the_first_is_the_centre() -> None:
    """Turns about z in steps of 0.1 rad: likely up to 0.3, and once more about 0.8."""
    turns = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
    cost = np.array([0.0, 0.0, 0.0, 0.5, 20.0, 20.0, 20.0, 20.0, 1.0, 20.0, 20.0])
    steps = np.zeros((11, 6))
    steps[1:, 2] = turns
    start = Poses(np.eye(3)[None], np.zeros((1, 3)))
    poses = Poses(np.repeat(start.R, 11, axis=0), np.repeat(start.p, 11, axis=0)).moved(steps)
    laid = Profile(poses, cost, np.array([-1] + [0] * 10), steps[:, 2], [np.eye(6)[2]])
    centre = start.moved(np.array([[0.0, 0.0, 0.02, 0.0, 0.0, 0.0]]))
    narrow, wide = 1e-6 * np.eye(6), 1e-4 * np.eye(6)
    found = distinct(laid, centre, narrow, wide)
    assert sum(one.probability for one in found) == pytest.approx(1.0)
    yaw = [float(np.arctan2(one.R[1, 0], one.R[0, 0])) for one in found]
    assert sorted(np.round(yaw, 6)) == [0.02, 0.2, 0.8] or sorted(np.round(yaw, 6)) == [0.02, 0.2, 0.3, 0.8]
    for one, angle in zip(found, yaw, strict=True):
        np.testing.assert_allclose(one.covariance, wide if angle == pytest.approx(0.02) else one.covariance)
        assert one.covariance[0, 0] == pytest.approx(1e-4 if angle == pytest.approx(0.02) else 1e-6 + 0.06**2)
    assert yaw[0] == pytest.approx(0.02)
    assert [one.probability for one in found[1:]] == sorted((one.probability for one in found[1:]), reverse=True)


@pytest.mark.parametrize("narrow_ones", [0, 1, 2])
def test_what_is_open_one_way_is_no_likelier_for_what_is_known_along_others(narrow_ones: int) -> None:
    """Of ten turns that look alike each is as probable, however well places are told."""
    turns, steps = 0.3 * np.arange(-5, 5), np.zeros((11, 6))
    turns[5:] += 0.3
    steps[1:, 2] = turns
    cost, along, offset = [np.zeros(11)], [np.array([-1] + [0] * 10)], [np.concatenate([[0.0], turns])]
    for k in range(narrow_ones):
        aside = np.zeros((2, 6))
        aside[:, 4 + k] = -0.02, 0.02
        steps = np.concatenate([steps, aside])
        cost, along, offset = [*cost, np.full(2, 30.0)], [*along, np.full(2, 1 + k)], [*offset, aside[:, 4 + k]]
    start = Poses(np.eye(3)[None], np.zeros((1, 3)))
    poses = Poses(np.repeat(start.R, len(steps), axis=0), np.repeat(start.p, len(steps), axis=0)).moved(steps)
    ways = [np.eye(6)[2], *(np.eye(6)[4 + k] for k in range(narrow_ones))]
    laid = Profile(poses, np.concatenate(cost), np.concatenate(along), np.concatenate(offset), ways)
    found = distinct(laid, start, 1e-6 * np.eye(6), 1e-4 * np.eye(6))
    assert len(found) == 11
    assert found[0].probability == pytest.approx(0.1, rel=0.05)


def test_slides_are_told_by_edges() -> None:
    """A box aside of where it stands leaves a part of the image unexplained, and the camera sees past it."""
    view, asset = camera(), Asset.load(models_dir() / "objects" / "sugar_box")
    model = ModelCloud.of(asset, 600)
    R, p = yawed(0.3), np.array([0.5, 0.0, asset.size[2] / 2])
    rgb, depth, _ = picture(view, [Thing(asset, 7, R, p)])
    segments = segment(rgb, depth, 0.0, Grid.of(view, 2), scenario.Perception())
    aside = [k * R[:, 1] for k in (0.0, 0.005, -0.005, 0.015, -0.015)]
    laid = Poses(np.repeat(R[None], 5, axis=0), p + np.array(aside))
    cost = compare(model, Frame.of(segments), laid, segments.points_W)
    assert cost[0] < cost[1] < cost[3] and cost[0] < cost[2] < cost[4], cost
