"""Where a body may be empty though no view told so: behind the ends of what was looked through, and where it stands.

What no view looked through counts as inside. Where it ends at a surface that views saw, there it is full. Where it ends
at nothing but where views looked past, as below a plate's rim or in a stapler's jaw, the true surface lies somewhere
behind: by a length that falls off exponentially where that end is wide, by less than its width where it is a gap in
what was seen, and never beyond that. Such a share u solves u'' = u / length², 1 at those ends and 0 at what was seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.building.depth_view import Map
from twin_diagram.assets.building.fusion import DistanceField
from twin_diagram.assets.building.hollows import TUNING as COARSE
from twin_diagram.assets.building.hollows import coarse_share, heights, on_points, spread_into
from twin_diagram.assets.building.thin_walls import wall_chance
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, set on shapes of which the truth is known: see docs/evidence.md, unseen places."""

    behind: float = 0.03
    """Mean length by which a surface lies behind where views looked past, of a body's size (cube root of its box)."""

    shells: float = 0.5
    """Power of that share which is the chance: below 1, for of a thin shell all is empty up to what was seen. The share
    itself counts: most things are no shells, and of round ones more than that share is full."""

    open: float = 0.25
    """Share of cells that must have been looked through for what they border on to end there."""

    recessed: float = 0.25
    """Chance that what stands on a plane has a recess there: cans, bottles and cups have, boxes have none."""

    recess: float = 0.03
    """Mean depth of such a recess, of the body's height, …"""

    deepest: float = 0.003
    """… and at most [m]: of what is higher than 10 cm, it is no deeper."""

    least: float = 1e-3
    """Smaller chances count as none."""

    deeper: float = 0.5
    """Of the greatest chance that lies below walls what is so likely counts as empty: a mug of forty views came out
    4.1 % too small, its floor and its handle's inside taken for half empty."""


TUNING = Tuning()


@dataclass(frozen=True)
class Unseen:
    """Cells that no view told of, of which those from the most likely one on are empty, together.

    Attributes:
        places: (M, 3) in W of cells that may be empty, or full [m].
        chance: (M,) that each is empty.
        inside: (M,) which of them the surface holds.
        expected: (M,) share of each that counts as empty: less than the chance where that covers what is rarer.
    """

    places: Array
    chance: Array
    inside: npt.NDArray[np.bool_]
    expected: Array


def unseen_places(field: DistanceField, chance: Map, plane: Array | None, sloping: float = 0.0) -> tuple[Unseen, ...]:
    """Return what may be empty behind where views looked past, below walls, and where the body stands.

    Args:
        field: where what no view told of is inside, but for what was opened.
        chance: (nx, ny, nz) that a cell is empty by what else is known; 0 elsewhere. The greater of two counts.
        plane: (4,) of its support, n·p = d, n up; None: it stands on nothing.
        sloping: of its surface; see `sloping_share`.
    """
    unknown = ~field.known & (field.distance < 0)
    height = None if plane is None else heights(field.grid, plane)
    share = behind_ends(field, height)
    walls = wall_chance(field, height, sloping)
    first = np.maximum.reduce([chance, walls, share**TUNING.shells])
    # What is rather likely a part of a wall is counted full: floors are thicker than walls.
    deeper = np.where(walls > TUNING.deeper * walls.max(initial=0.0), walls, np.float32(0.0))
    found = [_of(field, first, np.maximum.reduce([chance, deeper, share]))]
    if height is not None and unknown.any():
        high = float(height[field.distance < 0].max())
        depth = min(TUNING.recess * high, TUNING.deepest)
        below = np.where(unknown, TUNING.recessed * np.exp(-np.maximum(height, 0.0) / depth), 0.0)
        below = np.where(below > first, below, 0.0)  # what is known to be open is asked about once
        found.append(_of(field, below, np.zeros(below.shape)))
    return tuple(found)


def behind_ends(field: DistanceField, height: Array | None) -> Map:
    """Return the share (nx, ny, nz) of cells that is empty since what was looked through ends there; 0 elsewhere.

    Args:
        field: where what no view told of is inside.
        height: (nx, ny, nz) above the support [m]: nobody looked from below it.
    """
    inside = field.distance < 0
    told = np.zeros(inside.shape, np.float32)
    if not inside.any():
        return told
    at = np.argwhere(inside)
    low, high = np.maximum(at.min(axis=0) - COARSE.coarse, 0), at.max(axis=0) + COARSE.coarse + 1
    box = tuple(slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    inside, known = inside[box], field.known[box]
    ground = np.zeros(inside.shape, bool) if height is None else height[box] < 0.5 * field.grid.voxel
    seen = coarse_share(inside & known) > 0.0  # however thin what was seen is, nothing passes it
    free = (coarse_share(inside & ~known & ~ground) >= 0.5) & ~seen
    ends = (coarse_share(~inside & ~ground) > TUNING.open) & ~free & ~seen
    length = TUNING.behind * float(np.prod((at.max(axis=0) - at.min(axis=0) + 1) * field.grid.voxel)) ** (1 / 3)
    fading = (COARSE.coarse * field.grid.voxel / length) ** 2
    share = on_points(spread_into(free, ends, seen, np.zeros(free.shape, bool), fading), inside.shape)
    told[box] = np.where(inside & ~known & (share > TUNING.least), share, np.float32(0.0))
    return told


def _of(field: DistanceField, chance: npt.NDArray[np.floating], expected: npt.NDArray[np.floating]) -> Unseen:
    """Return the cells that have a chance to be empty."""
    at = np.argwhere(chance > TUNING.least)
    which = tuple(at.T)
    places = field.grid.origin + field.grid.voxel * at
    return Unseen(places, chance[which].astype(float), field.distance[which] < 0, expected[which].astype(float))
