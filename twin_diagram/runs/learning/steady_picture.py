"""A picture of what rests: of several in a row, the middle depth of each pixel, which is less noisy than one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.errors import StationError
from twin_diagram.runs.learning.cell import Cell, Picture


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    pictures: int = 5
    """Of which the middle is taken: half of a stereo camera's noise is anew in each."""

    apart: float = 0.035
    """Between two of them [s]: cameras take 30 a second."""


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
