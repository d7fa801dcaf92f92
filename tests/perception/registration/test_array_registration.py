"""`register` on arrays: a box drawn by hand is found from 2 cm and 10° off; bad input is told."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twin_diagram import TwinError
from twin_diagram.perception import PoseFromArrays, register
from twin_diagram.signals.arrays import Array

SIZE = np.array([0.10, 0.06, 0.16])
K = np.array([[600.0, 0.0, 319.5], [0.0, 590.0, 239.5], [0.0, 0.0, 1.0]])


def turned(axis: list[float], angle: float) -> Array:
    k = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def paint(points: Array) -> Array:
    """A colour for each place of the surface, alike nowhere."""
    x, y, z = (points / SIZE).T
    return np.stack([0.5 + 0.4 * np.sin(9 * x + 3), 0.5 + 0.4 * np.sin(11 * z + y), 0.3 + 0.5 * (z + 0.5)], axis=1)


def box() -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(0)
    axis, sign = rng.integers(0, 3, 3000), rng.choice([-0.5, 0.5], 3000)
    points, normals = (rng.random((3000, 3)) - 0.5) * SIZE, np.zeros((3000, 3))
    points[np.arange(3000), axis] = sign * SIZE[axis]
    normals[np.arange(3000), axis] = 2.0 * sign
    return points, normals, paint(points)


def picture(X_CO: Array) -> tuple[Any, Any, Any]:
    """Colour, depth and mask of the box before a wall 1.5 m off, by each pixel's own ray: slabs."""
    v, u = np.mgrid[0:480, 0:640]
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1)
    way, start = rays @ X_CO[:3, :3], -X_CO[:3, 3] @ X_CO[:3, :3]
    with np.errstate(divide="ignore"):
        ends = np.sort((np.array([-0.5, 0.5])[:, None, None, None] * SIZE - start) / way, axis=0)
    near, far = ends[0].max(axis=-1), ends[1].min(axis=-1)
    mask = near < far
    depth = np.where(mask, near, 1.5)
    rgb = np.full((480, 640, 3), 90, dtype=np.uint8)
    rgb[mask] = np.rint(255 * paint((start + way * depth[..., None])[mask]))
    return rgb, depth.astype(np.float32), mask


def truth() -> Array:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = turned([1.0, 0.4, -0.3], 2.2), [0.03, -0.02, 0.75]
    return X


def guessed() -> Array:
    X = truth()
    X[:3, :3] = turned([0.3, -0.5, 0.8], np.radians(10)) @ X[:3, :3]
    X[:3, 3] += 0.02 * np.array([0.6, -0.64, 0.48])
    return X


def found(**other: Any) -> PoseFromArrays:
    points, normals, colours = box()
    rgb, depth, mask = picture(truth())
    given: dict[str, Any] = {
        "points_O": points, "normals_O": normals, "colours": colours, "rgb": rgb, "depth": depth, "K": K,
        "X_CO": guessed(), "mask": mask,
    }  # fmt: skip
    return register(**(given | other))


def off(X: Array) -> tuple[float, float]:
    cosine = 0.5 * (np.trace(X[:3, :3].T @ truth()[:3, :3]) - 1)
    return float(np.linalg.norm(X[:3, 3] - truth()[:3, 3])), float(np.degrees(np.arccos(min(1.0, cosine))))


@pytest.mark.parametrize("masked", [True, False])
def test_a_box_is_found_from_a_rough_guess(masked: bool) -> None:
    result = found() if masked else found(mask=None)
    metres, degrees = off(result.X_CO)
    assert metres < 0.0005
    assert degrees < 0.3
    assert result.quality > 0.9
    assert np.linalg.eigvalsh(result.covariance).min() > 0.0
    np.testing.assert_allclose(result.hypotheses[0][0], result.X_CO, atol=1e-9)
    assert sum(p for _, p in result.hypotheses) == pytest.approx(1.0, abs=0.05)


def test_normals_may_have_any_length_and_depth_holes() -> None:
    _, normals, _ = box()
    _, depth, _ = picture(truth())
    holes = depth.copy()
    holes[::7, ::5] = np.nan
    holes[3::9, ::4] = np.inf
    metres, degrees = off(found(normals_O=2.5 * normals, depth=holes).X_CO)
    assert metres < 0.001
    assert degrees < 0.5


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("X_CO", np.diag([2.0, 2.0, 2.0, 1.0]), "X_CO: its rotation"),
        ("X_CO", np.full((4, 4), np.nan), "X_CO: holds a number that is not finite"),
        ("X_CO", np.eye(3), "X_CO: shape (4, 4)"),
        ("X_CO", np.diag([1.0, -1.0, -1.0, 1.0]), "X_CO: the object would be behind the camera"),
        ("K", np.eye(3)[::-1], "K: fx, 0, cx"),
        ("depth", np.full((480, 640), 750.0, dtype=np.float32), "millimetres"),
        ("depth", np.zeros((480, 640), dtype=np.float32), "0 pixels with depth under the mask"),
        ("depth", np.full((480, 640), 750, dtype=np.uint16), "metres, as floating-point numbers"),
        ("rgb", np.zeros((480, 640, 3)), "rgb: uint8"),
        ("mask", np.zeros((48, 64), dtype=bool), "mask: shape (480, 640)"),
        ("mask", np.zeros((480, 640), dtype=bool), "0 pixels with depth under the mask"),
        ("points_O", np.zeros((3000, 3)), "1 different points"),
        ("points_O", np.zeros((10, 2)), "points_O: shape (any, 3)"),
        ("points_O", 1000.0 * box()[0], "points_O: they span 160 m; metres are wanted"),
        ("normals_O", np.zeros((3000, 3)), "a normal has no length"),
        ("normals_O", -box()[1], "normals_O: they point inwards"),
        ("colours", np.full((3000, 3), 255.0), "colours must lie from 0 to 1"),
        ("depth_noise", "d455", "depth_noise: 'd455' is none of"),
    ],
)
def test_bad_input_is_told_in_one_line(name: str, value: Any, told: str) -> None:
    with pytest.raises(TwinError) as error:
        found(**{name: value})
    assert told in str(error.value)
    assert "\n" not in str(error.value)
