"""The adaptive extended Kalman filter, usable without any Diagram.

    ekf = Ekf(ArmTerms.from_model(model), scenario.Filter())
    ekf.observe(q, v, tau, t)                  # a whole message of the arm, or by hand:
    ekf.predict(tau, dt)
    ekf.update(ekf.encoder, q, t)

It follows the predict and update cycle of Hybrid Reality Twins (section 3.2, algorithm A-EKF, steps 1, 2 and 4).
State and parameters are estimated together; where the outline adapts θ by a gradient, here the joint covariance
adapts it, which weighs every reading by what it tells about θ.

**What the motion does not excite stays as it was**: see `disturbance`. A direction of θ that no torque depends on is
never touched either, its gain being zero.

**A surprise is not an outlier.** Where a reading leaves its χ² gate, the filter asks whether an unmodelled torque
within the joints' effort limits explains it. If so, the sensors are right and the model is not: the state follows
them, with a covariance that says so, and θ hardly moves. If not, the reading is refused. Where surprises persist, the
parameters themselves must have changed, and their covariance opens.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram.errors import TwinError
from twin_diagram.estimation.arm_terms import ArmTerms
from twin_diagram.estimation.belief import Belief, Entry
from twin_diagram.estimation.disturbance import SPEED_TIME, disturbance_std, follow_regimes
from twin_diagram.estimation.parameters import ParameterSet
from twin_diagram.estimation.positive import solve_positive, whiten
from twin_diagram.estimation.sensors import JointEncoder, JointState, JointVelocity, Sensor
from twin_diagram.estimation.transition import jacobians, step
from twin_diagram.scenario import Filter
from twin_diagram.signals import Array

LONGEST_STEP: Final = 0.01
"""A longer prediction is cut into steps no longer than this [s]."""
LONGEST_GAP: Final = 0.25
"""After a longer silence the state is taken anew from the message; parameters are kept [s]."""
REFUSALS: Final = 10
"""After as many refused or stale messages in a row the state is taken anew from the message."""
IMPOSSIBLE: Final = 2.0
"""No joint is predicted to move faster than this many times its speed limit, unless it was measured to."""
ABSURD: Final = 1e4
"""No joint angle, speed or torque share of the effort limit is larger than this."""
_NIS_TIME: Final = 0.1
_QUIET_TIME: Final = 0.5
_START_STD: Final = 3.0
"""A fresh state's standard deviation, in those of its sensors."""


class FilterError(TwinError):
    """A measurement or an input that the filter cannot take: wrong size, unknown sensor, a time that goes back."""


@dataclass(frozen=True)
class Update:
    """What became of a reading.

    Attributes:
        accepted: False where the gate refused it or it was not finite.
        surprise: it was accepted, but only an unmodelled torque explains it.
        nis: squared Mahalanobis distance of the innovation.
        innovation: (m,) z − h(x).
        covariance: (m, m) of the innovation.
    """

    accepted: bool
    surprise: bool
    nis: float
    innovation: Array
    covariance: Array


class Ekf:
    """An adaptive EKF of n joints and p parameters.

    Attributes:
        terms: the arm.
        params: tuning.
        parameters: what θ means.
        belief: all that the filter knows; may be exchanged with `load`.
        encoder, velocity: the arm's own sensors.
        joints: both together, as a message brings them.
    """

    def __init__(self, terms: ArmTerms, params: Filter) -> None:
        self.terms, self.params = terms, params
        self.parameters = ParameterSet(terms, params)
        n, p = terms.n, self.parameters.size
        self.belief = Belief(n, p)
        self.encoder = JointEncoder(n, params.encoder_std)
        self.velocity = JointVelocity(n, params.velocity_std)
        self.joints = JointState(n, params.encoder_std, params.velocity_std)
        self._F = np.eye(self.belief.size)
        self._I = np.eye(self.belief.size)
        self._kept = self.belief.vector.copy()
        self._by_torque: Array | None = None
        self._step_mass = np.eye(n)
        self._period = 1.0 / params.rate

    # What the filter knows.

    def load(self, vector: Array) -> None:
        """Takes a belief's vector as its own (copied)."""
        self.belief.vector[:] = vector
        self._by_torque = None

    def start(self, q: Array, v: Array, tau: Array, t: float) -> None:
        """Takes the state from a message; θ, its covariance and the counters are kept, at the first set to the prior.

        Args:
            q: (n,) [rad].
            v: (n,) [rad/s].
            tau: (n,) [N·m].
            t: [s].
        """
        belief, n = self.belief, self.terms.n
        kept = belief.P[3 * n :, 3 * n :].copy() if belief.valid else self.parameters.covariance
        if not belief.valid:
            belief.theta[:] = self.parameters.mean
        belief.q[:], belief.v[:], belief.disturbance[:] = q, v, 0.0
        belief.torque[:], belief.drift[:], belief.regime[:] = tau, v, 0.0
        belief.innovation[:], belief.before[:], belief.acceleration[:] = 0.0, v, 0.0
        belief.header[Entry.TIME] = t
        belief.header[Entry.NIS] = 2.0 * n
        belief.header[Entry.NIS_MEAN] = 1.0
        belief.header[Entry.STREAK] = 0.0
        belief.header[Entry.QUIET] = min(belief.header[Entry.QUIET], t)
        belief.header[Entry.FRESH] = 1.0
        belief.header[Entry.SPAN] = 0.0
        belief.P[:] = 0.0
        belief.P[3 * n :, 3 * n :] = kept
        dry = self.terms.dry(self.terms.true_position(belief.q), belief.v, belief.torque)
        diagonal = np.concatenate(
            [
                np.full(n, (_START_STD * self.params.encoder_std) ** 2),
                np.full(n, (_START_STD * self.params.velocity_std) ** 2),
                disturbance_std(self.params, np.zeros(n, dtype=bool), 0.5 * (dry[0] + dry[1])) ** 2,
            ]
        )
        belief.P[np.arange(3 * n), np.arange(3 * n)] = diagonal
        self._by_torque = None

    # The cycle.

    def predict(self, u: Array, dt: float, torque_std: Array | float | None = None) -> None:
        """Moves the belief on by dt under the motors' torque.

        Args:
            u: (n,) measured motor torque, mean over the step [N·m].
            dt: > 0 [s].
            torque_std: unmodelled torque [N·m], as white noise over one filter period; None: `Filter.torque_std`.

        Raises:
            FilterError: u is not n finite numbers, dt is not positive and finite, or there is no state yet.
        """
        if not self.belief.valid:
            raise FilterError("there is no state to predict from: start the filter from a message")
        u = np.asarray(u, dtype=float)
        if u.shape != (self.terms.n,) or not np.all(np.isfinite(u)):
            raise FilterError(f"torque {u.tolist()} is not {self.terms.n} finite numbers")
        if not 0.0 < dt < np.inf:
            raise FilterError(f"a prediction over {dt} s: the time must be positive and finite")
        if dt > 10.0 * LONGEST_GAP:
            raise FilterError(f"a prediction over {dt} s is no prediction: start the filter anew from a message")
        parts = int(np.ceil(dt / LONGEST_STEP - 1e-9))
        for _ in range(parts):
            self._predict_once(u, dt / parts, self.params.torque_std if torque_std is None else torque_std)
        self.belief.header[Entry.TIME] += dt

    def update(self, sensor: Sensor, z: Array, t: float | None = None, *, explain: bool = True) -> Update:
        """Takes in a reading.

        Args:
            sensor: its model.
            z: (m,).
            t: when it was taken [s]; None: now. A later time is first predicted to, with the last torque.
            explain: whether an unmodelled torque may explain a reading that leaves its gate.

        Raises:
            FilterError: z has the wrong size, t lies before the belief's time, or there is no state yet.
        """
        belief = self.belief
        if not belief.valid:
            raise FilterError(f"{sensor.name}: there is no state to update: start the filter from a message")
        z = np.asarray(z, dtype=float)
        if z.shape != (sensor.size,):
            raise FilterError(f"{sensor.name}: {z.shape} numbers where {sensor.size} are expected")
        if t is not None:
            ahead = t - belief.time
            if not ahead > -1e-9:
                raise FilterError(f"{sensor.name}: its time {t} s lies before the filter's, {belief.time} s")
            if ahead > 1e-9:
                self.predict(belief.torque, ahead)
                belief.header[Entry.TIME] = t
        innovation = z - sensor.reading(belief.x)
        if not np.all(np.isfinite(z)):
            belief.header[Entry.INVALID] += 1
            return Update(False, False, 0.0, np.zeros(sensor.size), sensor.noise(belief.x))
        H, R = sensor.jacobian(belief.x), sensor.noise(belief.x)
        HP = H @ belief.P
        S = HP @ H.T + R
        right = np.concatenate([HP, innovation[:, None]], axis=1)
        solved = solve_positive(S, right)
        nis = float(innovation @ solved[:, -1])
        surprise = nis > sensor.gate
        if surprise:
            if explain and self._by_torque is not None:
                wide = belief.P + self._unmodelled()
                HP = H @ wide
                solved = solve_positive(HP @ H.T + R, np.column_stack([HP, innovation]))
                explained = float(innovation @ solved[:, -1]) <= sensor.gate
            else:
                explained = False
            if not explained:
                return Update(False, False, nis, innovation, S)
            belief.P[:] = wide
        K = solved[:, :-1].T
        belief.x += K @ innovation
        A = self._I - K @ H
        P = A @ belief.P @ A.T + K @ R @ K.T
        belief.P[:] = 0.5 * (P + P.T)
        self.parameters.clip(belief.theta)
        return Update(True, surprise, nis, innovation, S)

    def observe(self, q: Array, v: Array, tau: Array, t: float) -> bool:
        """Takes in one message of the arm, whatever it holds; the belief is never poisoned.

        Args:
            q: (n,) measured positions [rad].
            v: (n,) estimated velocities [rad/s].
            tau: (n,) measured motor torques [N·m].
            t: measurement time [s]; `NEVER` or any negative, stale or non-finite time means that there is no message.

        Returns:
            Whether the message was used.
        """
        belief, header = self.belief, self.belief.header
        if not np.isfinite(t):
            header[Entry.INVALID] += 1
            return False
        if t < 0.0:
            return False
        usable = bool(np.all(np.abs(q) < ABSURD) and np.all(np.abs(v) < ABSURD))  # NaN compares false
        heard = bool(np.all(np.abs(tau) < ABSURD * self.terms.effort_limit))
        if not usable or not (heard or belief.valid):
            header[Entry.INVALID] += 1
            return False
        if not belief.valid:
            self.start(q, v, tau, t)
            return True
        dt = t - belief.time
        if dt <= 1e-9:
            header[Entry.STALE] += 1
            # The same message seen again is no sign of trouble; a clock that was set back is.
            header[Entry.STREAK] = header[Entry.STREAK] + 1 if dt < -LONGEST_GAP else header[Entry.STREAK]
            if header[Entry.STREAK] < REFUSALS:
                return False
        if not heard:
            header[Entry.INVALID] += 1
            tau = belief.torque
        if not 0.0 < dt <= LONGEST_GAP or header[Entry.STREAK] >= REFUSALS:
            header[Entry.RESTARTS] += 1
            self.start(q, v, tau, t)
            return True
        self._kept[:] = belief.vector
        try:
            with np.errstate(all="ignore"):
                self._observe_next(q, v, tau, t, dt, heard)
            sound = bool(np.all(np.isfinite(belief.vector))) and bool(np.all(np.abs(belief.x) < 2.0 * ABSURD))
        except (np.linalg.LinAlgError, FilterError):
            sound = False
        if not sound:
            # The model ran away, as it may under absurd torques: parameters as before, state from the sensors.
            belief.vector[:] = self._kept
            header[Entry.RESTARTS] += 1
            self.start(q, v, tau, t)
        return True

    # Details.

    def _observe_next(self, q: Array, v: Array, tau: Array, t: float, dt: float, heard: bool) -> None:
        belief, header, n = self.belief, self.belief.header, self.terms.n
        # The first torque after a start may be a placeholder, so the first step's torque is as good as unknown.
        trusted = heard and header[Entry.FRESH] == 0.0
        header[Entry.FRESH] = 0.0
        self.predict(0.5 * (belief.torque + tau), dt, None if trusted else self.terms.effort_limit)
        header[Entry.TIME] = t
        belief.torque[:] = tau
        whole = self.update(self.joints, np.concatenate([q, v]))
        if not whole.accepted:
            self._salvage(whole, q, v)
        nis = whole.nis
        header[Entry.NIS] = nis
        blend = min(dt / _NIS_TIME, 1.0)
        if whole.accepted:  # what was refused says something of a sensor, nothing of the parameters
            header[Entry.NIS_MEAN] += blend * (min(nis / (2 * n), 50.0) - header[Entry.NIS_MEAN])
        momentum = self._step_mass @ whole.innovation[n:]
        spread = self._step_mass @ whole.covariance[n:, n:] @ self._step_mass.T
        belief.innovation[:] = whiten(spread, momentum)
        if whole.accepted:
            header[Entry.ACCEPTED] += 1
            header[Entry.STREAK] = 0.0
        else:
            header[Entry.REFUSED] += 1
            header[Entry.STREAK] += 1
        header[Entry.SURPRISES] += float(whole.surprise)
        if header[Entry.NIS_MEAN] > self.params.opening and t >= header[Entry.QUIET]:
            self._open(t)

    def _salvage(self, whole: Update, q: Array, v: Array) -> None:
        """Of a refused message, takes the one sensor that is within its own gate; if both are, they contradict."""
        n = self.terms.n
        good = []
        for sensor, z, part in ((self.encoder, q, slice(0, n)), (self.velocity, v, slice(n, 2 * n))):
            innovation = whole.innovation[part]
            if innovation @ solve_positive(whole.covariance[part, part], innovation) <= sensor.gate:
                good.append((sensor, z))
        if len(good) == 1:
            self.update(*good[0], explain=False)

    def _predict_once(self, u: Array, dt: float, torque_std: Array | float) -> None:
        belief, terms, parameters, n = self.belief, self.terms, self.parameters, self.terms.n
        dry = terms.dry(terms.true_position(belief.q), belief.v, u)
        keep, fresh = follow_regimes(belief, self.params, dt, 0.5 * (dry[0] + dry[1]))
        v = belief.v.copy()
        span = float(belief.header[Entry.SPAN])
        if span > 0.0:
            observed = (v - belief.before) / span
            belief.acceleration += min(span / SPEED_TIME, 1.0) * (observed - belief.acceleration)
        belief.before[:], belief.header[Entry.SPAN] = v, dt
        moved = step(terms, parameters, belief.q, v, belief.theta, u, belief.disturbance, dt, dry)
        by = jacobians(terms, parameters, moved, v, belief.theta, dt, belief.acceleration)
        F = self._F
        F[: 2 * n, : 2 * n] = by.state
        F[: 2 * n, 2 * n : 3 * n] = by.torque
        F[: 2 * n, 3 * n :] = by.parameters
        F.flat[2 * n * (belief.size + 1) : 3 * n * (belief.size + 1) : belief.size + 1] = keep
        P = F @ belief.P @ F.T
        white = by.torque * (torque_std * np.sqrt(self._period / dt))
        P[: 2 * n, : 2 * n] += white @ white.T
        at = np.arange(2 * n, 3 * n)
        P[at, at] += fresh
        if np.any(belief.regime != 0.0):
            at = np.arange(3 * n, belief.size)
            P[at, at] += (self.params.parameter_walk * parameters.scale) ** 2 * dt
        belief.P[:] = 0.5 * (P + P.T)
        # Where the model asks for the impossible (a torque in error on a light joint), it is not followed there.
        limit = np.maximum(IMPOSSIBLE * terms.velocity_limit, np.abs(v))
        belief.v[:] = np.clip(moved.v, -limit, limit)
        belief.q[:] = moved.q + (0.5 * dt) * (belief.v - moved.v)
        belief.disturbance *= keep
        self._by_torque = by.torque
        self._step_mass = moved.mass

    def _unmodelled(self) -> Array:
        """Covariance (N, N) that an unmodelled torque of the effort limits' size adds in the last step."""
        assert self._by_torque is not None
        n = self.terms.n
        spread = self._by_torque * self.terms.effort_limit
        added = np.zeros((self.belief.size, self.belief.size))
        added[: 2 * n, : 2 * n] = spread @ spread.T
        return added

    def _open(self, t: float) -> None:
        """An abrupt change: parameters and disturbances may be anything again that the prior allows."""
        belief, n = self.belief, self.terms.n
        belief.header[Entry.OPENINGS] += 1
        belief.header[Entry.QUIET] = t + _QUIET_TIME
        now, prior = belief.P[3 * n :, 3 * n :], self.parameters.covariance
        # Openings do not add up: none makes a parameter less certain than twice its prior.
        room = np.sqrt(np.clip(2.0 - now.diagonal() / prior.diagonal(), 0.0, 1.0))
        now += prior * np.outer(room, room)
