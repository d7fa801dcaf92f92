"""Registers an object that is given as arrays to an image that is given as arrays: no library, no Diagram.

from twin_diagram.perception import register

guess = np.eye(4)                                     # X_CO: C is the camera's optical frame
guess[:3, 3] = 0.02, 0.0, 0.7
found = register(points_O, normals_O, colours, rgb, depth, K, guess, mask=mask)
print(found.X_CO, found.quality, np.sqrt(np.diag(found.covariance)))
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from twin_diagram import scenario
from twin_diagram.assets.asset import Asset, checked_cloud
from twin_diagram.assets.mesh import Cloud
from twin_diagram.errors import ArgumentError
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.pinhole import Pinhole, surface_at
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.global_search import nearby
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.scenario.depth_sheets import SHEETS
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.lens import Lens

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with what set them."""

    stride: int = 2
    """Every so many pixels are looked at, both ways, as perception does by default …"""

    small: int = 2000
    """… and each of them where the object shows on fewer: of some hundreds every one tells."""

    fewest: int = 30
    """Pixels with depth below this number are no picture of an object."""

    about: float = 0.03
    """Without a mask, points within the object's radius and this of where it is expected are taken [m]: the guess may
    be off by 2 cm."""

    no_rotation: float = 1e-3
    """A matrix that is off by more is no rotation: single precision leaves 1e-6."""

    largest: float = 5.0
    """An object of a longer edge is told in another unit [m]."""

    inward: float = -0.5
    """Mean of how far normals point from the middle of their points, as a share of its absolute value, below which
    they point inwards: outward ones of a closed surface have a positive one, which is its volume."""

    far: float = 20.0
    """Depth beyond this is none [m]: no depth camera for a table sees so far, and millimetres read as metres do."""


TUNING = Tuning()


@dataclass(frozen=True)
class PoseFromArrays:
    """Where an object is, seen by a camera.

    Attributes:
        X_CO: (4, 4) pose of the object's frame O in the camera's optical frame C (X right, Y down, Z forward) [m].
        covariance: (6, 6) of rotation [rad] and translation [m]: left perturbation in C about the object's origin.
        quality: share of the visible surface that fits, 0 to 1.
        visible_share: of the surface that faces the camera, what nothing hides, 0 to 1.
        hypotheses: the poses (4, 4) that the image allows with their probabilities: X_CO, then others, likely ones
            first. X_CO is the middle of poses that the image tells hardly apart, so another may be likelier.
    """

    X_CO: Array
    covariance: Array
    quality: float
    visible_share: float
    hypotheses: tuple[tuple[Array, float], ...]


def register(
    points_O: npt.ArrayLike,
    normals_O: npt.ArrayLike,
    colours: npt.ArrayLike | None,
    rgb: npt.ArrayLike,
    depth: npt.ArrayLike,
    K: npt.ArrayLike,
    X_CO: npt.ArrayLike,
    *,
    mask: npt.ArrayLike | None = None,
    depth_noise: str | scenario.DepthNoise = "ideal",
    symmetric_about_z: bool = False,
    params: scenario.Registration | None = None,
) -> PoseFromArrays:
    """Register an object to an RGB-D image, from a guess a few centimetres and some ten degrees off.

    Args:
        points_O: (M, 3) of its surface, M >= 100 [m].
        normals_O: (M, 3) outward; of any length but none.
        colours: (M, 3) RGB in [0, 1]; None: shape alone tells.
        rgb: (H, W, 3) RGB, 0 to 255.
        depth: (H, W) along the optical axis [m]; 0, NaN or infinite: none. On the pixels of `rgb`.
        K: (3, 3) of the camera, without distortion; pixel (u, v) has its centre at (u, v).
        X_CO: (4, 4) the guess.
        mask: (H, W) the object's pixels; None: all points near the guess, among which others may lead astray.
        depth_noise: name of a data sheet (`ideal`, `d415`, `d435`, `kinect1`), or figures of one's own.
        symmetric_about_z: whether turns about O's z axis are not to be told apart.
        params: tuning; None: the defaults of `twin.registration`.

    Raises:
        ArgumentError: an array has another shape or holds what it cannot; or nothing of the object is in the image.
        AssetError: points, normals or colours are no surface.
        ScenarioError: figures of `depth_noise` that cannot be.
    """
    tuning = params or scenario.Registration()
    model = ModelCloud.of(_thing(points_O, normals_O, colours, symmetric_about_z), tuning.model_points)
    guess = _pose(X_CO)
    camera = _camera(K, np.shape(depth), depth_noise)
    segments = _segments(*_images(rgb, depth), camera, _mask(mask, np.shape(depth)), guess, model.radius)
    frame = Frame.of(segments)
    R, p = guess[:3, :3].copy(), guess[:3, 3].copy()
    found = nearby(model, frame, R, p, segments.points_W, segments.normals_W, tuning)
    if found is None:
        raise ArgumentError(f"X_CO: nothing in the image fits the object near {np.round(p, 3).tolist()} m")
    best = found.registration
    rivals = tuple((_matrix(one.R, one.p), float(one.probability)) for one in found.hypotheses)
    return PoseFromArrays(_matrix(best.R, best.p), best.covariance, best.quality, best.visible_share, rivals)


def _thing(points_O: npt.ArrayLike, normals_O: npt.ArrayLike, colours: npt.ArrayLike | None, round_: bool) -> Asset:
    """Return the object as registration takes it; its mass and pieces are of no matter here."""
    points, normals = _array(points_O, "points_O", (-1, 3)), _array(normals_O, "normals_O", (-1, 3))
    painted = np.full(points.shape, 0.5) if colours is None else _array(colours, "colours", (-1, 3))
    size = np.ptp(points, axis=0) if len(points) else np.zeros(3)
    if size.max() > TUNING.largest:
        raise ArgumentError(f"points_O: they span {size.max():.3g} m; metres are wanted")
    cloud = checked_cloud(Cloud(points, normals, painted), size, "points_O")
    out = ((cloud.points - cloud.points.mean(axis=0)) * cloud.normals).sum(axis=1)
    if out.sum() < TUNING.inward * np.abs(out).sum():
        raise ArgumentError("normals_O: they point inwards; outward ones are wanted")
    axis = "z" if round_ else None
    return Asset("given", Path(), cloud.points, cloud.normals, cloud.colours, axis, (), 1.0, size)


def _array(value: npt.ArrayLike, name: str, shape: tuple[int, ...]) -> Array:
    """Return an array of finite numbers of a shape, in which -1 is any length."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise ArgumentError(f"{name}: an array of numbers is wanted, not {type(value).__name__}") from None
    if array.ndim != len(shape) or any(want not in (-1, got) for want, got in zip(shape, array.shape, strict=True)):
        wanted = tuple("any" if want == -1 else want for want in shape)
        raise ArgumentError(f"{name}: shape {wanted} is wanted, not {array.shape}".replace("'", ""))
    if not np.isfinite(array).all():
        raise ArgumentError(f"{name}: holds a number that is not finite")
    return array


def _pose(X_CO: npt.ArrayLike) -> Array:
    X = _array(X_CO, "X_CO", (4, 4))
    off = np.abs(X[:3, :3] @ X[:3, :3].T - np.eye(3)).max()
    if off > TUNING.no_rotation or np.linalg.det(X[:3, :3]) < 0.0 or np.abs(X[3] - [0, 0, 0, 1]).max() > 1e-9:
        raise ArgumentError("X_CO: its rotation is none, or its last row is not 0, 0, 0, 1")
    if X[2, 3] <= 0.0:
        raise ArgumentError(f"X_CO: the object would be behind the camera, at z = {X[2, 3]:g} m; C looks along its z")
    u, _, vt = np.linalg.svd(X[:3, :3])
    X[:3, :3] = u @ vt
    return X


def _camera(K: npt.ArrayLike, shape: tuple[int, ...], noise: str | scenario.DepthNoise) -> Pinhole:
    """Return the camera, whose optical frame is the world here."""
    matrix = _array(K, "K", (3, 3))
    (fx, skew, cx), (low, fy, cy) = matrix[:2].tolist()
    if not (fx > 0.0 and fy > 0.0 and skew == low == 0.0 and matrix[2].tolist() == [0.0, 0.0, 1.0]):
        raise ArgumentError(f"K: fx, 0, cx; 0, fy, cy; 0, 0, 1 is wanted, not {matrix.tolist()}")
    if len(shape) != 2 or min(shape) < 2:
        raise ArgumentError(f"depth: shape (H, W) is wanted, not {shape}")
    lens = Lens(shape[1], shape[0], fx, fy, cx, cy)
    if isinstance(noise, str) and noise not in SHEETS:
        raise ArgumentError(f"depth_noise: {noise!r} is none of {', '.join(SHEETS)}")
    told = scenario.DepthNoise(sheet=noise) if isinstance(noise, str) else noise
    return Pinhole(shape[1], shape[0], 0.5 * (fx + fy), np.eye(3), np.zeros(3), lens, DepthSigma.of(told))


def _images(rgb: npt.ArrayLike, depth: npt.ArrayLike) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
    """Return both images as perception takes them."""
    colour, far = np.asarray(rgb), np.array(depth)
    if colour.dtype != np.uint8 or colour.shape != (*far.shape, 3):
        raise ArgumentError(f"rgb: uint8 of shape {(*far.shape, 3)} is wanted, not {colour.dtype} of {colour.shape}")
    if not np.issubdtype(far.dtype, np.floating):
        raise ArgumentError(f"depth: metres, as floating-point numbers, are wanted, not {far.dtype}")
    far = np.where(np.isfinite(far) & (far > 0.0), far, 0.0).astype(np.float32)
    middle = float(np.median(far[far > 0.0])) if far.any() else 0.0
    if middle > TUNING.far:
        raise ArgumentError(f"depth: {middle:g} m in the middle: metres are wanted, not millimetres")
    return np.ascontiguousarray(colour).copy(), far


def _mask(mask: npt.ArrayLike | None, shape: tuple[int, ...]) -> Mask | None:
    if mask is None:
        return None
    array = np.asarray(mask)
    if array.shape != shape:
        raise ArgumentError(f"mask: shape {shape} is wanted, not {array.shape}")
    return np.asarray(array.astype(bool))


def _segments(
    rgb: npt.NDArray[np.uint8],
    depth: npt.NDArray[np.float32],
    camera: Pinhole,
    mask: Mask | None,
    guess: Array,
    radius: float,
) -> Segments:
    """Return the image taken apart into the object and all else, as segmentation hands it on."""
    shown = depth > 0.0
    if mask is None:
        points = camera.rays() * depth[..., None]
        own = shown & (np.linalg.norm(points - guess[:3, 3], axis=2) < radius + TUNING.about)
    else:
        own = shown & mask
    if np.count_nonzero(own) < TUNING.fewest:
        where = "near X_CO" if mask is None else "under the mask"
        raise ArgumentError(f"depth: {np.count_nonzero(own)} pixels with depth {where}; {TUNING.fewest} are needed")
    stride = TUNING.stride if np.count_nonzero(own) >= TUNING.small else 1
    coarse, taken = depth[::stride, ::stride], own[::stride, ::stride]
    row, column = np.nonzero(taken)
    places, normals = surface_at(coarse, camera.rays(stride), (row, column), camera.p_WC)
    labels = np.full(coarse.shape, SEGMENTS.background, dtype=np.int16)
    labels[coarse <= 0.0] = SEGMENTS.no_depth
    labels[taken] = 0
    every: Any = rgb[row * stride, column * stride] / 255.0
    nowhere = np.array([0.0, 0.0, -1e3])  # a table behind the camera hides and holds nothing
    number = np.zeros(len(row), dtype=np.int64)
    return Segments(0.0, places, normals, every, number, 1, labels, stride, depth, rgb, camera, nowhere)


def _matrix(R: Array, p: Array) -> Array:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = R, p
    return X
