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

_CONSTANTS: Final = (
    TUNING.forgetting,
    TUNING.far_enough,
    float(TUNING.long_enough),
    float(TUNING.least),
    TUNING.memory,
    TUNING.near,
    learned_threshold.TUNING.few,
)
"""As the compiled loop takes them."""

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
    from twin_diagram.estimation.drift import torque_kernels  # compiled; not with every import

    way = np.where(np.abs(v) > creeps, np.sign(v), 0.0)
    jumps = np.broadcast_to(jump, np.shape(q)).copy()
    return torque_kernels.slow_moves(memory, q, way, rho, jumps, slow, floor, sigma, calm, _CONSTANTS)
