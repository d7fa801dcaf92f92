"""Finds planes in a depth image: the one that things stand on, and others as level, such as shelves.

A plane is linear in inverse depth, 1 / z = slope · ray, and stereo cameras' noise is even in it: so planes are fitted
there, first to small blocks of pixels, whose sums add up to those of larger regions, then to pixels. Nothing is drawn
at random.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array

Mask = npt.NDArray[np.bool_]
Noise = Callable[[Array], Array]
"""Standard deviation of depth [m] by depth [m]."""


@dataclass(frozen=True)
class Tuning:
    """Constants of the search for planes, chosen by hand on ray-cast scenes and one real image (mOSD's `learn/learn5`).

    `tests/perception/segmentation/test_planes.py` shows what is found, `sims/benchmarks/kinect_tabletop.py` on more
    real images.
    """

    columns: int = 128
    """Pixels across the image that are looked at: farther apart than the noise of neighbours is alike."""

    block: int = 4
    """Edge of a block of such pixels; 2 × 2 neighbouring blocks make one patch, about 5 cm at 1 m."""

    filled: float = 0.6
    """Share of a patch's pixels that must have depth."""

    flat_sigmas: float = 3.0
    """A patch is flat where its residuals are below this many of the told standard deviations."""

    most_excess: float = 6.0
    """Noise is at most so many times what is told."""

    patch_angle: float = 0.5
    """A patch's normal is worth no more than this [rad]: noise of correlated pixels tilts it."""

    seeds: int = 48
    """Patches from which planes are grown."""

    survivors: int = 8
    """Planes that are grown on after the first round, those of most patches, or, where a height is told, those that it
    makes likely: else all of them may be one and the same plane, which it makes unlikely."""

    reaches: tuple[float, ...] = (0.05, 0.03, 0.02, 0.012, 0.01)
    """How far off a growing plane its patches may lie, round by round [m] at the least; noise adds to it."""

    least_area: float = 0.003
    """Surface of a thing's lid that could hold something [m²]: that of a can."""

    least_width: float = 0.04
    """And its width [m]; a wall is as wide as its depth noise at any one height."""

    least_bin: float = 0.004
    """Heights closer than this are alike [m]; noise adds to it."""

    other_tilt: float = 0.15
    """Surfaces on which things stand are no farther from parallel to the table [rad]."""

    least_support: float = 0.03
    """Surface of a plane that is taken for the table [m²]: an open square of 17 cm."""

    pixels: int = 5000
    """Pixels of the final fit at most."""

    rounds: int = 3
    """Rounds of reweighted least squares on pixels."""

    tukey: float = 4.0
    """Residuals beyond this many standard deviations belong to something else."""


TUNING = Tuning()


@dataclass(frozen=True)
class Plane:
    """The plane normal · x = offset in W [m].

    Attributes:
        normal: (3,) unit, towards the camera.
        offset: [m]
        area: surface seen [m²].
        part: whose it is: number of a thing in the image, or -1: none's.
    """

    normal: Array
    offset: float
    area: float
    part: int = -1

    @property
    def graph(self) -> Array:
        """(a, b, c) of z = a x + b y + c."""
        a, b, c = self.normal
        return np.array([-a / c, -b / c, self.offset / c])

    def height(self, points_W: Array) -> Array:
        """Return how far points (..., 3) lie off the plane, on the camera's side [m]."""
        return np.asarray(points_W @ self.normal - self.offset)


@dataclass(frozen=True)
class Told:
    """What is known of planes before an image is seen.

    Attributes:
        up: (3,) unit, away from the ground in W; None: nothing is known, any plane that faces the camera will do.
        largest_tilt: angle that a plane's normal may have with `up` [rad].
        height: along `up` [m]; None: unknown.
        search: a plane is not looked for farther than this from `height` [m], measured below `middle`.
        middle: (3,) where heights are compared, and about which things are looked for, in W.
    """

    up: Array | None = None
    largest_tilt: float = 0.44
    height: float | None = None
    search: float = 0.15
    middle: Array | None = None


@dataclass(frozen=True)
class _Patches:
    """Flat patches of the image: sums of `v r rᵀ`, `v w r`, how many pixels, mean ray and inverse depth, area."""

    A: Array
    b: Array
    count: Array
    ray: Array
    inverse: Array
    slope: Array
    area: Array
    sigma: Array


def find_plane(
    depth: npt.NDArray[np.floating[Any]], rays: Array, p_WC: Array, noise: Noise, told: Told
) -> Plane | None:
    """Find the largest plane that faces the camera and is as level as is told: the one that things stand on.

    Args:
        depth: (h, w) [m], 0 where there is none or where nothing is looked for.
        rays: (h, w, 3) in W, from the camera to the point at depth 1 m.
        p_WC: (3,) the camera's place.
        noise: standard deviation of depth by depth; a sheet that tells too little does no harm.
        told: prior knowledge; a told height makes nearer planes count for more.

    Returns:
        The plane; None where there is none of some size.
    """
    step = max(1, depth.shape[1] // TUNING.columns)
    z = np.asarray(depth[::step, ::step], dtype=float)
    r = np.asarray(rays[::step, ::step], dtype=float)
    patches = _flat_patches(z, r, noise)
    largest = _largest(patches, p_WC, told) if len(patches.count) else None
    if largest is None:
        return None
    slope = _refined(z[::2, ::2], r[::2, ::2], largest[0], noise)
    return _plane(slope, p_WC, float(patches.area[largest[1]].sum()))


def level_surfaces(
    points_W: Array, part: npt.NDArray[np.int64], areas: Array, table: Plane, sigma: float
) -> list[Plane]:
    """Find surfaces parallel to the table on which something could stand: lids of boxes, shelves.

    Args:
        points_W: (N, 3) of things.
        part: (N,) which thing, from 0.
        areas: (N,) surface that a point stands for where it is seen square on [m²].
        table: what the things stand on, or are above.
        sigma: standard deviation of the points off the table [m].

    Returns:
        Planes, at most one a thing, its largest; the largest first.
    """
    bin_ = max(TUNING.least_bin, 2.0 * sigma)
    height, axes = table.height(points_W), _axes(table)
    found = []
    order = np.argsort(part, kind="stable")
    starts = np.searchsorted(part[order], np.arange(int(part.max(initial=-1)) + 2))
    for k in range(len(starts) - 1):
        own = order[starts[k] : starts[k + 1]]
        if not len(own):
            continue
        count = np.bincount(np.maximum(height[own] / bin_, 0.0).astype(np.int64), weights=areas[own])
        among = count + np.append(count[1:], 0.0)
        best = int(np.argmax(among))
        if among[best] < TUNING.least_area:
            continue
        on = own[np.abs(height[own] - (best + 1) * bin_) < 2.0 * bin_]
        plane = _fitted(points_W[on], height[on], table, axes, bin_)
        if plane is not None:
            here = own[np.abs(plane.height(points_W[own])) < bin_]
            area = float(areas[here].sum())
            if area > TUNING.least_area and _width(points_W[here], plane) > TUNING.least_width:
                found.append(Plane(plane.normal, plane.offset, area, k))
    return sorted(found, key=lambda plane: -plane.area)


def _axes(plane: Plane) -> Array:
    """Two directions (2, 3) along a plane."""
    return np.asarray(np.linalg.svd(plane.normal[None])[2][1:])


def _width(points: Array, plane: Plane) -> float:
    """Smallest extent of points along a plane, as if they filled a strip evenly [m]."""
    spread = np.cov(points @ _axes(plane).T, rowvar=False)
    return float(np.sqrt(12.0 * max(np.linalg.eigvalsh(spread)[0], 0.0)))


def _fitted(points: Array, height: Array, table: Plane, axes: Array, width: float) -> Plane | None:
    """Robust plane through points about as high above the table; None if it is not parallel to it."""
    middle = points.mean(axis=0)
    A = np.column_stack([(points - middle) @ axes.T, np.ones(len(points))])
    weight: Array = np.ones(len(points))
    coefficient: Array = np.zeros(3)
    for _ in range(TUNING.rounds):
        weighted = A * weight[:, None]
        coefficient = np.asarray(np.linalg.solve(A.T @ weighted + 1e-9 * np.eye(3), weighted.T @ height), dtype=float)
        weight = np.asarray(np.maximum(1.0 - ((height - A @ coefficient) / (2.0 * width)) ** 2, 0.0) ** 2)
    if np.linalg.norm(coefficient[:2]) > np.tan(TUNING.other_tilt):
        return None
    normal = table.normal - coefficient[:2] @ axes
    normal = normal / np.linalg.norm(normal)
    at = middle - (middle @ table.normal - table.offset - coefficient[2]) * table.normal
    return Plane(normal, float(normal @ at), 0.0)


def _flat_patches(z: Array, r: Array, noise: Noise) -> _Patches:
    valid = z > 0
    w = np.where(valid, 1.0 / np.where(valid, z, 1.0), 0.0)
    # Sums over blocks of all products of (ray, inverse depth, 1); then over 2 × 2 blocks that overlap by half.
    edge = TUNING.block
    terms = np.stack([*(r * valid[..., None]).transpose(2, 0, 1), w, valid])
    first, second = np.triu_indices(5)
    # A term's products at a time: what is larger does not stay in the processor's cache.
    blocks = np.concatenate([block_sums(term * terms[k:], edge) for k, term in enumerate(terms)])
    each = (blocks[:, :-1, :-1] + blocks[:, 1:, :-1] + blocks[:, :-1, 1:] + blocks[:, 1:, 1:]).reshape(len(first), -1).T
    each = each[each[:, -1] >= TUNING.filled * (2 * edge) ** 2]
    sums: Array = np.empty((len(each), 5, 5))
    sums[:, first, second] = sums[:, second, first] = each
    count = sums[:, 4, 4]
    A, b = sums[:, :3, :3], sums[:, :3, 3]
    if not len(count):
        return _Patches(A, b, count, b, count, b, count, count)
    ray, inverse = sums[:, :3, 4] / count[:, None], sums[:, 3, 4] / count
    held = A + 1e-9 * count[:, None, None] * np.eye(3)
    slope: Array = np.asarray(np.linalg.solve(held, b[..., None])[..., 0], dtype=float)
    spread = np.sqrt(np.maximum(sums[:, 3, 3] - np.einsum("ni,ni->n", slope, b), 0.0) / np.maximum(count - 3.0, 1.0))
    depth = 1.0 / inverse
    sigma: Array = np.asarray(noise(depth), dtype=float)
    # Where the sheet tells too little of the noise, most patches say so.
    sigma = sigma * float(np.clip(np.percentile(spread * depth**2 / sigma, 30.0), 1.0, TUNING.most_excess))
    flat = spread < TUNING.flat_sigmas * sigma / depth**2
    facing = np.maximum(np.abs(np.einsum("ni,ni->n", slope, ray)) / np.linalg.norm(slope, axis=1), 0.05)
    # A block's solid angle, from the rays of two neighbours.
    pixel = float(np.linalg.norm(np.cross(r[1, 0] - r[0, 0], r[0, 1] - r[0, 0])))
    area = pixel * edge**2 * depth**2 / facing
    return _selected(_Patches(A, b, count, ray, inverse, slope, area, sigma), flat)


def block_sums(images: Array, edge: int) -> Array:
    """Return the sums (k, h // edge, w // edge) of images (k, h, w) over blocks; what is left at their ends is not."""
    height, width = (size // edge * edge for size in images.shape[1:])
    rows = sum((images[:, k:height:edge, :width] for k in range(1, edge)), images[:, 0:height:edge, :width])
    return np.asarray(sum((rows[..., k::edge] for k in range(1, edge)), rows[..., ::edge]))


def _selected(patches: _Patches, keep: Mask) -> _Patches:
    return _Patches(*(value[keep] for value in vars(patches).values()))


def _off(patches: _Patches, slopes: Array) -> Array:
    """Distances (K, N) of patches to planes [m], on the camera's side."""
    camera = 1.0 / np.linalg.norm(slopes, axis=1)
    return np.asarray(camera[:, None] * (1.0 - slopes @ patches.ray.T / patches.inverse))


def _allowed(slopes: Array, p_WC: Array, told: Told, slack: float = 0.0) -> Mask:
    """Which planes (K, 3) are as level and as high as told."""
    normals = -slopes / np.linalg.norm(slopes, axis=1, keepdims=True)
    result = np.ones(len(slopes), dtype=bool)
    if told.up is None:
        return result
    result &= normals @ told.up > np.cos(told.largest_tilt + slack)
    if told.height is not None:
        away = np.abs(_height(slopes, p_WC, told) - told.height)
        result &= away < told.search + (0.05 if slack else 0.0)
    return result


def _height(slopes: Array, p_WC: Array, told: Told) -> Array:
    """Where the line along `up` through `middle` meets planes (K, 3): the height there [m]."""
    assert told.up is not None
    normals = -slopes / np.linalg.norm(slopes, axis=1, keepdims=True)
    offset = normals @ p_WC - 1.0 / np.linalg.norm(slopes, axis=1)
    middle = np.zeros(3) if told.middle is None else told.middle - (told.middle @ told.up) * told.up
    return np.asarray((offset - normals @ middle) / np.maximum(normals @ told.up, 1e-3))


def _largest(patches: _Patches, p_WC: Array, told: Told) -> tuple[Array, Mask] | None:
    """Grow planes from patches all over the image; the slope of the best and which patches are its own."""
    start = np.flatnonzero(_allowed(patches.slope, p_WC, told, TUNING.patch_angle))
    if not len(start):
        return None
    slopes = patches.slope[start[:: -(-len(start) // TUNING.seeds)]]
    normal = patches.slope / np.linalg.norm(patches.slope, axis=1, keepdims=True)
    products = np.concatenate([patches.A.reshape(-1, 9), patches.b], axis=1)
    members = np.zeros((len(slopes), len(normal)), dtype=bool)
    for reach in TUNING.reaches:
        near = np.abs(_off(patches, slopes)) < np.maximum(reach, 1.5 * patches.sigma)
        alike = slopes @ normal.T > np.cos(TUNING.patch_angle) * np.linalg.norm(slopes, axis=1, keepdims=True)
        members = near & alike
        size = members.sum(axis=1) if told.height is None else _scores(patches, members, slopes, p_WC, told)
        largest = np.sort(np.argsort(-size, kind="stable")[: TUNING.survivors])
        members = members[largest[size[largest] > 0]]
        sums = members.astype(float) @ products
        weight = members.sum(axis=1)[:, None, None]
        slopes = np.linalg.solve(sums[:, :9].reshape(-1, 3, 3) + 1e-9 * weight * np.eye(3), sums[:, 9:, None])[..., 0]
    area = members @ patches.area
    good = _allowed(slopes, p_WC, told) & (area > TUNING.least_support)
    if not good.any():
        return None
    best = int(np.argmax(np.where(good, _scores(patches, members, slopes, p_WC, told), 0.0)))
    return slopes[best], members[best]


def _scores(patches: _Patches, members: Mask, slopes: Array, p_WC: Array, told: Told) -> Array:
    """Return the areas of planes (K,), less where they are farther from a told height.

    Args:
        patches: flat ones.
        members: (K, N) which of them are whose.
        slopes: (K, 3) of the planes.
        p_WC: (3,)
        told: prior knowledge.
    """
    area = members @ patches.area
    if told.up is None or told.height is None:
        return np.asarray(area)
    return np.asarray(area / (1.0 + ((_height(slopes, p_WC, told) - told.height) / told.search) ** 2))


def _refined(z: Array, r: Array, slope: Array, noise: Noise) -> Array:
    """Reweighted least squares in inverse depth with Tukey's weights, on the pixels near a plane."""
    off = (1.0 - z * (r @ slope)) / np.linalg.norm(slope)
    near = (z > 0) & (np.abs(off) < np.maximum(TUNING.reaches[-2], TUNING.tukey * np.asarray(noise(z))))
    rays, depth = r[near], z[near]
    thin = 1 + len(depth) // TUNING.pixels
    rays, depth = rays[::thin], depth[::thin]
    w = 1.0 / depth
    told = depth**2 / np.asarray(noise(depth), dtype=float)
    for _ in range(TUNING.rounds):
        if len(w) < 10:
            return slope
        residual = (w - rays @ slope) * told
        scale = max(1.4826 * float(np.median(np.abs(residual))), 0.3)
        weight = np.maximum(1.0 - (residual / (TUNING.tukey * scale)) ** 2, 0.0) ** 2 * told**2
        weighted = rays * weight[:, None]
        slope = np.linalg.solve(rays.T @ weighted + 1e-9 * weight.sum() * np.eye(3), weighted.T @ w)
    return np.asarray(slope)


def _plane(slope: Array, p_WC: Array, area: float) -> Plane:
    distance = 1.0 / float(np.linalg.norm(slope))
    normal = -slope * distance
    return Plane(normal, float(normal @ p_WC) - distance, area)
