"""How deep a hollow is whose floor no view looks into.

Over its rim views look down the opposite wall, and never into a cone below where their rays cross. Nothing contradicts
that it is full, and nothing that it is empty. Of all surfaces between what was looked through and what was seen, the
one of least area is taken: flat where the seen part of the wall ends. What lies under the support counts as full, so
that bodies do not open there.

A hollow is what would hold water: nothing else is opened, whether its far side or its underside was seen or not.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from scipy import ndimage, sparse
from scipy.sparse.linalg import cg

from twin_diagram.assets.building.depth_view import Map, Mask
from twin_diagram.assets.building.fusion import DistanceField, FusionGrid
from twin_diagram.signals.arrays import Array

Kind = TypeVar("Kind", bound=np.generic)
"""Of what an array holds."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    coarse: int = 2
    """Points of the grid along the edge of a cell in which floors are looked for: an eighth of the work."""

    water: float = 2.0
    """Cells by which the water rises at a time."""

    step: float = 0.28
    """Both step lengths of the search for the least area: their product times 12, the squared norm of differences
    along three axes, is below 1 (Chambolle and Pock, 2011)."""

    rounds: int = 150
    """Of that search: a mug's floor moves by less than a thousandth of its cells afterwards."""

    thick: int = 1
    """Layers that can be taken off what is opened without its vanishing: less is what is left open beside edges."""

    least: float = 0.85
    """Chance that a hollow is empty down to the surface of least area at least, and not full up to where views looked:
    that a floor is flat or goes down on is usual; what rises in its middle, as in a cake tin, is not."""

    wall: float = 0.05
    """What a cell of a wall counts of one of the ground, in how likely a hollow is deeper: below a floor in a hollow of
    a radius of 16 cells that falls by e over 13, within a handle of 4 cells over 4."""

    soft: float = 2.0
    """Cells over which the relaxed share goes from empty to full: it is scaled to a distance by them."""


TUNING = Tuning()


@dataclass(frozen=True)
class Opened:
    """A field whose hollows have floors, and how sure that is.

    Attributes:
        field: with the hollows open down to their floors.
        chance: (nx, ny, nz) that a place is empty that no view told of, of those in and under hollows; 0 elsewhere.
    """

    field: DistanceField
    chance: Map


def with_floors(field: DistanceField, plane: Array | None) -> Opened:
    """Return a field of one body with the floors of least area in those hollows that no view looks into.

    Args:
        field: where what no view told of is inside.
        plane: (4,) of its support, n·p = d, n up; None: nothing tells which way hollows hold water, and none is opened.
    """
    nothing = Opened(field, np.zeros(field.distance.shape, np.float32))
    if plane is None:
        return nothing
    n = TUNING.coarse
    inside = field.distance < 0
    height = heights(field.grid, plane)
    ground = height < field.grid.voxel
    full = coarse_share((inside & field.known) | ground) > 0.0  # walls are kept, however thin
    empty = (coarse_share(~inside & ~ground) >= 0.5) & ~full
    unknown = (coarse_share(inside & ~field.known) > 0.0) & ~full & ~empty
    water = held_water(empty, height[::n, ::n, ::n], TUNING.water * n * field.grid.voxel)
    # What is opened is to hold water, too: a wall that no view told of stands between it and what is around.
    wall = unknown & ndimage.binary_dilation(empty & ~water)
    full, unknown = full | wall, unknown & ~wall
    free = _beside(unknown, water)
    if not free.any():
        return nothing
    box = _around(free)
    share = least_area(full[box], water[box], free[box])
    gone = free[box] & (share < 0.5)
    seeds = ndimage.binary_erosion(gone, iterations=TUNING.thick)
    gone = ndimage.binary_propagation(seeds, mask=gone)
    if not gone.any():
        return nothing
    share = np.where(free[box] & ~gone, np.maximum(share, 0.5), share)
    chance = np.zeros(free.shape, np.float32)
    under = (coarse_share(ground) > 0.0)[box]
    below = spread_into(free[box] & ~gone, gone | water[box], under, full[box] & ~under)
    chance[box] = np.where(gone, TUNING.least, np.where(free[box], TUNING.least * below, 0.0))
    return _on_grid(field, box, share, gone, chance)


def held_water(empty: Mask, height: Array, step: float) -> Mask:
    """Return which empty cells (nx, ny, nz) would hold water, poured in from above.

    At each level it stays where no way below that level leads to the ends of the grid.

    Args:
        empty: where nothing is.
        height: (nx, ny, nz) of the cells above their support [m].
        step: distance of levels [m].
    """
    held = np.zeros(empty.shape, bool)
    if empty.all():
        return held
    for level in np.arange(step, float(height[~empty].max()) + step, step):
        label, count = ndimage.label(empty & (height < level))
        out = np.zeros(count + 1, bool)
        out[0] = True
        for axis in range(3):
            for end in (0, -1):
                out[np.take(label, end, axis=axis).ravel()] = True
        held |= ~out[label]
    return held


def least_area(full: Mask, empty: Mask, free: Mask) -> Map:
    """Return the share (nx, ny, nz) of each cell that is full, with the least total variation: near 0 or 1.

    By Chambolle and Pock's primal-dual steps; over the ends of what is told nothing is counted.

    Args:
        full: cells that are, …
        empty: … that are not, …
        free: … and that are to be told.
    """
    s = np.float32(TUNING.step)
    share = np.where(full, 1.0, np.where(free, 0.5, 0.0)).astype(np.float32)
    told = full | empty | free
    flow = np.zeros((3, *share.shape), np.float32)
    counts = np.zeros(flow.shape, np.float32)
    for axis in range(3):
        count, known = np.moveaxis(counts[axis], axis, 0), np.moveaxis(told, axis, 0)
        count[:-1] = known[:-1] & known[1:]
    ahead = share
    for _ in range(TUNING.rounds):
        for axis in range(3):
            a, b = np.moveaxis(flow[axis], axis, 0), np.moveaxis(ahead, axis, 0)
            a[:-1] += s * (b[1:] - b[:-1])
        flow *= counts
        flow /= np.maximum(np.sqrt(np.einsum("kxyz,kxyz->xyz", flow, flow)), np.float32(1.0))
        inward = flow.sum(axis=0)
        for axis in range(3):
            np.moveaxis(inward, axis, 0)[1:] -= np.moveaxis(flow[axis], axis, 0)[:-1]
        new = np.where(free, np.clip(share + s * inward, 0.0, 1.0), share)
        ahead = 2 * new - share
        share = new
    return share


def spread_into(free: Mask, one: Mask, zero: Mask, wall: Mask, fading: float = 0.0) -> Map:
    """Return on free cells (nx, ny, nz) what is 1 and 0 where that is told, and harmonic between.

    Walls draw it to 0 weakly: below a hollow's floor it falls nearly evenly to the ground, and soon inside of walls.
    With `fading`, of a cell's edge over a length, squared, it falls off exponentially by that length besides.
    """
    number = np.cumsum(free.ravel()).reshape(free.shape) - 1
    count = int(free.sum())
    rows, columns = [], []
    degree, right = np.full(count, fading), np.zeros(count)
    for axis in range(3):
        a = tuple(slice(0, -1) if k == axis else slice(None) for k in range(3))
        b = tuple(slice(1, None) if k == axis else slice(None) for k in range(3))
        for here, there in ((a, b), (b, a)):
            own = number[here]
            both = free[here] & free[there]
            rows.append(own[both])
            columns.append(number[there][both])
            degree += np.bincount(own[free[here] & (free | one | zero)[there]], minlength=count)
            degree += TUNING.wall * np.bincount(own[free[here] & wall[there]], minlength=count)
            right += np.bincount(own[free[here] & one[there]], minlength=count)
    i, j = np.concatenate(rows), np.concatenate(columns)
    matrix = sparse.diags(np.maximum(degree, 1e-6)) - sparse.csr_matrix((np.ones(len(i)), (i, j)), shape=(count, count))
    found, _ = cg(matrix.tocsr(), right, rtol=1e-3, maxiter=300)
    spread = np.zeros(free.shape, np.float32)
    spread[free] = np.clip(found, 0.0, 1.0)
    return spread


def _on_grid(field: DistanceField, box: tuple[slice, ...], share: Map, gone: Mask, chance: Map) -> Opened:
    """Return the field, opened where cells of a box are `gone`, and chances at its points."""
    n, limit = TUNING.coarse, TUNING.soft * field.grid.voxel
    near = np.zeros(chance.shape, bool)
    near[box] = ndimage.binary_dilation(gone, iterations=2)
    shape = field.distance.shape
    at = np.argwhere(on_points(near, shape) & (field.distance < 0) & ~field.known)
    start = np.array([part.start for part in box])
    mixed = ndimage.map_coordinates(share, ((at - (n - 1) / 2) / n - start).T, order=1, mode="nearest")
    distance = field.distance.copy()
    distance[tuple(at.T)] = np.clip((0.5 - mixed) * 2 * n * field.grid.voxel, -limit, limit)
    told = (field.distance < 0) & ~field.known
    points = np.where(told, np.where(distance < 0, on_points(chance, shape), np.float32(TUNING.least)), np.float32(0.0))
    return Opened(replace(field, distance=distance), points)


def heights(grid: FusionGrid, plane: Array) -> Array:
    """Return how high a grid's points (nx, ny, nz) lie above a plane (4,) [m]."""
    return np.asarray(sum(np.moveaxis(plane[k] * x[None, None, :], 2, k) for k, x in enumerate(grid.axes())) - plane[3])


def coarse_share(which: Mask) -> Map:
    """Return how many of their points cells of n × n × n have, of all."""
    n = TUNING.coarse
    padded = np.pad(which, [(0, -size % n) for size in which.shape]).astype(np.float32)
    a, b, c = (size // n for size in padded.shape)
    return np.asarray(padded.reshape(a, n, b, n, c, n).mean(axis=(1, 3, 5)))


def on_points(cells: npt.NDArray[Kind], shape: tuple[int, ...]) -> npt.NDArray[Kind]:
    """Return the values of cells at each of their points."""
    for axis in range(3):
        cells = np.repeat(cells, TUNING.coarse, axis=axis)
    return cells[tuple(slice(0, size) for size in shape)]


def _beside(unknown: Mask, water: Mask) -> Mask:
    """Return the connected parts of unknown cells that water touches."""
    return np.asarray(ndimage.binary_propagation(unknown & ndimage.binary_dilation(water), mask=unknown))


def _around(free: Mask) -> tuple[slice, ...]:
    """Return the box of some cells with one cell around it."""
    at = np.argwhere(free)
    low, high = np.maximum(at.min(axis=0) - 1, 0), at.max(axis=0) + 2
    return tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
