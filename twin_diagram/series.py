"""How a yielding gear twists while its motor moves as measured.

With the link at q = θ + e behind a motor at θ, and τ the torque that the link would need if it followed rigidly,

    M ë + loss K ė + K e = −τ(θ)    for a spring,        e within ± gap / 2, without rebound, for play,

M being the links' mass matrix at the joints that yield (Spong 1987, with the motors' motion prescribed). What the
motors
must give beyond the rigid arm's torque is M ë, and what gravity changes at θ + e. Springs are integrated by Newmark's
average acceleration, which neither damps nor blows up; play by implicit steps with impulses at its ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from twin_diagram.effects.elasticity import LOSS, Gear

if TYPE_CHECKING:
    from twin_diagram.model import Model

Array = npt.NDArray[np.float64]

LONGEST_STEP = 0.001
"""Samples farther apart than this are integrated in several steps where there is play [s]."""

PASSES = 2
"""Gravity at the twisted gear is worked out from the pass before."""


@dataclass(frozen=True)
class Twist:
    """Twists of the joints that yield.

    Attributes:
        angle: (N, s) link less motor [rad].
        rate: (N, s) [rad/s].
        torque: (N, n) what the motors must give beyond the rigid arm's torque [N·m].
    """

    angle: Array
    rate: Array
    torque: Array


def merged(gears: list[tuple[int, Gear]]) -> tuple[npt.NDArray[np.int64], Array, Array]:
    """Joints that yield, with the stiffness and half the play of each: compliances and gaps in series add up."""
    joints = sorted({joint for joint, _ in gears})
    compliance = np.array([sum(1.0 / gear.stiffness for j, gear in gears if j == joint) for joint in joints])
    half = np.array([0.5 * sum(gear.gap for j, gear in gears if j == joint) for joint in joints])
    with np.errstate(divide="ignore"):
        return np.array(joints, dtype=np.int64), 1.0 / compliance, half


def twist(model: Model, q: Array, v: Array, a: Array, period: float) -> Twist:
    """Twists for a motion sampled at a constant rate.

    Args:
        model: without onsets, with gears that yield.
        q: (N, n) the motors' true positions [rad].
        v: (N, n) [rad/s].
        a: (N, n) [rad/s²].
        period: between samples [s].
    """
    joints, stiffness, half = model.yielding
    mass = model.tree.mass_matrix(q)
    mass[:, range(model.tree.n), range(model.tree.n)] -= model.tree.rotor
    columns = mass[:, :, joints]
    block = columns[:, joints]
    rigid = model.link_load(q, v, a)
    load = rigid
    springs = bool(np.all(np.isfinite(stiffness)) and not np.any(half > 0.0))
    for _ in range(PASSES):
        if springs:
            angle, rate, acceleration = _springs(block, load[:, joints], stiffness, period)
        else:
            angle, rate, acceleration = _play(block, load[:, joints], stiffness, half, period)
        twisted = q.copy()
        twisted[:, joints] += angle
        load = model.link_load(twisted, v, a)
    torque = np.einsum("kis,ks->ki", columns, acceleration) + load - rigid
    return Twist(angle, rate, torque)


def _springs(mass: Array, load: Array, stiffness: Array, h: float) -> tuple[Array, Array, Array]:
    samples, s = load.shape
    identity, K = np.eye(s), np.diag(stiffness)
    D = LOSS * K
    inverse: Any = np.linalg.inv(mass + 0.5 * h * D + 0.25 * h * h * K)
    effect = np.concatenate([0.25 * h * h * identity, 0.5 * h * identity, identity])  # of the new acceleration
    held = np.hstack([K, h * K + D, 0.25 * h * h * K + 0.5 * h * D])
    onward = np.zeros((3 * s, 3 * s))
    onward[:s] = np.hstack([identity, h * identity, 0.25 * h * h * identity])
    onward[s : 2 * s, s:] = np.hstack([identity, 0.5 * h * identity])
    A = onward - effect @ inverse @ held
    b = -np.einsum("ij,kj->ki", effect, np.einsum("kij,kj->ki", inverse, load))
    # Beside the motion from rest, those from a unit twist and a unit rate of each gear. No sensor tells how a gear
    # started: of all starts, the one that rings least is taken.
    state = np.zeros((samples, 3 * s, 1 + 2 * s))
    state[0, : 2 * s, 1:] = np.eye(2 * s)
    for k in range(1, samples):
        np.matmul(A[k], state[k - 1], out=state[k])
        state[k, :, 0] += b[k]
    calm = -load / stiffness
    freely = state[:, :s, 1:].reshape(samples * s, 2 * s)
    size = np.linalg.norm(freely, axis=0)
    start = np.linalg.lstsq(freely / size, (calm - state[:, :s, 0]).ravel(), rcond=None)[0] / size
    found = state[:, :, 0] + state[:, :, 1:] @ start
    return found[:, :s], found[:, s : 2 * s], found[:, 2 * s :]


def _play(mass: Array, load: Array, stiffness: Array, half: Array, period: float) -> tuple[Array, Array, Array]:
    samples, s = load.shape
    parts = max(1, int(np.ceil(period / LONGEST_STEP - 1e-9)))
    h = period / parts
    hard = ~np.isfinite(stiffness)
    K = np.where(hard, 0.0, stiffness)
    angle, rate, acceleration = np.empty_like(load), np.zeros_like(load), np.zeros_like(load)
    side = -np.sign(load[0])
    e = side * half - np.divide(load[0], K, out=np.zeros(s), where=K > 0.0)
    angle[0], v = e, np.zeros(s)
    free: Any = np.linalg.inv(mass)
    for k in range(1, samples):
        before = v
        for part in range(parts):
            share = (part + 1.0) / parts
            push = (1.0 - share) * load[k - 1] + share * load[k]
            stretched = K > 0.0
            stretched &= np.abs(e + h * v) > half
            if np.any(stretched):
                k_now = np.where(stretched, K, 0.0)
                A = mass[k] + np.diag(h * (LOSS + h) * k_now)
                rest = np.sign(e + h * v) * half
                v = np.linalg.solve(A, mass[k] @ v - h * push - h * k_now * (e - rest))
                inverse = np.linalg.inv(A)
            else:
                inverse = free[k]
                v = v - h * (inverse @ push)
            if np.any(hard):
                v = _within(
                    inverse, v, np.where(hard, (-half - e) / h, -np.inf), np.where(hard, (half - e) / h, np.inf)
                )
            e = e + h * v
        angle[k], rate[k], acceleration[k] = e, v, (v - before) / period
    return angle, rate, acceleration


def _within(inverse: Array, v: Array, low: Array, high: Array) -> Array:
    """Speeds after the impulses that keep each within its bounds."""
    if len(v) == 1:
        return np.clip(v, low, high)
    v, impulse = v.copy(), np.zeros_like(v)
    for _ in range(30):
        for j in range(len(v)):
            alone = v[j] - inverse[j, j] * impulse[j]
            wanted = (min(max(alone, low[j]), high[j]) - alone) / inverse[j, j]
            v += inverse[:, j] * (wanted - impulse[j])
            impulse[j] = wanted
    return v
