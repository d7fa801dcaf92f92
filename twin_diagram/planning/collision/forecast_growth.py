"""How much larger objects are taken to be, the farther ahead the more, for what is not known of their poses.

A pose's covariance moves each point of a surface by some standard deviation along its normal, turning included; the
largest over the surface is what the object grows by. Ahead, the covariance grows as tracking would let it grow without
new images: for as long as it takes to see and to react.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.planning.collision.convex_solids import Solid
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """How far and how fast objects grow; chosen by hand unless it says otherwise.

    `tests/planning_bench.py` shows their effect on an arm among things that move (touched, arrived), and
    `sims/closed_loop.py --seeds 20` in the loop with perception.
    """

    sigmas: float = 3.0
    """Objects grow by this many standard deviations of their surface …"""

    cap: float = 0.06
    """… but by no more than this [m]: what is lost is not everywhere."""

    reaction: float = 0.2
    """The covariance grows for so long [s], an image's period, its latency and a stop: later plans know better."""

    unsteady: float = 0.054
    """Density of what moving things are accelerated by [m²/s³]: 0.3 m/s² that forgets itself in 0.3 s, as the tracks'
    own filter has it."""

    unsteady_spin: float = 0.6
    """The same for turning [rad²/s³]: 1 rad/s²."""


TUNING = Tuning()


def surface_rows(solids: Sequence[Solid]) -> Array:
    """Return (S, 6) what a small turn and shift of a frame moves surfaces by, along their normals.

    A row times (turn [rad], shift [m]), both along the frame's axes, is that at one of the solids' outermost points.
    """
    points, normals = (np.concatenate(part) for part in zip(*(solid.surface for solid in solids), strict=True))
    return np.hstack([np.cross(points, normals), normals])


def spread(rows: Array, covariance: Array, R_WO: Array) -> Array:
    """Return (S, 2): each surface point's variance along its normal [m²], and its lever squared [m²].

    Args:
        rows: of `surface_rows`, in the object's frame.
        covariance: (6, 6) of the pose, rotation [rad] then translation [m], a left perturbation in W about the
            object's origin.
        R_WO: (3, 3)
    """
    from twin_diagram.planning.collision import forecast_kernels  # compiled; not with every import

    ordered = (np.ascontiguousarray(part, dtype=float) for part in (rows, covariance, R_WO))
    return np.asarray(forecast_kernels.spread(*ordered))


def outermost(spread_: Array) -> Array:
    """Return those rows of a spread (S, 2) that may be the worst: no other has both more variance and more lever."""
    from twin_diagram.planning.collision import forecast_kernels

    return np.asarray(forecast_kernels.outermost(spread_))


def added_variance(variance: float, density: float, times: Array) -> Array:
    """Return (N,) how much a coordinate's variance grows until `times` (N,), up to the reaction.

    The variance of its speed, and what binds the two, are those of a Kalman filter that has settled at this variance
    under acceleration of this density (Kalman–Bucy, in closed form).

    Args:
        variance: now [m²] or [rad²].
        density: of its acceleration.
        times: from now on [s].
    """
    from twin_diagram.planning.collision import forecast_kernels

    return np.asarray(forecast_kernels.added_variance(variance, density, np.asarray(times), TUNING.reaction))


def growth(spread_: Array, shift: Array, turn: Array) -> Array:
    """Return (N,) by how much an object is taken to be larger [m].

    Args:
        spread_: (S, 2) of `spread`.
        shift: (N,) variance added to each coordinate of its place [m²].
        turn: (N,) variance added to its turn about any axis [rad²].
    """
    from twin_diagram.planning.collision import forecast_kernels

    return np.asarray(forecast_kernels.growth(spread_, shift, turn, TUNING.sigmas, TUNING.cap))
