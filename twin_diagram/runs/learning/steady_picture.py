"""A picture of what rests: of several in a row, the middle depth of each pixel, which is less noisy than one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from twin_diagram.errors import StationError
from twin_diagram.runs.learning.cell import Cell, Picture
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    pictures: int = 5
    """Of which the middle is taken: half of a stereo camera's noise is anew in each."""

    apart: float = 0.035
    """Between two of them [s]: cameras take 30 a second."""

    rest: float = 1.0
    """In which nothing moves, so that it is at rest [s]: a ring that stood askew on a bin's rim slid by 1 mm in the
    first quarter of a second, and lay in the bin's corner after one more."""

    looks: int = 5
    """Times that this is waited for at the most: what then still moves is taken as it is."""

    moved: float = 0.004
    """By which depth changes where something has moved [m], or six standard deviations of a pixel if that is more."""

    least: int = 40
    """Pixels of what moved at the least, whole squares of three by three alone: edges flicker."""


TUNING = Tuning()


def steady_picture(cell: Cell, name: str) -> Picture:
    """Return what a camera sees while the arm rests; colours and time are the last picture's.

    Raises:
        StationError: no pixel has depth: what it does not see would pass for an empty bin.
    """
    taken = []
    for _ in range(TUNING.pictures):
        cell.wait(TUNING.apart)
        taken.append(cell.look(name))
    depth = middle_depth(np.stack([one.depth for one in taken]))
    refuse_blind(name, depth)
    return replace(taken[-1], depth=depth)


def resting_picture(cell: Cell, name: str, low: Array, high: Array) -> Picture:
    """Return what a camera sees while the arm rests, as `steady_picture`, once nothing moves in a box by itself.

    Args:
        cell: whose arm is out of the camera's sight.
        name: of the camera.
        low: (3,) lowest corner of the box; heights do not count [m].
        high: (3,) its highest.

    Raises:
        StationError: no pixel has depth.
    """
    before = cell.look(name)
    for _ in range(TUNING.looks):
        cell.wait(TUNING.rest)
        now = steady_picture(cell, name)
        if not moved(before, now, low, high):
            break
        before = now
    return now


def moved(before: Picture, now: Picture, low: Array, high: Array) -> bool:
    """Return whether two pictures of one camera tell that something moved in between, within or over a box.

    Args:
        before: the first picture.
        now: the second one.
        low: (3,) lowest corner of the box; heights do not count [m].
        high: (3,) its highest.
    """
    both = (before.depth > 0) & (now.depth > 0)
    at = np.where(both[..., None], now.points(), np.inf)[..., :2]
    both &= ((at > low[:2]) & (at < high[:2])).all(axis=-1)
    off = np.abs(now.depth - before.depth)
    if not both.any():
        return False
    least = max(TUNING.moved, 6.0 * 1.4826 * float(np.median(off[both])))
    return int(ndimage.binary_opening(both & (off > least), np.ones((3, 3))).sum()) >= TUNING.least


def refuse_blind(name: str, *depths: npt.NDArray[np.float32]) -> None:
    """Refuse what a camera delivered where it measured nothing at all.

    Raises:
        StationError: no pixel of any image (H, W) has depth.
    """
    if depths and not any(depth.any() for depth in depths):
        raise StationError(f"camera {name!r} measures no depth: is its lens covered, or did it stop? --resume goes on")


def middle_depth(depths: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return the middle depth (H, W) of each pixel [m], of those of K pictures (K, H, W) that are not 0.

    A pixel without depth in most of them has none: it is at an edge, where what is seen now and then is wrong.
    """
    rising = np.sort(depths, axis=0)
    count = (depths > 0).sum(axis=0)
    first = len(depths) - count
    middle = np.minimum(first + (count - 1) // 2, len(depths) - 1)
    found = np.take_along_axis(rising, middle[None], axis=0)[0]
    return np.where(2 * count > len(depths), found, np.float32(0.0))
