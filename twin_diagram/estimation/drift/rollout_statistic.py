"""Every so often the model runs ahead from what the filter held, and is compared with what the sensors then said.

Section 3.4 of Hybrid Reality Twins: from x̂, θ̂ under the torques measured since, per joint and at the hand. The joints'
errors count as joint torque, so that they compare between joints and poses; the hand's is a distance. A threshold is
μ + kσ of normal operation, wider where that was learnt from little (`learned_threshold`), but never within what the
filter allows its friction to be wrong by and the torque that is measured, or not, from one message to the next.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform

from twin_diagram.estimation.drift import learned_threshold
from twin_diagram.estimation.drift.state import DriftEntry, DriftState
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.link_frame import LinkFrame
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.estimation.dynamics.short_rollout import short_rollout, torque_error
from twin_diagram.estimation.filter.disturbance import disturbance_std
from twin_diagram.scenario import Drift, Filter
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER


@dataclass(frozen=True)
class Tuning:
    """Guards of the arithmetic, chosen by hand: no figure hangs on them."""

    runaway: float = 1e6
    """Stands for the error of a rollout that ran away [N·m], [m]."""

    smallest: float = 1e-9
    """No threshold is below it [N·m], [m]: a hand that lies on its joint's axis never moves."""


TUNING = Tuning()


class RolloutTest:
    """The test of one arm; all that it remembers is in the monitor's `DriftState`."""

    def __init__(self, terms: ArmTerms, parameters: ParameterSet, params: Drift, tuning: Filter) -> None:
        """Keep what it needs of the arm.

        Args:
            terms: the arm; its tool is the hand.
            parameters: what θ means.
            params: of the monitor.
            tuning: of the filter.
        """
        self._terms, self._parameters, self._params, self._tuning = terms, parameters, params, tuning
        self._hand = LinkFrame(terms, terms.link_frame, RigidTransform(terms.tool))
        self._slides = np.ones(terms.n, dtype=bool)

    @staticmethod
    def rows(params: Drift, tuning: Filter) -> int:
        """Return torques that a rollout holds, at twice the filter's rate."""
        return int(np.ceil(params.horizon * tuning.rate * 2.0)) + 4

    def follow(
        self,
        state: DriftState,
        x: Array,
        theta: Array,
        q: Array,
        tau: Array,
        t: float,
        state_time: float,
        learning: bool,
        armed: bool,
    ) -> float:
        """Take in a message; answer a finished rollout's statistic over its threshold, else 0.

        Args:
            state: of the monitor.
            x: (2n,) x̂ at `state_time`.
            theta: (p,) θ̂.
            q: (n,) measured positions [rad].
            tau: (n,) measured torques [N·m].
            t: of the message [s].
            state_time: of x̂ [s].
            learning: whether this is normal operation, to be learnt.
            armed: whether it is known.
        """
        h, torques, found = state.header, state.torques, 0.0
        if h[DriftEntry.STARTED] >= 0.0 and t <= h[DriftEntry.STARTED]:
            torques[0, 1:] = tau  # the state was carried on beyond its message
        elif h[DriftEntry.STARTED] >= 0.0:
            row = int(h[DriftEntry.FILLED])
            if row >= len(torques):  # messages come faster than expected: give up this rollout
                h[DriftEntry.STARTED] = NEVER
                return 0.0
            torques[row, 0], torques[row, 1:] = t, tau
            h[DriftEntry.FILLED] += 1
            if t - h[DriftEntry.STARTED] >= self._params.horizon - 1e-6:
                found = self._compare(state, q, learning, armed)
                h[DriftEntry.STARTED] = NEVER
        if h[DriftEntry.STARTED] < 0.0 and t >= h[DriftEntry.NEXT] - 1e-6:
            # Until enough has been learnt, one rollout follows on the other.
            wait = self._params.period if armed else self._params.horizon
            h[DriftEntry.NEXT] = t + max(wait, self._params.horizon)
            h[DriftEntry.STARTED], h[DriftEntry.FILLED] = state_time, 1.0
            state.from_state[:], state.from_theta[:] = x, theta
            torques[0, 0], torques[0, 1:] = state_time, tau
        return found

    def _compare(self, state: DriftState, q: Array, learning: bool, armed: bool) -> float:
        h, terms = state.header, self._terms
        n, filled = terms.n, int(h[DriftEntry.FILLED])
        times, torques = state.torques[:filled, 0], state.torques[:filled, 1:]
        end, speed = short_rollout(terms, self._parameters, state.from_state, state.from_theta, times, torques)
        span = float(times[-1] - times[0])
        error: Array = np.empty(n + 1)
        error[:n] = np.abs(torque_error(terms, self._parameters, q, state.from_theta, q - end, span))
        _, p_measured, J = self._hand.jacobian(q)
        runs_away = not np.all(np.abs(end) < TUNING.runaway)
        p_predicted = p_measured if runs_away else self._hand.pose(end)[1]
        error[n] = TUNING.runaway if runs_away else np.linalg.norm(p_predicted - p_measured)
        error = np.nan_to_num(error, nan=TUNING.runaway, posinf=TUNING.runaway).clip(max=TUNING.runaway)
        if learning:
            h[DriftEntry.ROLLOUTS] += 1
            before = error - state.roll_mean
            state.roll_mean += before / h[DriftEntry.ROLLOUTS]
            state.roll_squares += before * (error - state.roll_mean)
            return 0.0
        if not armed:
            return 0.0
        k = self._params.sigma
        forward, backward = terms.dry(terms.true_position(q), speed, torques[-1])
        level = disturbance_std(self._tuning, self._slides, 0.5 * (forward + backward))
        std = np.hypot(level, white_std(self._tuning, span))
        claimed = np.empty(n + 1)
        claimed[:n] = k * std
        # What such torques do to the hand over the span.
        moved = J[3:] @ np.linalg.solve(terms.mass_matrix(terms.true_position(q)), np.diag(std * (0.5 * span**2)))
        claimed[n] = k * np.linalg.norm(moved)
        count = max(h[DriftEntry.ROLLOUTS], 1.0)
        usual = learned_threshold.threshold(state.roll_mean, state.roll_squares / count, k, count)
        h[DriftEntry.ROLLOUT] = float(np.max(error / np.maximum(np.maximum(usual, claimed), TUNING.smallest)))
        h[DriftEntry.HAND] = error[n]
        return float(h[DriftEntry.ROLLOUT])


def white_std(tuning: Filter, span: float) -> float:
    """Return the deviation of the constant torque that moves a joint as far as white torque does [N·m].

    White torque of σ in each of N steps h moves a joint of inertia I by Σ (N − i + ½) h² τ_i / I, with the standard
    deviation σ h² √(N³/3) / I; a constant torque moves it by ½ (N h)² τ / I.

    Args:
        tuning: of the filter, with σ for one of its steps.
        span: [s].
    """
    return float(tuning.torque_std * np.sqrt(4.0 / (3.0 * max(span * tuning.rate, 1.0))))
