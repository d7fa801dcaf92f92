"""Pieces of unknown things hold what was not seen of them, and not much more."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial import ConvexHull

from tests.synthetic_scene import Thing, camera, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.perception.segmentation.pieces import convex_pieces, floor_below
from twin_diagram.perception.segmentation.planes import Plane
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.scenario.resources import models_dir

Array = npt.NDArray[np.float64]
UP = np.array([0.0, 0.0, 1.0])
TABLE = Plane(UP, 0.0, 1.0)
EYE = np.array([1.4, 0.0, 0.85])


def held(points: Array, pieces: list[Array]) -> npt.NDArray[np.bool_]:
    result = np.zeros(len(points), dtype=bool)
    for piece in pieces:
        sides = ConvexHull(piece).equations
        result |= (points @ sides[:, :3].T + sides[:, 3] <= 1e-9).all(axis=1)
    return result


def volume(pieces: list[Array]) -> float:
    """Of all pieces together, by sampling."""
    corners = np.concatenate(pieces)
    low, high = corners.min(axis=0), corners.max(axis=0)
    points = np.random.default_rng(0).uniform(low, high, (20000, 3))
    return float(held(points, pieces).mean() * np.prod(high - low))


def ball_seen(centre: Array, radius: float, eye: Array = EYE) -> Array:
    """Points of a ball's surface that face the eye, some 2 mm apart."""
    k = np.arange(4000) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * k / 4000), np.pi * (1.0 + np.sqrt(5.0)) * k
    normal = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)
    points = centre + radius * normal
    return points[np.einsum("ni,ni->n", normal, eye - points) > 0.0]


@pytest.mark.parametrize("name", ["cracker_box", "sugar_box", "can"])
@pytest.mark.parametrize("yaw", [0.0, 0.6, 1.2])
def test_what_is_hidden_is_held(name: str, yaw: float) -> None:
    asset = Asset.load(models_dir() / "objects" / name)
    view = camera()
    thing = Thing(asset, 1, yawed(yaw), np.array([0.5, 0.1, asset.size[2] / 2]))
    rgb, depth, _ = picture(view, [thing], np.random.default_rng(2))
    seen = segment(rgb, depth, 0.0, Grid.of(view, 2), scenario.Perception())
    assert seen.count == 1
    pieces = convex_pieces(seen.points_W, view.p_WC, seen.planes[0])
    assert 1 <= len(pieces) <= 8 and all(piece.shape[1] == 3 and len(piece) >= 4 for piece in pieces)
    hull = ConvexHull(asset.convex_pieces[0])
    inside = np.random.default_rng(1).uniform(-asset.size / 2, asset.size / 2, (4000, 3))
    inside = inside[(inside @ hull.equations[:, :3].T + hull.equations[:, 3] <= 0).all(axis=1)]
    assert held(inside @ thing.R.T + thing.p, pieces).mean() >= 0.95
    assert volume(pieces) <= 2.0 * hull.volume
    # Nothing below the table.
    assert min(float(piece[:, 2].min()) for piece in pieces) > -0.004


@pytest.mark.long
def test_a_ball_goes_on_behind_where_it_bends_out_of_sight() -> None:
    centre, radius = np.array([0.5, 0.0, 0.05]), 0.05
    seen = ball_seen(centre, radius)
    pieces = convex_pieces(seen, EYE, TABLE)
    inside = np.random.default_rng(1).normal(size=(3000, 3))
    inside *= (radius * np.random.default_rng(2).random(3000) ** (1 / 3) / np.linalg.norm(inside, axis=1))[:, None]
    assert held(inside + centre, pieces).mean() > 0.98
    assert held(inside + centre, [seen]).mean() < 0.7
    assert volume(pieces) < 2.0 * 4 / 3 * np.pi * radius**3


def upright(width: float, height: float, depth: float = 0.0) -> Array:
    """The front of a box towards +x and its lid, 2 mm apart."""
    y, z = (grid.ravel() for grid in np.meshgrid(np.arange(0, width, 0.002), np.arange(0, height, 0.002)))
    front = np.stack([0.0 * y, y, z], axis=1)
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(-depth, 0, 0.002), np.arange(0, width, 0.002)))
    return np.concatenate([front, np.stack([x, y, np.full(len(x), height)], axis=1)])


@pytest.mark.parametrize(
    ("width", "depth", "wanted"), [(0.2, 0.0, 0.1), (0.2, 0.06, 0.1), (0.2, 0.15, 0.15), (0.02, 0.0, 0.02)]
)
def test_a_thing_is_half_as_deep_as_wide_at_the_least(width: float, depth: float, wanted: float) -> None:
    points = np.concatenate(convex_pieces(upright(width, 0.1, depth), np.array([1.0, width / 2, 0.15]), TABLE))
    assert -points[:, 0].min() == pytest.approx(wanted, abs=0.008)
    assert points[:, 0].max() < 0.004 and points[:, 2].max() < 0.104


def test_nothing_is_grown_into_what_the_camera_sees_to_be_free() -> None:
    """From 45° above, behind the edge of a wall as high as 5 cm, there is shadow for 5 cm, and it falls off."""
    wall = upright(0.3, 0.05)
    eye = np.array([1.0, 0.15, 1.025])
    [piece] = convex_pieces(wall, eye, TABLE)
    assert -piece[:, 0].min() == pytest.approx(0.05, abs=0.006)
    free = np.array([[-0.03, 0.15, 0.035], [-0.01, 0.15, 0.05]])
    assert not held(free, [piece]).any()
    assert held(np.array([[-0.02, 0.15, 0.02], [-0.004, 0.15, 0.04]]), [piece]).all()


def test_a_roof_hides_behind_its_ridge_what_it_shows_before_it() -> None:
    """Sight lines come down at 45°: all of a steep roof's far side may be there; a lid's would be seen."""
    y, run = (grid.ravel() for grid in np.meshgrid(np.arange(0, 0.06, 0.002), np.arange(0, 0.05, 0.002)))
    for rise, wanted in ((1.6, 0.1), (0.5, 0.075), (0.0, 0.05)):
        roof = np.stack([-run, y, 0.04 + rise * run], axis=1)
        points = np.concatenate([upright(0.06, 0.04), roof])
        middle = points.mean(axis=0)
        [piece] = convex_pieces(points, middle + [1.0, 0.0, 1.0], TABLE)
        assert -piece[:, 0].min() == pytest.approx(wanted, abs=0.008), rise


def test_what_a_neck_hides_of_a_shoulder_is_held() -> None:
    """A can's lid, of which a third is hidden behind something narrow that stands on its middle."""
    radius, height = 0.036, 0.15
    x, y = (grid.ravel() for grid in np.meshgrid(*[np.arange(-radius, radius, 0.002)] * 2))
    lid = np.stack([x, y, np.full(len(x), height)], axis=1)[np.hypot(x, y) < radius]
    lid = lid[(np.abs(lid[:, 1]) > 0.013) | (lid[:, 0] > 0.013)]
    turn, up = (grid.ravel() for grid in np.meshgrid(np.linspace(-1.3, 1.3, 40), np.arange(0, height, 0.002)))
    front = np.stack([radius * np.cos(turn), radius * np.sin(turn), up], axis=1)
    whole = np.random.default_rng(1).uniform([-radius, -radius, 0], [radius, radius, height], (4000, 3))
    whole = whole[np.hypot(whole[:, 0], whole[:, 1]) < radius]
    pieces = convex_pieces(np.concatenate([front, lid]), np.array([0.8, 0.0, 0.9]), TABLE)
    assert held(whole, pieces).mean() > 0.98
    assert volume(pieces) < 1.25 * np.pi * radius**2 * height


def test_a_thing_of_two_heights_gets_more_pieces_than_one() -> None:
    tall, low = upright(0.06, 0.2, 0.06), upright(0.2, 0.04, 0.06) + [0.0, 0.06, 0.0]
    pieces = convex_pieces(np.concatenate([tall, low]), EYE, TABLE)
    assert 2 <= len(pieces) <= 8
    assert volume(pieces) < 0.8 * ConvexHull(np.concatenate(pieces)).volume
    assert held(np.array([[-0.03, 0.02, 0.1], [-0.03, 0.2, 0.02], [-0.03, 0.075, 0.02]]), pieces).all()


@pytest.mark.long
def test_pieces_go_with_the_world() -> None:
    """Turned and raised, floor, camera and all: the same pieces, turned and raised."""
    seen = ball_seen(np.array([0.5, 0.0, 0.05]), 0.05)
    c, s = np.cos(0.4), np.sin(0.4)
    R, p = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]) @ yawed(1.0), np.array([0.1, -0.2, 0.3])
    moved = convex_pieces(seen @ R.T + p, R @ EYE + p, Plane(R @ UP, float(R @ UP @ p), 1.0))
    for one, other in zip(convex_pieces(seen, EYE, TABLE), moved, strict=True):
        assert volume([one]) == pytest.approx(volume([other]), rel=0.05)
        assert held(one[::7] * 0.999 + one.mean(axis=0) * 0.001, [(other - p) @ R]).mean() > 0.9


def test_things_stand_on_lids_if_their_foot_is_near() -> None:
    lid, lower = Plane(UP, 0.1, 0.02), Plane(UP, 0.04, 0.02)
    thing = upright(0.1, 0.1)
    planes = [TABLE, lid, lower]
    for lift, floor in ((0.0, TABLE), (0.105, lid), (0.112, lid), (0.13, TABLE), (0.045, lower), (0.07, TABLE)):
        assert floor_below(thing + [0.0, 0.0, lift], planes) is floor, lift
    assert floor_below(thing, [TABLE]) is TABLE


def test_from_straight_above_and_from_hardly_any_points() -> None:
    lid = upright(0.1, 0.05, 0.1)
    lid = lid[lid[:, 2] > 0.049]
    [piece] = convex_pieces(lid, np.array([-0.05, 0.05, 1.0]), TABLE)
    assert volume([piece]) == pytest.approx(0.1 * 0.1 * 0.05, rel=0.15)
    assert convex_pieces(lid[:7], EYE, TABLE) == [] and convex_pieces(np.zeros((0, 3)), EYE, TABLE) == []
