"""What depends on time itself: which effects act when, and torque that acts later."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import scipy

from twin_diagram.model.effects.effect import Effect
from twin_diagram.signals.arrays import Array


def epochs(effects: Sequence[Effect], time: Array) -> list[tuple[tuple[bool, ...], npt.NDArray[np.bool_]]]:
    """Return sets of effects that act together, and at which of the times (N,) they do."""
    active = (
        np.stack([effect.when.active(time) for effect in effects], axis=1)
        if effects
        else np.zeros((len(time), 0), bool)
    )
    # Sets change at a few moments alone: rows of all times need not be sorted.
    begins = np.append(0, np.flatnonzero(np.any(active[1:] != active[:-1], axis=1)) + 1)[: len(time)]
    kinds, of_span = np.unique(active[begins], axis=0, return_inverse=True)
    which = np.repeat(of_span.reshape(-1), np.diff(np.append(begins, len(time))))
    return [(tuple(map(bool, kind)), which == k) for k, kind in enumerate(kinds)]


def shifted(signal: Array, time: Array, by: float) -> Array:
    """Return a signal (N, n) of evenly spaced times (N,) as it is `by` seconds later, its ends held [s]."""
    if by == 0.0 or len(time) < 3:
        return signal
    return np.asarray(scipy.interpolate.CubicSpline(time, signal)(np.clip(time + by, time[0], time[-1])))
