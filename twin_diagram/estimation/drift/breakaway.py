"""A joint that moves although the torque known to act on it is less than what holds it back.

A motor that weakens while its joint rests, a weight that is laid on, a push: stiction hides them until the joint gives
way, and then it may creep a milliradian before its drive catches it, too slowly and too briefly to slide (see
`momentum_observer`). Yet while it moves with s = ±1 friction is F s, so that the torque that the model lacks, ρ, says
all: ρ s > 0 means that it moves though it should not.

One-sided: what holds a slow joint back beyond F, as Stribeck's law has it, makes ρ s < 0. Friction that rises smoothly
with speed makes ρ s > 0 in every slow move, so how large ρ s is in slow moves while nothing is wrong is learnt of each
joint. And the joint must have come some way: where it rested or turned it yields a little before it slides (Dahl).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram.estimation.drift import learned_threshold
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """When a joint that creeps is tested: chosen by hand.

    `sims/benchmarks/false_alarms.py` shows what it costs in false alarms, `make hrt-tables` what it finds.
    """

    forgetting: float = 0.8
    """λ per message: 5 messages."""

    far_enough: float = 3e-4
    """Over this way dry friction has built up where a joint rested or turned round: most of it is in the motor, which
    turns a hundred times as far [rad]."""

    long_enough: int = 5
    """And it has moved for so many messages."""

    least: int = 20
    """Slow messages of a joint before it is tested."""

    memory: float = 20_000.0
    """Slow messages over which normal operation is averaged."""

    near: float = 0.5
    """What is beyond this share of its threshold is no lesson."""


TUNING = Tuning()


SIZE: Final = 7
"""Numbers that are remembered of each joint."""


def slow_moves(
    memory: Array,
    q: Array,
    v: Array,
    rho: Array,
    creeps: float,
    slow: np.ndarray,
    floor: Array,
    sigma: float,
    calm: bool,
    jump: Array | float = 0.0,
) -> tuple[Array, Array]:
    """Take in a message and say which joints move though nothing known moves them.

    Args:
        memory: (`SIZE`, n) in place: where the movement began [rad], messages in its direction (signed), low-passed ρ;
            messages learnt from, mean and variance of ρ s; variance of the low-passed ρ that jumps of torque bring.
        q: (n,) [rad].
        v: (n,) [rad/s].
        rho: (n,) torque that the model lacks [N·m], friction taken as F sgn v.
        creeps: a joint slower than this rests [rad/s].
        slow: (n,) which joints are tested, and learnt from: those that do not slide.
        floor: (n,) σ of ρ s is never taken for less [N·m].
        sigma: k of the threshold.
        calm: whether nothing is wrong.
        jump: (n,) σ of ρ because nobody knows when since the message before its torque changed [N·m].

    Returns:
        (n,) statistics over their thresholds, 0 where nothing is tested, and (n,) ρ beyond what is usual [N·m].
    """
    begin, run, low, count, mean, variance, unsure = memory
    way = np.where(np.abs(v) > creeps, np.sign(v), 0.0)
    goes_on = (way != 0.0) & (np.sign(run) == way)
    begin[:] = np.where(goes_on, begin, q)
    run[:] = np.where(goes_on, run + way, way)
    new = np.where(goes_on, 1.0 - TUNING.forgetting, 1.0)
    low[:] = (1.0 - new) * low + new * rho
    unsure[:] = (1.0 - new) ** 2 * unsure + (new * jump) ** 2
    moving = slow & (np.abs(run) >= TUNING.long_enough) & ((q - begin) * way >= TUNING.far_enough)
    if not moving.any():
        return np.zeros(len(q)), low
    beyond = low * way - mean
    least = np.maximum(variance, floor**2 + np.stack([np.zeros(len(q)), unsure]))
    usual, allowed = np.asarray(learned_threshold.threshold(0.0, least, sigma, count * (1.0 - TUNING.forgetting)))
    found = np.maximum(beyond, 0.0) / allowed
    known = count >= TUNING.least
    lesson = moving & calm & (~known | (beyond < TUNING.near * usual))
    if lesson.any():
        more = np.minimum(count[lesson] + 1.0, TUNING.memory)
        count[lesson] = more
        mean[lesson] += beyond[lesson] / more
        after = low[lesson] * way[lesson] - mean[lesson]
        variance[lesson] += (beyond[lesson] * after - variance[lesson]) / more
    return np.where(moving & known, found, 0.0), beyond * way
