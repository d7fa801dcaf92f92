"""How thick a body's walls are where both of their sides show, and how likely it is a shell of such walls.

Plates, trays, cartons without a lid and stools show an edge: there views looked past it on one side and saw the other,
and a line that goes in where the surface was seen comes out again after a wall. What is thin so over a part of what was
seen is thin below as well, more likely than not. What shows no edge, as a bowl that stands on its rim, tells nothing of
walls; what is moulded to be open below slopes from its foot on, where cans and cartons stand upright.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.special import ndtr

from twin_diagram.assets.building.depth_view import Map
from twin_diagram.assets.building.fusion import DistanceField
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, set on training seeds of `sims/benchmarks/open_below.py`."""

    lines: int = 4000
    """Lines by which walls are measured."""

    share: float = 0.05
    """Of them the thinnest twentieth is a wall's: of a plate a fifth comes out below its rim, the farther in the
    later."""

    thin: tuple[float, float] = (0.12, 0.25)
    """Walls thinner than this share of the size (cube root of its box) make a shell, those above the second none:
    plates, trays, cartons, mugs and stools have 0.02 to 0.11, arches and what is sawn from planks 0.28 and more."""

    shell: float = 0.9
    """Chance that what has such walls has them below, too, where nobody looks."""

    moulded: float = 0.3
    """Chance that what slopes all around from its foot on is open below: bowls, cups and lids that lie on their rims
    are, soap and paperweights are not, and nothing above tells them apart."""

    slopes: tuple[float, float] = (0.06, 0.14)
    """Share of the ground a body covers that lies below what slopes in its lower half: below the first, it stands
    upright, as cans and boxes with rounded edges do, from the second on it slopes."""

    level: float = 0.12
    """What is less steep is flat [rad]: a lid's dome has 0.3."""

    usual: float = 0.035
    """A moulded wall's thickness of a body's size, where none shows: bowls, cups and lids have 0.03 to 0.037."""

    spread: float = 0.35
    """Standard deviation of the logarithm of how many times as thick a wall is below as where it shows."""

    floor: tuple[float, float] = (2.0, 0.5)
    """What lies on the support no more than so many walls below what was seen is a floor, which may be as thick as that
    or have a recess: this share of the chance counts there. A mug of forty views came out 5 % too small without."""

    core: float = 0.75
    """What lies deeper than this share of a wall, and is reached through such places from where nobody looked, counts.
    """

    whole: float = 0.5
    """What shows a part thinner than this share of the size is sawn or jointed, not moulded in one: an L has 0.33,
    bowls, cups and lids 0.7 and more."""


TUNING = Tuning()


def wall_chance(field: DistanceField, height: Array | None, sloping: float) -> Map:
    """Return the chance (nx, ny, nz) that a place within is empty, since walls are thinner than it lies deep.

    Args:
        field: where what no view told of is inside.
        height: (nx, ny, nz) above the support [m]; None: it stands on nothing, and nothing may be open below.
        sloping: of its surface; see `sloping_share`.
    """
    chance = np.zeros(field.distance.shape, np.float32)
    inside = field.distance < 0
    seen = inside & field.known
    if not seen.any() or (inside & ~field.known).sum() == 0:
        return chance
    at = np.argwhere(inside)
    low, high = at.min(axis=0), at.max(axis=0) + 1
    size = float(np.prod((high - low) * field.grid.voxel)) ** (1 / 3)
    wall = wall_thickness(field, height)
    sure = TUNING.shell * _falling(wall / size, TUNING.thin)
    if height is not None and wall > TUNING.whole * size:
        wall, sure = TUNING.usual * size, TUNING.moulded * (1.0 - _falling(sloping, TUNING.slopes))
    if sure <= 0.0:
        return chance
    box = tuple(slice(max(0, int(a) - 1), int(b) + 1) for a, b in zip(low, high, strict=True))
    surface = seen[box] & (field.distance[box] > -field.grid.voxel)
    if not surface.any():
        return chance
    deep = ndimage.distance_transform_edt(~surface, sampling=field.grid.voxel) + 0.5 * field.grid.voxel
    through = ndtr(np.log(deep / wall) / TUNING.spread)
    if height is not None:
        most, share = TUNING.floor
        through = np.where(deep + np.maximum(height[box], 0.0) < most * wall, share * through, through)
    unknown = inside[box] & ~field.known[box]
    below = np.zeros(unknown.shape, bool) if height is None else height[box] < field.grid.voxel
    core = unknown & (deep > TUNING.core * wall)
    # A handle's inside, of which all around was seen, is full.
    reached = ndimage.binary_propagation(core & ndimage.binary_dilation(~inside[box] | below), mask=core)
    chance[box] = np.where(reached, sure * through, 0.0)
    return chance


def wall_thickness(field: DistanceField, height: Array | None, seed: int = 0) -> float:
    """Return how long lines are that go in at right angles where a surface was seen, and come out: of the shortest [m].

    Those that reach the support do not count: what lies flat is no wall. None at all are infinite.

    Args:
        field: where what no view told of is inside.
        height: (nx, ny, nz) above the support [m], or None.
        seed: of the lines drawn.
    """
    step, inside = field.grid.voxel, field.distance < 0
    seen = inside & field.known & ndimage.binary_dilation(~inside)
    ground = np.zeros(inside.shape, bool) if height is None else height < step
    if height is not None:
        seen &= height > 2 * step
    at = np.argwhere(seen)
    at = at[np.random.default_rng(seed).permutation(len(at))[: TUNING.lines]]
    if not len(at):
        return np.inf
    smooth = ndimage.gaussian_filter(np.clip(field.distance, -3 * step, 3 * step), 1.5)
    inward = -np.stack([part[tuple(at.T)] for part in np.gradient(smooth)], axis=1)
    inward /= np.maximum(np.linalg.norm(inward, axis=1, keepdims=True), 1e-9)
    long, going = np.full(len(at), np.inf), np.ones(len(at), bool)
    most = np.array(inside.shape) - 1
    for cells in range(2, int(np.linalg.norm(most))):
        there = tuple(np.clip(np.rint(at[going] + cells * inward[going]).astype(int), 0, most).T)
        out = ~inside[there]
        which = np.flatnonzero(going)
        long[which[out & ~ground[there]]] = cells * step
        going[which[out | ground[there]]] = False
        if not going.any():
            break
    return float(np.sort(long)[int(TUNING.share * len(long))])


def sloping_share(
    vertices: Array, faces: npt.NDArray[np.int64], seen: npt.NDArray[np.bool_], plane: Array | None
) -> float:
    """Return the share of the ground below a body that lies below what slopes upwards in its lower half.

    Args:
        vertices: of its surface (V, 3) [m].
        faces: (F, 3), counter-clockwise from outside.
        seen: (V,) which of them were: what was not tells of no slope.
        plane: (4,) of its support, n·p = d, n up; None: nothing is below.
    """
    if plane is None:
        return 0.0
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a) / 2
    up = normal @ plane[:3]
    tilt = np.arccos(np.clip(up / np.maximum(np.linalg.norm(normal, axis=1), 1e-300), -1.0, 1.0))
    height = (a + b + c) @ plane[:3] / 3 - plane[3]
    lower = height < 0.5 * (vertices @ plane[:3] - plane[3]).max()
    side = lower & seen[faces].all(axis=1) & (tilt > TUNING.level) & (tilt < np.pi - TUNING.level)
    return float(up[side].sum() / max(np.maximum(up, 0.0).sum(), 1e-300))  # unevenness of upright sides cancels out


def _falling(value: float, ends: tuple[float, float]) -> float:
    """Return 1 below the first of two ends, 0 above the second."""
    return float(np.clip((ends[1] - value) / (ends[1] - ends[0]), 0.0, 1.0))
