"""Takes an RGB-D image apart: planes, robot, and the things that stand on the table or on one another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram import scenario
from twin_diagram.perception.pinhole import (
    ColourImage,
    DepthImage,
    Pinhole,
    surface_at,
)
from twin_diagram.perception.segmentation.hovering import Sight, without_hovering
from twin_diagram.perception.segmentation.parting import Labels, follow_nearest, grown, part
from twin_diagram.perception.segmentation.planes import TUNING as PLANES
from twin_diagram.perception.segmentation.planes import Plane, Told, find_plane, level_surfaces
from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.segmentation.walls import walls
from twin_diagram.signals.arrays import Array

Mask = npt.NDArray[np.bool_]
Near = Callable[[Array, float], Mask]
"""(points_W (N, 3), margin [m]) to which of them lie within the margin of the robot."""
Index = npt.NDArray[np.int64]
Small = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Tuning:
    """Constants of segmentation, chosen by hand for a tabletop.

    `tests/perception/segmentation` shows what is detected, `sims/closed_loop.py --seeds 20` in the loop,
    `sims/benchmarks/segmentation.py` how fast.
    """

    table_search: float = 0.15
    """The table's top is looked for within this of its told height [m]."""

    largest_tilt: float = 0.4
    """A table steeper than this is none [rad]: things would slide off."""

    table_sigmas: float = 4.0
    """What stands out of the table by less than this many standard deviations of depth is the table's."""

    wide: int = 480
    """Images of so many pixels across are parted at every second pixel; the others follow the nearest [pixel]."""

    inner_share: float = 0.4
    """Of the robot's clearance: points nearer than this are the robot's even where a thing's surface leads there."""

    rim_share: float = 1.5
    """Times the robot's clearance: a part that stays within it is what the robot's model leaves over, no thing."""

    beyond: float = 0.15
    """Share of a part's points that must lie beyond that rim."""

    reclaimed: int = 6
    """How far a thing's surface is followed towards the robot [pixel of the working grid]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Grid:
    """A camera's rays at every `stride`-th pixel, computed once.

    Attributes:
        camera: the calibrated camera.
        stride: [pixel]
        rays: (h, w, 3) in W, to the points at depth 1 m.
        small: the same, single precision.
        coarse: rays at every so many pixels that planes can be found on them.
        pitch: distance between neighbouring rays at depth 1 m [m].
    """

    camera: Pinhole
    stride: int
    rays: Array
    small: Small
    coarse: Array
    pitch: float

    @staticmethod
    def of(camera: Pinhole, stride: int) -> Grid:
        """Return the rays of a camera."""
        rays = camera.rays(stride)
        step = max(1, rays.shape[1] // PLANES.columns)
        coarse = np.ascontiguousarray(rays[::step, ::step])
        return Grid(camera, stride, rays, rays.astype(np.float32), coarse, stride / camera.focal)

    def noise(self, depth: npt.ArrayLike) -> Array:
        """Return the told standard deviation of depth [m]."""
        return self.camera.depth_noise(np.asarray(depth, dtype=float))


@dataclass(frozen=True)
class Apart:
    """An image's labels.

    Attributes:
        label_image: (h, w) a thing's number or one of `segments.TUNING`.
        count: how many things there are.
        table: the plane that they stand on; None: none is in view.
    """

    label_image: npt.NDArray[np.int16]
    count: int
    table: Plane | None


def clean(depth: DepthImage) -> DepthImage:
    """Return depth with 0 where it is not a positive finite number, single precision."""
    depth = np.asarray(depth, dtype=np.float32)
    return np.where((depth > 0) & (depth < np.float32(1e3)), depth, np.float32(0.0))


def level(height: float) -> Plane:
    """Return the level plane at a height [m]."""
    return Plane(np.array([0.0, 0.0, 1.0]), height, 0.0)


def support_plane(depth: DepthImage, grid: Grid, params: scenario.Perception) -> Plane | None:
    """Find the table in the workspace.

    Args:
        depth: (h, w) at the grid's pixels [m], 0 where there is none.
        grid: of the camera.
        params: tuning; `table_height` is a prior.

    Returns:
        Its top; None where it is not in view.
    """
    step = max(1, depth.shape[1] // PLANES.columns)
    z, rays = depth[::step, ::step], grid.coarse
    low, high = np.asarray(params.workspace, dtype=float)
    x, y = (grid.camera.p_WC[k] + z * rays[..., k] for k in (0, 1))
    z = np.where((x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1]), z, np.float32(0.0))
    told = Told(
        up=np.array([0.0, 0.0, 1.0]),
        largest_tilt=TUNING.largest_tilt,
        height=params.table_height,
        search=TUNING.table_search,
        middle=(low + high) / 2,
    )
    return find_plane(z, rays, grid.camera.p_WC, grid.noise, told)


def standing_out(depth: DepthImage, grid: Grid, table: Plane, params: scenario.Perception) -> Mask:
    """Return which pixels (h, w) show what is in the workspace and higher above the table than noise explains.

    The workspace's heights count from the table's told height and go with the table that was found.

    Args:
        depth: (h, w) at the grid's pixels [m], 0 where there is none.
        grid: of the camera.
        table: as found.
        params: tuning.
    """
    p_WC = grid.camera.p_WC
    facing = (grid.small.reshape(-1, 3) @ table.normal.astype(np.float32)).reshape(depth.shape)
    height = depth * facing
    height += np.float32(p_WC @ table.normal - table.offset)
    low, high = (np.asarray(corner, dtype=float) for corner in params.workspace)
    up = table.normal[2]
    floor, ceiling = up * (low[2] - params.table_height), up * (high[2] - params.table_height)
    above, below = np.float32(max(params.table_clearance, floor)), np.float32(ceiling)
    result = height > above
    result &= height < below
    at = np.flatnonzero(result)
    z = depth.ravel()[at]
    slack = TUNING.table_sigmas * grid.noise(z) * np.abs(facing.ravel()[at])
    keep = (height.ravel()[at] > slack) & (z > 0)
    rays = grid.small.reshape(-1, 3)
    for k in (0, 1):
        place = np.float32(p_WC[k]) + z * rays[at, k]
        keep &= (place > low[k]) & (place < high[k])
    result.ravel()[at[~keep]] = False
    return result


def label_pixels(
    depth: DepthImage,
    grid: Grid,
    params: scenario.Perception,
    near_robot: Near | None = None,
    *,
    in_a_room: bool = False,
) -> Apart:
    """Label each pixel of the grid: a thing, the robot, no depth, or background.

    Args:
        depth: (h, w) at the grid's pixels [m], 0 where there is none.
        grid: of the camera.
        params: tuning.
        near_robot: see `Near`.
        in_a_room: whether walls may be in the workspace, which are no things.

    Returns:
        Labels; things are numbered in the order of their first pixel.
    """
    table = support_plane(depth, grid, params)
    standing = standing_out(depth, grid, table or level(params.table_height), params)
    if in_a_room:
        standing &= ~walls(depth, standing, grid.rays, grid.camera.p_WC, grid.noise)
    step = 2 if depth.shape[1] >= TUNING.wide else 1
    z, stands = np.ascontiguousarray(depth[::step, ::step]), np.ascontiguousarray(standing[::step, ::step])
    part_of = _things(z, stands, grid, step, params, near_robot)
    part_of = _held_up(part_of, z, grid, step, table or level(params.table_height), params)
    if step > 1:
        part_of = follow_nearest(part_of, z, depth, standing, params.cluster_gap)
    label_image = part_of.astype(np.int16)
    np.putmask(label_image, depth == 0, np.int16(SEGMENTS.no_depth))
    return Apart(label_image, int(part_of.max(initial=-1)) + 1, table)


def _held_up(
    part_of: Labels, z: DepthImage, grid: Grid, step: int, table: Plane, params: scenario.Perception
) -> Labels:
    """Join what hovers to what it hangs on; see `hovering`."""
    count = int(part_of.max(initial=-1)) + 1
    if count < 2:
        return part_of
    at = np.flatnonzero(part_of >= 0)
    p_WC, up = grid.camera.p_WC, table.normal
    facing = grid.small[::step, ::step].reshape(-1, 3)[at] @ up.astype(np.float32)
    height = np.zeros(z.shape, dtype=np.float32)
    height.ravel()[at] = z.ravel()[at] * facing + np.float32(p_WC @ up - table.offset)
    least = max(params.table_clearance, TUNING.table_sigmas * float(grid.noise(np.median(z.ravel()[at]))))
    sight = Sight.of(grid.camera.R_WC, up, grid.pitch * step)
    return without_hovering(part_of, z, height, least, params.cluster_gap, sight)


def _things(
    z: DepthImage, stands: Mask, grid: Grid, step: int, params: scenario.Perception, near_robot: Near | None
) -> Labels:
    """Part what stands at every `step`-th pixel of the grid; the robot's pixels get its label."""
    scale = (grid.stride * step) ** 2 / max(params.stride, grid.stride) ** 2
    smallest = max(1, round(params.smallest / scale))
    typical = np.median(z[stands]) if stands.any() else np.float32(1.0)
    sigma = float(grid.noise(typical))
    robot = np.zeros(z.shape, dtype=bool)
    spare = robot
    if near_robot is not None and stands.any():
        row, column = np.nonzero(stands)
        points = _points(z, grid, step, row, column)
        near = near_robot(points, params.robot_clearance)
        robot[row[near], column[near]] = True
        inner = near_robot(points[near], TUNING.inner_share * params.robot_clearance)
        spare = robot.copy()
        spare[row[near][inner], column[near][inner]] = False
    label, count = part(z, stands & ~robot, grid.pitch * step, sigma, params.cluster_gap, smallest)
    if near_robot is None or not robot.any():
        return label
    label = _without_rims(label, count, robot, z, grid, step, params.robot_clearance, near_robot)
    robot |= label == SEGMENTS.robot
    label[robot] = SEGMENTS.background
    label = np.where(spare & (label < 0), grown(label, spare, TUNING.reclaimed), label)
    label[robot & (label < 0)] = SEGMENTS.robot
    return label


def _points(z: DepthImage, grid: Grid, step: int, row: Index, column: Index) -> Array:
    rays = grid.rays[::step, ::step][row, column]
    return np.asarray(grid.camera.p_WC + z[row, column][:, None].astype(float) * rays)


def _without_rims(
    label: Labels,
    count: int,
    robot: Mask,
    z: DepthImage,
    grid: Grid,
    step: int,
    clearance: float,
    near_robot: Near,
) -> Labels:
    """Give parts that border on the robot and hardly reach beyond its rim to the robot; number the others anew."""
    around = cv2.dilate(robot.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    number = np.arange(count + 1, dtype=np.int32)
    number[count] = SEGMENTS.background
    for k in np.unique(label[around & (label >= 0)]):
        row, column = np.nonzero(label == k)
        thin = 1 + len(row) // 400
        near = near_robot(_points(z, grid, step, row[::thin], column[::thin]), TUNING.rim_share * clearance)
        if np.mean(~near) < TUNING.beyond:
            number[k] = SEGMENTS.robot
    things = np.flatnonzero(number[:count] >= 0)
    number[things] = np.arange(len(things), dtype=np.int32)
    return np.asarray(number[label], dtype=np.int32)


def segment(
    rgb: ColourImage,
    depth: DepthImage,
    time: float,
    grid: Grid,
    params: scenario.Perception,
    near_robot: Near | None = None,
    *,
    in_a_room: bool = False,
) -> Segments:
    """Find what stands on the table and is not the robot.

    Args:
        rgb: (H, W, 3)
        depth: (H, W) [m], 0 (or not finite) where there is none.
        time: capture time [s].
        grid: of the camera, with the stride of `params`.
        params: tuning.
        near_robot: (points_W (N, 3), margin) to a mask (N,) of the robot's points.
        in_a_room: whether walls may be in the workspace, which are no things.

    Returns:
        Segments in the order of their first pixel.
    """
    depth = clean(depth)
    coarse = np.ascontiguousarray(depth[:: grid.stride, :: grid.stride])
    apart = label_pixels(coarse, grid, params, near_robot, in_a_room=in_a_room)
    return gathered(rgb, depth, time, grid, apart, params.table_height)


def gathered(
    rgb: ColourImage, depth: DepthImage, time: float, grid: Grid, apart: Apart, table_height: float = 0.0
) -> Segments:
    """Return the points, normals and colours of labelled pixels.

    Args:
        rgb: (H, W, 3)
        depth: (H, W) [m], as of `clean`.
        time: capture time [s].
        grid: of the camera.
        apart: labels on the grid.
        table_height: told, where no table is in view [m].
    """
    coarse = depth[:: grid.stride, :: grid.stride]
    row, column = np.nonzero(apart.label_image >= 0)
    labels = apart.label_image[row, column].astype(np.int64)
    here, normals = surface_at(coarse, grid.rays, (row, column), grid.camera.p_WC)
    z = coarse[row, column]
    planes: tuple[Plane, ...] = ()
    if apart.table is not None:
        facing = np.maximum(np.abs(grid.rays[row, column] @ apart.table.normal), 0.05)
        sigma = float(grid.noise(np.median(z))) if len(z) else 0.0
        areas = (grid.pitch * z.astype(float)) ** 2 / facing
        planes = (apart.table, *level_surfaces(here, labels, areas, apart.table, sigma))
    return Segments(
        time=time,
        points_W=here,
        normals_W=normals,
        colours=rgb[row * grid.stride, column * grid.stride] / 255.0,
        labels=labels,
        count=apart.count,
        label_image=apart.label_image,
        stride=grid.stride,
        depth=depth.copy(),
        rgb=rgb.copy(),
        camera=grid.camera,
        table=(apart.table or level(table_height)).graph,
        planes=planes,
    )
