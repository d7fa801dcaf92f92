"""The compiled parts of `breakaway` and `momentum_observer`: what each joint's lacking torque says, joint by joint."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled, compiled_in_place


@compiled_in_place
def follow_way(run: Array, low: Array, unsure: Array, way: Array, rho: Array, jump: Array, forgetting: float) -> None:
    """Count messages in one direction, and low-pass what is lacking from where that began; in place.

    Args:
        run: (n,) messages in a joint's direction, signed.
        low: (n,) low-passed ρ [N·m].
        unsure: (n,) its variance by jumps of torque.
        way: (n,) −1, 0 or 1: where the joint goes.
        rho: (n,) torque that the model lacks [N·m].
        jump: (n,) σ of it because nobody knows when a torque changed [N·m].
        forgetting: λ per message.
    """
    for i in range(len(run)):
        goes_on = way[i] != 0.0 and np.sign(run[i]) == way[i]
        run[i] = run[i] + way[i] if goes_on else way[i]
        new = 1.0 if abs(run[i]) <= 1.0 else 1.0 - forgetting
        low[i] = (1.0 - new) * low[i] + new * rho[i]
        unsure[i] = (1.0 - new) ** 2 * unsure[i] + (new * jump[i]) ** 2


@compiled_in_place
def allowed(variance: float, least: float, sigma: float, witnesses: float, few: float) -> float:
    """Return the threshold of `learned_threshold` about a mean, of a variance that is never taken for less."""
    return sigma * (1.0 + few / np.sqrt(max(witnesses, 1.0))) * np.sqrt(max(variance, least))


@compiled
def tested(
    sliding: npt.NDArray[np.bool_],
    run: Array,
    low: Array,
    unsure: Array,
    usual: Array,
    floor: Array,
    sigma: float,
    learning: bool,
    constants: tuple[float, float, float, float, float],
) -> tuple[Array, Array]:
    """Return (n,) statistics of sliding joints over their thresholds, 0 of others, and (n,) ρ beyond what is usual.

    Args:
        sliding: (n,) which joints are tested, and learnt from.
        run: (n,) as in `follow_way`.
        low: (n,)
        unsure: (n,)
        usual: (3, 2, n) of both directions, in place: messages learnt from, mean and variance.
        floor: (n,) σ is never taken for less [N·m].
        sigma: k of the threshold.
        learning: whether nothing is wrong.
        constants: λ, messages before a joint is tested, messages remembered, share of a threshold that is a lesson,
            and `learned_threshold`'s.
    """
    n = len(run)
    forgetting, least, memory, near, few = constants
    found, gained = np.zeros(n), np.zeros(n)
    for i in range(n):
        way = 1 if run[i] < 0.0 else 0
        count, mean, variance = usual[0, way, i], usual[1, way, i], usual[2, way, i]
        beyond, witnesses = low[i] - mean, count * (1.0 - forgetting)
        gained[i] = beyond
        if not sliding[i]:
            continue
        if count >= least:
            found[i] = abs(beyond) / allowed(variance, floor[i] ** 2 + unsure[i], sigma, witnesses, few)
        close = abs(beyond) < near * allowed(variance, floor[i] ** 2, sigma, witnesses, few)
        if learning and (count < least or close):
            count = min(count + 1.0, memory)
            mean += beyond / count
            variance += (beyond * (low[i] - mean) - variance) / count
            usual[0, way, i], usual[1, way, i], usual[2, way, i] = count, mean, variance
    return found, gained


@compiled
def slow_moves(
    memory: Array,
    q: Array,
    way: Array,
    rho: Array,
    jump: Array,
    slow: npt.NDArray[np.bool_],
    floor: Array,
    sigma: float,
    calm: bool,
    constants: tuple[float, float, float, float, float, float, float],
) -> tuple[Array, Array]:
    """Do what `breakaway.slow_moves` says; the last argument holds its constants, and `learned_threshold`'s."""
    n = len(q)
    forgetting, far_enough, long_enough, least, most, near, few = constants
    found, gained, moving = np.zeros(n), np.zeros(n), np.zeros(n, dtype=np.bool_)
    for i in range(n):
        goes_on = way[i] != 0.0 and np.sign(memory[1, i]) == way[i]
        if not goes_on:
            memory[0, i] = q[i]
        memory[1, i] = memory[1, i] + way[i] if goes_on else way[i]
        new = 1.0 - forgetting if goes_on else 1.0
        memory[2, i] = (1.0 - new) * memory[2, i] + new * rho[i]
        memory[6, i] = (1.0 - new) ** 2 * memory[6, i] + (new * jump[i]) ** 2
        moving[i] = slow[i] and abs(memory[1, i]) >= long_enough and (q[i] - memory[0, i]) * way[i] >= far_enough
    if not moving.any():
        return found, memory[2].copy()
    for i in range(n):
        count, mean, variance = memory[3, i], memory[4, i], memory[5, i]
        beyond, witnesses = memory[2, i] * way[i] - mean, count * (1.0 - forgetting)
        gained[i] = beyond * way[i]
        if not moving[i]:
            continue
        if count >= least:
            found[i] = max(beyond, 0.0) / allowed(variance, floor[i] ** 2 + memory[6, i], sigma, witnesses, few)
        usual = allowed(variance, floor[i] ** 2, sigma, witnesses, few)
        if calm and (count < least or beyond < near * usual):
            count = min(count + 1.0, most)
            mean += beyond / count
            variance += (beyond * (memory[2, i] * way[i] - mean) - variance) / count
            memory[3, i], memory[4, i], memory[5, i] = count, mean, variance
    return found, gained
