"""Depth as a camera delivers it: a whole number of depth units, the same bits live and recorded."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

Depth = npt.NDArray[np.float32]
Colour = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    most_units: int = 65535
    """What 16 bits hold."""


TUNING = Tuning()


def whole_units(depth: Depth, unit: float) -> Depth:
    """Round depth to a whole number of units, as `units_to_depth` gives it back to the bit."""
    return units_to_depth(depth_to_units(depth, unit), unit)


def depth_to_units(depth: Depth, unit: float) -> npt.NDArray[np.uint16]:
    """Return the depth [m] as a count of units, at most 65535."""
    counts = np.rint(depth * np.float32(1.0 / unit))
    return np.minimum(counts, np.float32(TUNING.most_units)).astype(np.uint16)


def units_to_depth(counts: npt.NDArray[np.uint16], unit: float) -> Depth:
    """Return the inverse of `depth_to_units`; computed in double precision, so that a recording gives the same bits."""
    return _depths(unit)[counts]


@lru_cache(maxsize=4)
def _depths(unit: float) -> Depth:
    """Return the depth of each count, (65536,)."""
    table = (np.arange(TUNING.most_units + 1) * unit).astype(np.float32)
    table.setflags(write=False)
    return table
