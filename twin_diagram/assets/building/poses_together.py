"""How far the poses of all views may be off together, once they agree.

What they may do together, such as all step away from a thing, moves no surface across another: it shows in none, and
makes the thing larger or smaller.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    scalings: int = 6
    """Rounds in which the variance of told poses is found; it settles in three or four, …"""

    scales: tuple[float, float] = (1e-4, 25.0)
    """… in units of the prior's: from what an exact arm tells to what is refused."""


TUNING = Tuning()


def all_together(seen: Array, prior: Array, twists: Array) -> Array:
    """Return the covariance (6 n, 6 n) of all views' poses together.

    How far told poses are off is taken from how far those were moved of which the views tell: with γ of the numbers
    told by the views, their squares, in units of the prior, add up to γ times its scale (MacKay, 1992).

    Args:
        seen: (k n, k n) what the views say of their twists, the prior aside.
        prior: (k,) inverse variances of each view's own, as told.
        twists: (n, k) by how much they were moved.
    """
    count, size = twists.shape
    unit = np.tile(prior**-0.5, count)
    told, ways = np.linalg.eigh(unit[:, None] * seen * unit)
    told, moves, scale = np.maximum(told, 0.0), float((twists**2 * prior).sum()), 1.0
    for _ in range(TUNING.scalings):
        known = float((told / (told + 1.0 / scale)).sum())
        if known < size:
            break
        scale = float(np.clip(moves / known, *TUNING.scales))
    ways = unit[:, None] * ways
    covariance = (ways / (told + 1.0 / scale)) @ ways.T
    own = (size * np.arange(count)[:, None] + np.arange(6)).ravel()
    return np.asarray(covariance[np.ix_(own, own)])
