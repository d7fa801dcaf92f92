"""Impulses that a step of time must find: dry friction that brakes or holds, and play that ends.

Projected Gauss-Seidel on the inverse mass (Moreau's time stepping; Jean and Moreau 1992).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    sweeps: int = 60
    """Bound on the passes over all impulses; most steps end after a few."""

    tolerance: float = 1e-10
    """Passes end where no impulse changes by more, as a part of the largest that friction can give."""


TUNING = Tuning()


@dataclass(frozen=True)
class DryFriction:
    """Dry friction on a combination of speeds.

    Attributes:
        direction: (m,) the combination; a single 1 for a joint.
        forward: (S,) largest impulse against positive motion.
        backward: (S,) against negative motion.
    """

    direction: Array
    forward: Array
    backward: Array


@dataclass(frozen=True)
class Stop:
    """A speed that must stay within bounds.

    Attributes:
        index: which.
        low: (S,)
        high: (S,)
    """

    index: int
    low: Array
    high: Array


def solve(inverse: Array, v: Array, brakes: list[DryFriction], stops: list[Stop]) -> Array:
    """Return speeds (S, m) after the impulses.

    Args:
        inverse: (S, m, m) of the mass matrices.
        v: (S, m) speeds without impulses.
        brakes: dry friction.
        stops: bounds.
    """
    v = v.copy()
    rows = []
    for brake in brakes:
        scale = max(float(np.max(brake.forward + brake.backward)), 1e-300)
        if scale > 1e-200:
            pushed = inverse @ brake.direction
            rows.append((brake, pushed, pushed @ brake.direction, scale, np.zeros(len(v))))
    ends = [(stop, inverse[:, :, stop.index], np.zeros(len(v))) for stop in stops]
    for _ in range(TUNING.sweeps):
        change = 0.0
        for brake, pushed, compliance, scale, impulse in rows:
            speed = v @ brake.direction
            wanted = np.clip(impulse + speed / compliance, -brake.backward, brake.forward)
            difference = wanted - impulse
            impulse[:] = wanted
            v -= pushed * difference[:, None]
            change = max(change, float(np.max(np.abs(difference))) / scale)
        for stop, pushed, impulse in ends:
            compliance = pushed[:, stop.index]
            alone = v[:, stop.index] - compliance * impulse
            wanted = (np.clip(alone, stop.low, stop.high) - alone) / compliance
            moved = (wanted - impulse) * compliance
            impulse[:] = wanted
            v += pushed * (moved / compliance)[:, None]
            change = max(change, float(np.max(np.abs(moved))) * 1e3)
        if change < TUNING.tolerance:
            break
    return v
