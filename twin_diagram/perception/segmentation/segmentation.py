"""Takes an RGB-D image apart: table, robot, and the objects that stand on the table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from twin_diagram import scenario
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.pinhole import (
    ColourImage,
    DepthImage,
    Pinhole,
    back_project,
    grid_normals,
)
from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of segmentation, chosen by hand for a tabletop.

    `tests/perception/segmentation` shows what is detected, `sims/closed_loop.py --seeds 20` in the loop.
    """

    table_search: float = 0.015
    """The table's top is looked for within this of its known height [m]."""

    largest_tilt: float = 0.02
    """A refined table steeper than this is not believed [rad]: a good degree."""

    table_sigmas: float = 4.0
    """What stands out of the table by less than this many standard deviations of depth is the table's."""


TUNING = Tuning()


@dataclass(frozen=True)
class Grid:
    """A camera's rays at every `stride`-th pixel, computed once."""

    camera: Pinhole
    stride: int
    rays: Array

    @staticmethod
    def of(camera: Pinhole, stride: int) -> Grid:
        """Return the rays of a camera."""
        return Grid(camera, stride, camera.rays(stride))


def fit_table(points_W: Array, height: float) -> Array:
    """Return the table's top from points near its known height.

    Args:
        points_W: (N, 3), all sorts of points.
        height: known height [m].

    Returns:
        (a, b, c) of z = a x + b y + c; the level plane at `height` where too few points lie near it or the fit tilts
        too far.
    """
    level = np.array([0.0, 0.0, height])
    near = points_W[np.abs(points_W[:, 2] - height) < TUNING.table_search]
    near = near[:: max(1, len(near) // 4000)]
    if len(near) < 200:
        return level
    middle = near[:, :2].mean(axis=0)
    A = np.column_stack([near[:, :2] - middle, np.ones(len(near))])
    weight = np.ones(len(near))
    plane = level
    for _ in range(4):
        weighted = A * weight[:, None]
        plane = np.linalg.solve(A.T @ weighted + 1e-9 * np.eye(3), weighted.T @ near[:, 2])
        residual = near[:, 2] - A @ plane
        scale = max(1.4826 * float(np.median(np.abs(residual))), 5e-4)
        weight = np.maximum(1.0 - (residual / (4.0 * scale)) ** 2, 0.0) ** 2
    if np.abs(plane[:2]).max() > TUNING.largest_tilt:
        return level
    return np.array([plane[0], plane[1], plane[2] - plane[:2] @ middle])


def connected(points: Array, inside: Mask, gap: float) -> npt.NDArray[np.int64]:
    """Number the connected parts of an organised cloud: neighbours in the image no farther apart than `gap`.

    Neighbours are up to two pixels away, so that single pixels without depth do not cut an object in two.

    Args:
        points: (h, w, 3).
        inside: (h, w), the pixels that take part.
        gap: [m]

    Returns:
        (N,) a part's number for each pixel of `inside`, in row-major order.
    """
    number = np.full(inside.shape, -1, dtype=np.int64)
    count = int(inside.sum())
    if not count:
        return np.zeros(0, dtype=np.int64)
    number[inside] = np.arange(count)
    flat = points[inside]
    first, second = [], []
    height, width = inside.shape
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0)):
        a = number[: height - dr, max(-dc, 0) : width - max(dc, 0)]
        b = number[dr:, max(dc, 0) : width + min(dc, 0)]
        both = (a >= 0) & (b >= 0)
        a, b = a[both], b[both]
        step = flat[a] - flat[b]
        near = np.einsum("ni,ni->n", step, step) < gap * gap
        first.append(a[near])
        second.append(b[near])
    i, j = np.concatenate(first), np.concatenate(second)
    graph = coo_matrix((np.ones(len(i), dtype=np.int8), (i, j)), shape=(count, count))
    _, part = connected_components(graph, directed=False)
    return np.asarray(part, dtype=np.int64)


def in_workspace(points: Array, workspace: Sequence[Sequence[float]]) -> Mask:
    """Return which points (h, w, 3) lie strictly within the box between two corners in W [m]."""
    low, high = np.asarray(workspace, dtype=float)
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    return np.asarray((x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1]) & (z > low[2]) & (z < high[2]))


def above_table(
    points: Array, depth: DepthImage, table: Array, least: float, depth_noise: DepthSigma | None = None
) -> Mask:
    """Return which points (h, w, 3) are higher above the table than noise explains.

    Args:
        points: (h, w, 3) in W.
        depth: (h, w) [m], of which the noise depends.
        table: (a, b, c) of the table z = a x + b y + c.
        least: height that is always asked for [m].
        depth_noise: of the camera's data sheet; None: `DepthSigma`'s own.
    """
    clearance = np.maximum(least, TUNING.table_sigmas * (depth_noise or DepthSigma())(depth))
    return np.asarray(points[..., 2] - (table[0] * points[..., 0] + table[1] * points[..., 1] + table[2]) > clearance)


def large_parts(part: npt.NDArray[np.int64], smallest: int) -> tuple[npt.NDArray[np.int64], int]:
    """Number the parts that are large enough.

    Args:
        part: (N,) a part's number for each pixel.
        smallest: pixels that a part must have.

    Returns:
        (N,) the large parts' new numbers in the order of the old, -1 for the others; how many are large.
    """
    size = np.bincount(part) if part.size else np.zeros(0, dtype=np.int64)
    large = size >= smallest
    renumber = np.full(len(size), -1, dtype=np.int64)
    renumber[large] = np.arange(int(large.sum()))
    return renumber[part] if part.size else part, int(large.sum())


def segment(
    rgb: ColourImage,
    depth: DepthImage,
    time: float,
    grid: Grid,
    params: scenario.Perception,
    near_robot: Callable[[Array, float], Mask] | None = None,
) -> Segments:
    """Find what stands on the table and is not the robot.

    Args:
        rgb: (H, W, 3)
        depth: (H, W) [m], 0 (or not finite) where there is none.
        time: capture time [s].
        grid: of the camera, with the stride of `params`.
        params: tuning.
        near_robot: (points_W (N, 3), margin) to a mask (N,) of the robot's points.

    Returns:
        Segments in the order of their first pixel.
    """
    depth = np.where(np.isfinite(depth), depth, np.float32(0.0)).astype(np.float32, copy=False)
    coarse = depth[:: grid.stride, :: grid.stride]
    valid = coarse > 0
    points = back_project(coarse, grid.rays, grid.camera.p_WC)
    inside = valid & in_workspace(points, params.workspace)
    table = fit_table(points[inside], params.table_height)
    standing = inside & above_table(points, coarse, table, params.table_clearance, grid.camera.depth_noise)

    label_image = np.full(coarse.shape, SEGMENTS.background, dtype=np.int16)
    label_image[~valid] = SEGMENTS.no_depth
    if near_robot is not None:
        row, column = np.nonzero(standing)
        robot = near_robot(points[row, column], params.robot_clearance)
        label_image[row[robot], column[robot]] = SEGMENTS.robot
        standing[row[robot], column[robot]] = False

    label, count = large_parts(connected(points, standing, params.cluster_gap), params.smallest)
    row, column = np.nonzero(standing)
    keep = label >= 0
    row, column, label = row[keep], column[keep], label[keep]
    label_image[row, column] = label.astype(np.int16)
    return Segments(
        time=time,
        points_W=points[row, column],
        normals_W=grid_normals(points, valid, (row, column), grid.camera.p_WC),
        colours=rgb[row * grid.stride, column * grid.stride] / 255.0,
        labels=label,
        count=count,
        label_image=label_image,
        stride=grid.stride,
        depth=depth.copy(),
        rgb=rgb.copy(),
        camera=grid.camera,
        table=table,
    )
