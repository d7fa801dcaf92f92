"""A momentum observer beside the filter: a torque on a sliding joint that it did not have before.

What the filter cannot tell from friction, it takes for friction: when a joint starts, turns round or stops, friction
may be anything within its uncertainty, and a motor that weakens just then passes for it. Yet while a joint slides, the
torque that the model lacks,

    ρ = M(q) Δv/Δt + b(q, v) + F sgn v − τ,

says every time much the same for each joint and direction, for friction's error is a constant: its mean μ and spread σ
there are learnt for as long as nothing is wrong, and far narrower than friction's uncertainty. A low-passed ρ that
leaves μ ± kσ of its joint and direction is an alarm that names the joint. A motor that gives a share g of what is
logged shows as ρ = (g − 1) τ, and so does every other torque that nobody told of.

When between two messages a torque changed, neither of them says: where τ jumps by Δτ, its mean over the time between
them may be anything from the one to the other, so that ρ has a deviation of Δτ/√12 more. No threshold claims to know it
better, and what is only within its threshold for that reason is no lesson.

Joints that move but do not slide yet are for `breakaway`.

The sum over messages of M Δv telescopes, so that only the ends' noise counts: De Luca and Mattone, "Actuator failure
detection and isolation using generalized momenta", ICRA 2003.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram.estimation.drift import breakaway, learned_threshold
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.scenario import Filter
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """When a joint slides and what is learnt of it: chosen by hand.

    `sims/benchmarks/false_alarms.py` shows what it costs in false alarms, `make hrt-tables` what it finds.
    """

    forgetting: float = 0.85
    """λ per message: 6 messages."""

    slides: float = 0.03
    """Joints as fast as this slide, for certain [rad/s]."""

    lever: float = 0.25
    """Metres that a prismatic joint goes where a revolute one would turn by a radian: gears and rims are so large."""

    sure: float = 5.0
    """And as fast as this many standard deviations of the speeds' sensor: a filter that hears a joint through noise
    finds out late that it has started."""

    seen: float = 2.0
    """Joints as fast as this many of those deviations move, if not for certain: an estimated speed is better than one
    that was measured."""

    begun: int = 8
    """Messages that a joint must have slid before anything is learnt or tested: friction builds up over a small
    angle."""

    least: int = 100
    """Messages of a joint and direction before it is tested."""

    memory: float = 60_000.0
    """Messages over which normal operation is averaged."""

    near: float = 0.5
    """What is beyond this share of its threshold is no lesson."""

    share: float = 0.04
    """σ is never taken for less than this share of the level of dry friction."""

    white: float = 0.3
    """Nor for less than this share of the filter's white unmodelled torque: what is left of it after low-pass."""

    largest: float = 1e6
    """No ρ counts for more [N·m]."""


TUNING = Tuning()

_CONSTANTS: Final = (
    TUNING.forgetting,
    float(TUNING.least),
    TUNING.memory,
    TUNING.near,
    learned_threshold.TUNING.few,
)
"""Of `torque_kernels.tested`. Messages are no independent witnesses: a low pass makes them alike."""


UNIFORM: Final = 1.0 / np.sqrt(12.0)
"""Standard deviation of what may lie anywhere within an interval, over its length."""

SIZE: Final = 12
"""Numbers that are remembered of each joint, beside those of `breakaway`."""


class TorqueTest:
    """The test of one arm; what it remembers is a flat vector that its caller keeps.

    Attributes:
        size: of that vector.
    """

    def __init__(self, terms: ArmTerms, parameters: ParameterSet, tuning: Filter, sigma: float) -> None:
        """Keep what it needs of the arm.

        Args:
            terms: the arm.
            parameters: what θ means.
            tuning: of the filter.
            sigma: k.
        """
        self._terms, self._parameters, self._sigma = terms, parameters, sigma
        own = TUNING.slides * np.where(terms.prismatic, TUNING.lever, 1.0)
        self._slides = np.maximum(own, TUNING.sure * tuning.velocity_std)
        self._floor = np.hypot(TUNING.white * tuning.torque_std, tuning.torque_drift_std)
        self._creeps = max(tuning.excitation, TUNING.seen * tuning.velocity_std)
        self.size = 1 + (SIZE + breakaway.SIZE) * terms.n

    def begin(self, vector: Array) -> None:
        """Forget what the model in use until now lacked: of another one it says nothing."""
        vector[:] = 0.0

    def follow(
        self, vector: Array, x: Array, theta: Array, tau: Array, t: float, learning: bool, armed: bool
    ) -> tuple[float, int, float]:
        """Take in a message.

        Args:
            vector: (size,) in place.
            x: (2n,) x̂ at t.
            theta: (p,) θ̂.
            tau: (n,) measured torques, mean since the message before, or at the time of this one [N·m].
            t: of x̂ [s].
            learning: whether nothing is wrong.
            armed: whether alarms may be raised.

        Returns:
            The largest statistic over its threshold, 0 where nothing is tested; its joint, by index, or −1; and the
            torque that joint has gained [N·m].
        """
        from twin_diagram.estimation.drift import torque_kernels  # compiled; not with every import

        n, before = self._terms.n, vector[0]
        past, low, run = vector[1 : 1 + 2 * n], vector[1 + 2 * n : 1 + 3 * n], vector[1 + 3 * n : 1 + 4 * n]
        usual = vector[1 + 4 * n : 1 + 10 * n].reshape(3, 2, n)
        creep = vector[1 + 10 * n : -2 * n].reshape(breakaway.SIZE, n)
        last, unsure = vector[-2 * n :].reshape(2, n)
        dt = t - before
        vector[0] = t
        if before <= 0.0 or not 1e-6 < dt < 0.25:
            past[:], last[:] = x, tau
            run[:] = 0.0
            creep[1] = 0.0
            return 0.0, -1, 0.0
        rho, level = self._unmodelled(past, x, theta, tau, dt)
        v, jump = x[n:], np.minimum(UNIFORM * np.abs(tau - last), TUNING.largest)
        past[:], last[:] = x, tau
        way = np.where(np.abs(v) > self._slides, np.sign(v), 0.0)
        torque_kernels.follow_way(run, low, unsure, way, rho, jump, TUNING.forgetting)
        sliding = np.abs(run) >= TUNING.begun
        floor = np.hypot(TUNING.share * level, self._floor)
        slow = self._creeps, ~sliding, floor, self._sigma, learning
        starts, gained = breakaway.slow_moves(creep, x[:n], v, rho, *slow, jump)
        if not sliding.any():
            return self._largest(starts, gained, armed)
        found, beyond = torque_kernels.tested(
            sliding, run, low, unsure, usual, floor, self._sigma, bool(learning), _CONSTANTS
        )
        return self._largest(np.where(sliding, found, starts), np.where(sliding, beyond, gained), armed)

    @staticmethod
    def _largest(found: Array, gained: Array, armed: bool) -> tuple[float, int, float]:
        joint = int(np.argmax(found))
        if not armed or found[joint] <= 0.0:
            return 0.0, -1, 0.0
        return float(found[joint]), joint, float(gained[joint])

    def _unmodelled(self, past: Array, x: Array, theta: Array, tau: Array, dt: float) -> tuple[Array, Array]:
        """ρ (n,) and the level of dry friction (n,) [N·m]."""
        terms, parameters, n = self._terms, self._parameters, self._terms.n
        terms.set_payload(parameters.payload_of(theta))
        q, v = terms.true_position(0.5 * (past[:n] + x[:n])), 0.5 * (past[n:] + x[n:])
        forward, backward = terms.dry(q, v, tau)
        change = parameters.dry(theta)
        forward, backward = np.maximum(forward + change, 0.0), np.maximum(backward + change, 0.0)
        friction = np.where(v > 0.0, forward, -backward)
        viscous = (parameters.viscous(theta, terms.damping) - terms.damping) * v
        needed = terms.inverse_dynamics(q, v, (x[n:] - past[n:]) / dt) + friction + viscous
        if terms.laws.load is not None:
            needed += terms.laws.load(q, v, tau)
        rho = needed - terms.applied(tau) - parameters.push(theta, tau)
        return np.maximum(np.minimum(rho, TUNING.largest), -TUNING.largest), 0.5 * (forward + backward)
