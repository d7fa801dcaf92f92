"""A rough pose comes near by the image's points alone; what they leave open gets rivals on both sides."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial import cKDTree

from tests.registration_bench import turn
from twin_diagram.assets import Asset
from twin_diagram.perception.registration.approach import approach, pull, rivals
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import information
from twin_diagram.perception.registration.rotation import log

Array = npt.NDArray[np.float64]
SIZE = np.array([0.16, 0.09, 0.06])
PRIOR = information(0.3, 0.05)


def surface(count: int, seed: int) -> tuple[Array, Array]:
    """Points and outward normals of a box of three unlike edges."""
    rng = np.random.default_rng(seed)
    area = np.array([SIZE[1] * SIZE[2], SIZE[0] * SIZE[2], SIZE[0] * SIZE[1]])
    axis = rng.choice(3, count, p=area / area.sum())
    sign = rng.choice([-1.0, 1.0], count)
    points = rng.uniform(-0.5, 0.5, (count, 3)) * SIZE
    points[np.arange(count), axis] = sign * SIZE[axis] / 2
    normals = np.zeros((count, 3))
    normals[np.arange(count), axis] = sign
    return points, normals


@functools.cache
def box() -> ModelCloud:
    points, normals = surface(3000, 1)
    asset = Asset("box", None, points, normals, points, None, (points,), 0.1, SIZE)  # type: ignore[arg-type]
    none = np.zeros((1, 1), dtype=np.int64)
    spacing = float(np.median(cKDTree(points).query(points, k=2)[0][:, 1]) * 2)
    tree, plain = cKDTree(points), np.zeros(len(points))
    tables = points[None], np.eye(3), none, none[0], tree
    return ModelCloud(asset, points, normals, *tables, spacing, 0.1, plain, np.zeros((0, 3, 3)))


def seen(R: Array, p: Array, count: int = 250) -> tuple[Array, Array]:
    """What a camera far off along (1, -1, 1) sees of the box there: three of its sides."""
    points, normals = surface(2 * count, 2)
    facing = (normals @ R.T) @ [1.0, -1.0, 1.0] > 0.0
    return points[facing] @ R.T + p, normals[facing] @ R.T


def one(R: Array, p: Array) -> Poses:
    return Poses(R[None], p[None])


@pytest.mark.parametrize("number", range(12))
def test_two_centimetres_and_ten_degrees_off_come_to_a_millimetre(number: int) -> None:
    rng = np.random.default_rng(number)
    R, p = turn(*rng.uniform(-0.4, 0.4, 3)), rng.uniform(-0.1, 0.1, 3)
    axis, way = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    start = one(R, p).moved(np.concatenate([np.radians(10.0) * axis, 0.02 * way])[None])
    found, weight = approach(box(), *seen(R, p), start, PRIOR)
    assert np.linalg.norm(found.p[0] - p) < 1.5e-3
    assert np.linalg.norm(log((found.R[0] @ R.T)[None])) < np.radians(1.0)
    assert np.linalg.eigvalsh(weight)[0] > 0.0


def test_a_pose_that_is_right_is_not_pulled() -> None:
    R, p = turn(0.1, 0.0, 0.3), np.array([0.1, 0.0, 0.2])
    still = pull(box(), *seen(R, p), one(R, p), 0.02)
    assert np.abs(np.linalg.solve(still.H[0], still.b[0])).max() < 2e-4
    np.testing.assert_allclose(still.H[0], still.H[0].T)
    moved = pull(box(), *seen(R, p), one(R, p + [0.0, 0.0, -0.004]), 0.02)
    step = np.linalg.solve(moved.H[0], moved.b[0])
    np.testing.assert_allclose(step[3:], [0.0, 0.0, 0.004], atol=6e-4)


def test_what_faces_away_is_another_surface() -> None:
    """The inside of a wall does not pull on its outside."""
    R, p = np.eye(3), np.zeros(3)
    points, normals = seen(R, p)
    none = pull(box(), points, -normals, one(R, p), 0.02)
    assert not none.H.any() and not none.b.any()
    beyond = pull(box(), points + [0.0, 0.0, 0.5], normals, one(R, p), 0.02)
    assert not beyond.H.any() and not beyond.b.any()


def test_a_side_alone_slides_and_rivals_lie_along_it() -> None:
    """Of one face only three degrees of freedom are told; so far along and about, and twice so far, each way."""
    R, p = np.eye(3), np.zeros(3)
    points, normals = seen(R, p, 2000)
    inner = (normals[:, 2] > 0.5) & (np.abs(points[:, 0]) < 0.05) & (np.abs(points[:, 1]) < 0.03)
    weight = pull(box(), points[inner], normals[inner], one(R, p), 0.012).H[0]
    laid = rivals(one(R, p), weight)
    assert len(laid.p) == 13
    np.testing.assert_array_equal(laid.p[0], p)
    turns = log(laid.R)
    assert np.abs(laid.p[:, 2]).max() < 2e-3, "what is told stays"
    weakest = [1, 4, 7, 10]
    assert np.abs(turns[weakest, :2]).max() < 0.02, "so does the tilt in what is told least"
    size = np.sqrt((laid.p[1:] / 0.02) ** 2 @ np.ones(3) + (turns[1:] / 0.15) ** 2 @ np.ones(3))
    np.testing.assert_allclose(np.sort(size), [1.0] * 6 + [2.0] * 6, rtol=1e-6)
    np.testing.assert_allclose(laid.p[1:4], -laid.p[10:13], atol=1e-12)


def test_the_start_holds_what_no_point_tells() -> None:
    R, p = turn(0.0, 0.1, 0.0), np.array([0.0, 0.0, 0.1])
    nowhere = np.full((10, 3), 9.0)
    found, weight = approach(box(), nowhere, np.tile([0.0, 0.0, 1.0], (10, 1)), one(R, p), PRIOR)
    np.testing.assert_allclose(found.p[0], p)
    np.testing.assert_allclose(found.R[0], R)
    assert not weight.any()
