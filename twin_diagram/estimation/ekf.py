"""The adaptive extended Kalman filter, usable without any Diagram.

    ekf = Ekf(ArmTerms.from_model(model), scenario.Filter())
    ekf.observe(q, v, tau, t)                  # a whole message of the arm, or by hand:
    ekf.predict(tau, dt)
    ekf.update("encoder", q)
    ekf.add(BodyPose(ekf.terms, "panda_hand"))
    ekf.update("camera", z, t)                 # fused at t, though newer readings came first

It follows the predict and update cycle of Hybrid Reality Twins (section 3.2, algorithm A-EKF, steps 1, 2 and 4).
State and parameters are estimated together; where the outline adapts θ by a gradient, here the joint covariance
adapts it, which weighs every reading by what it tells about θ.

**What the motion does not excite stays as it was**: see `disturbance`. A direction of θ that no torque depends on is
never touched either, its gain being zero.

**A surprise is not an outlier.** Where a reading leaves its χ² gate, the filter asks whether an unmodelled torque
within the joints' effort limits explains it. If so, the sensors are right and the model is not: the state follows
them, with a covariance that says so, and θ hardly moves. If not, the reading is refused. Where surprises persist, the
parameters themselves must have changed, and their covariance opens.

**Two time scales.** The state moves with every reading. The physics takes over the parameters learnt at
`Filter.parameter_rate`; in between, what has been learnt acts through the derivatives, so nothing of it is lost.

**Late readings** are fused at their own time: see `history`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram.errors import ScenarioError
from twin_diagram.estimation.arm_terms import ArmTerms
from twin_diagram.estimation.belief import HEADER, Belief, Entry, Track
from twin_diagram.estimation.blame import keep_score, suspects
from twin_diagram.estimation.declared import Declared, FilterError, note
from twin_diagram.estimation.disturbance import SPEED_TIME, creep_std, disturbance_std, follow_regimes
from twin_diagram.estimation.history import History
from twin_diagram.estimation.parameters import ParameterSet
from twin_diagram.estimation.positive import joseph, solve_positive, whiten
from twin_diagram.estimation.sensors import Instant, JointEncoder, JointState, JointVelocity, Linear, Sensor
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
_QUIET_TIME: Final = 0.2
_START_STD: Final = 3.0
"""A fresh state's standard deviation, in those of its sensors."""


@dataclass(frozen=True)
class Update:
    """What became of a reading.

    Attributes:
        accepted: False where the gate refused it or it was not finite.
        surprise: it was accepted, but only an unmodelled torque explains it.
        nis: squared Mahalanobis distance of the innovation.
        innovation: (m,) z − h(x).
        covariance: (m, m) of the innovation.
        late: it was fused at a time before the filter's.
    """

    accepted: bool
    surprise: bool
    nis: float
    innovation: Array
    covariance: Array
    late: bool = False


class Ekf:
    """An adaptive EKF of n joints and p parameters.

    Attributes:
        terms: the arm.
        params: tuning.
        parameters: what θ means.
        belief: all that the filter knows; may be exchanged with `load`.
        declared: the further sensors.
        history: the recent past, for readings that arrive late.
        encoder, velocity: the arm's own sensors.
        joints: both together, as a message brings them.
    """

    def __init__(self, terms: ArmTerms, params: Filter) -> None:
        """Makes a filter that has not heard anything yet.

        Raises:
            ScenarioError: a parameter or a rule that does not exist.
        """
        if params.rule not in ("covariance", "gradient"):
            raise ScenarioError("twin.filter.rule", f"{params.rule!r} is neither 'covariance' nor 'gradient'")
        self.terms, self.params = terms, params
        self.parameters = ParameterSet(terms, params)
        self.encoder = JointEncoder(terms.n, params.encoder_std)
        self.velocity = JointVelocity(terms.n, params.velocity_std)
        self.joints = JointState(terms.n, params.encoder_std, params.velocity_std)
        self._arm = {sensor.name: sensor for sensor in (self.encoder, self.velocity, self.joints)}
        self.declared = Declared()
        self._period = 1.0 / params.rate
        self._widest = np.concatenate([np.full(terms.n, np.pi**2), (IMPOSSIBLE * terms.velocity_limit) ** 2])
        self._size()

    def _size(self) -> None:
        n, p = self.terms.n, self.parameters.size
        self.belief = Belief(n, p, self.declared.own, self.declared.sizes)
        size = self.belief.size
        self.history = History(n, p, size, max(2, int(np.ceil(self.params.history * self.params.rate)) + 2))
        self._F = np.eye(size)
        self._I = np.eye(size)
        self._kept = self.belief.vector.copy()
        self._by_torque: Array | None = None
        self._step_mass = np.eye(n)
        self._walk = self.declared.walk()

    def add(self, sensor: Sensor) -> None:
        """Declares a further sensor; readings may then name it. What the filter knows already is kept.

        Raises:
            FilterError: a sensor of that name is there already.
        """
        if sensor.name in self._arm:
            raise FilterError(f"a sensor {sensor.name!r} is declared already: give each a name of its own")
        before, start = self.belief, 3 * self.terms.n + self.parameters.size
        payload = self.parameters.payload
        at = None if payload is None else slice(3 * self.terms.n + payload.start, 3 * self.terms.n + payload.stop)
        self.declared.add(sensor, start, at)
        self._size()
        after = self.belief
        same = HEADER + 6 * before.n + before.p * (before.p + 3)
        after.vector[:same] = before.vector[:same]
        after.x[: before.size] = before.x
        after.P[: before.size, : before.size] = before.P
        new = np.arange(before.size, after.size)
        after.P[new, new] = self.declared.prior()[before.size - start :]
        for old, track in zip(before.tracks, after.tracks, strict=False):
            track[:] = old
        if after.valid:
            self.history.begin(after.time, after.x, after.P)

    # What the filter knows.

    def load(self, vector: Array, history: Array | None = None) -> None:
        """Takes a belief's vector as its own (copied).

        Args:
            vector: of a `Belief` of the same sensors and parameters.
            history: of its `History`; None: late readings cannot be fused across the exchange.
        """
        self.belief.vector[:] = vector
        self._by_torque = None
        if history is not None:
            self.history.vector[:] = history
        elif self.belief.valid:
            self.history.begin(self.belief.time, self.belief.x, self.belief.P)
        else:
            self.history.clear()

    def labels(self, joints: Sequence[str]) -> list[str]:
        """Names with units of the parameters (p,) and of the sensors' own states, as they follow in x."""
        return self.parameters.labels(joints) + self.declared.labels()

    def suspicion(self) -> dict[str, float]:
        """How strongly each further sensor contradicts the rest: above 1 it does. See `Declared.suspicion`."""
        return self.declared.suspicion(self.belief)

    def odd_one_out(self) -> str | None:
        """The sensor that contradicts the others, `joints` for the arm's own; None where all agree."""
        return self.declared.odd_one_out(self.belief)

    def counters(self) -> dict[str, dict[str, int]]:
        """Of each further sensor, how many readings were accepted, refused and so on: see `belief.Track`."""
        return {
            name: {entry.name.lower(): int(track[entry]) for entry in Track if Track.ACCEPTED <= entry < Track.RUN}
            for name, track in zip(self.declared.sensors, self.belief.tracks, strict=True)
        }

    def start(self, q: Array, v: Array, tau: Array, t: float) -> None:
        """Takes the state from a message; θ, its covariance and the counters are kept, at the first set to the prior.

        Args:
            q: (n,) [rad].
            v: (n,) [rad/s].
            tau: (n,) [N·m].
            t: [s].
        """
        belief, n = self.belief, self.terms.n
        if belief.valid:
            kept = belief.P[3 * n :, 3 * n :].copy()
        else:
            p = belief.p
            kept = np.zeros((belief.size - 3 * n, belief.size - 3 * n))
            kept[:p, :p] = self.parameters.covariance if self.params.rule == "covariance" else 0.0
            kept[p:, p:] = np.diag(self.declared.prior())
            belief.theta[:] = self.parameters.mean
        belief.model[:], belief.gradient[:], belief.score[:] = belief.theta, 0.0, 0.0
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
        belief.header[[Entry.RELEASED, Entry.HEARD]] = t
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
        self.declared.start(belief, t)
        self.history.begin(t, belief.x, belief.P)

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

    def update(
        self,
        sensor: Sensor | str,
        z: Array,
        t: float | None = None,
        noise: Array | None = None,
        *,
        explain: bool = True,
    ) -> Update:
        """Takes in a reading.

        Args:
            sensor: its name, or its model; `encoder`, `velocity` and `joints` are there, others are declared by `add`.
            z: (sensor.length,).
            t: when it was taken [s]; None: now. A later time is first predicted to, with the last torque; at an earlier
                one the reading is fused where it belongs, to the nearest step within `Filter.history`.
            noise: R (m, m) of this reading, or standard deviations (m,); None: the sensor's own.
            explain: whether an unmodelled torque may explain a reading that leaves its gate.

        Raises:
            FilterError: a sensor that was not declared, z or noise has the wrong size, t is not finite or lies before
                all that the filter remembers, or there is no state yet.
        """
        sensor = self._find(sensor)
        kept = self.belief.vector.copy()
        try:
            with np.errstate(all="ignore"):
                result = self._update(sensor, z, t, noise, explain)
            sound = bool(np.all(np.isfinite(self.belief.vector)))
        except np.linalg.LinAlgError:
            sound = False
        if not sound:
            self.load(kept)
            raise FilterError(f"{sensor.name}: the reading {np.asarray(z).tolist()} cannot be fused; it is left out")
        return result

    def _update(self, sensor: Sensor, z: Array, t: float | None, noise: Array | None, explain: bool) -> Update:
        belief = self.belief
        if not belief.valid:
            raise FilterError(f"{sensor.name}: there is no state to update: start the filter from a message")
        z = np.asarray(z, dtype=float)
        if z.shape != (sensor.length,):
            raise FilterError(f"{sensor.name}: {z.shape} numbers where {sensor.length} are expected")
        if noise is not None:
            noise = _covariance(sensor, noise)
        track = self.declared.track(belief, sensor) if sensor.name in self.declared.sensors else None
        back, ahead = 0, 0.0
        if t is not None:
            ahead = t - belief.time
            if not np.isfinite(t):
                raise FilterError(f"{sensor.name}: its time {t} is not a finite number of seconds")
            if ahead < -1e-9:
                found = self.history.find(t)
                if found is None:
                    if track is not None:
                        track[Track.STALE] += 1
                    raise FilterError(
                        f"{sensor.name}: its time {t} s lies before all that the filter remembers, "
                        f"{min(self.history.oldest, belief.time)} to {belief.time} s"
                    )
                back = found
            elif ahead > 1e-9:
                self.predict(belief.torque, ahead)
                belief.header[Entry.TIME] = t
                self.history.retime(t)
        if not sensor.sound(z):
            if track is None:
                belief.header[Entry.INVALID] += 1
            else:
                track[Track.INVALID] += 1
            return Update(False, False, 0.0, np.zeros(sensor.size), np.eye(sensor.size))
        if back or (ahead < -1e-9 and self.history.count):
            assert t is not None
            return self._update_late(sensor, z, t, noise, track, back)
        at = self._linear(sensor, belief.x, 0)
        R = at.noise if noise is None else noise
        result = self._fuse(sensor, z, at, R, explain)
        if track is not None:
            self._note(sensor, track, result, belief.time, at)
        elif result.accepted:
            belief.header[Entry.HEARD] = belief.time
        return result

    def _fuse(self, sensor: Sensor, z: Array, at: Linear, R: Array, explain: bool) -> Update:
        belief, H = self.belief, at.jacobian
        innovation = sensor.innovation(z, at.reading)
        HP = H @ belief.P
        S = HP @ H.T + R
        right = np.concatenate([HP, innovation[:, None]], axis=1)
        solved = solve_positive(S, right)
        nis = float(innovation @ solved[:, -1])
        surprise = nis > sensor.gate
        if surprise:
            if explain and self._by_torque is not None:
                jumped = innovation[self.terms.n :] if sensor is self.joints else 0.0
                added = self._unmodelled(jumped)
                wide = belief.P + added
                HP = H @ wide
                solved = solve_positive(HP @ H.T + R, np.column_stack([HP, innovation]))
                explained = float(innovation @ solved[:, -1]) <= sensor.gate
            else:
                explained = False
            if not explained:
                return Update(False, False, nis, innovation, S)
            belief.P[:] = wide
            self.history.widen(added)
        self.history.read(H, R, innovation + H @ belief.x)
        K = solved[:, :-1].T
        belief.x += K @ innovation
        A = self._I - K @ H
        P = A @ belief.P @ A.T + K @ R @ K.T
        belief.P[:] = 0.5 * (P + P.T)
        if self.params.rule == "gradient" and not surprise:
            self._gather(H, solved[:, -1])
        self.parameters.clip(belief.theta)
        self.history.settle(belief.x, belief.P)
        return Update(True, surprise, nis, innovation, S)

    def _update_late(
        self, sensor: Sensor, z: Array, t: float, noise: Array | None, track: Array | None, back: int
    ) -> Update:
        """Fuses a reading at an earlier step, and runs the steps after it again."""
        belief, n = self.belief, self.terms.n
        time, x, P = self.history.state(back)
        # From the step's end to the reading's own time the state moves by its speed: half a step at most.
        lead = t - time
        moved = x.copy()
        moved[:n] += lead * x[n : 2 * n]
        at = self._linear(sensor, moved, back)
        H = at.jacobian.copy()
        H[:, n : 2 * n] += lead * H[:, :n]
        R = at.noise if noise is None else noise
        innovation = sensor.innovation(z, at.reading)
        S = H @ P @ H.T + R
        nis = float(innovation @ solve_positive(S, innovation))
        accepted = nis <= sensor.gate
        result = Update(accepted, False, nis, innovation, S, late=True)
        if accepted:
            self.history.read(H, R, innovation + H @ x, back)
            x, P = joseph(x, P, H, R, innovation)
            belief.x[:], P = self.history.rerun(back, x, P, self.parameters.opening, self.parameters.clip)
            belief.P[:] = P
            self.parameters.clip(belief.theta)
        if track is not None:
            self._note(sensor, track, result, t, at)
            track[Track.LATE] += accepted
        else:
            belief.header[Entry.LATE] += accepted
        return result

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
            if self.history.knows(t):  # the same message seen again is no sign of trouble
                header[Entry.STALE] += 1
                return False
            # A run of messages that go back in time is a clock that was set back.
            header[Entry.STREAK] += 1
            if header[Entry.STREAK] < REFUSALS:
                if t >= self.history.oldest:
                    return self.update(self.joints, np.concatenate([q, v]), t).accepted
                header[Entry.STALE] += 1
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

    def _find(self, sensor: Sensor | str) -> Sensor:
        name = sensor if isinstance(sensor, str) else sensor.name
        found = self._arm.get(name) or self.declared.sensors.get(name)
        if found is None or not (isinstance(sensor, str) or found is sensor):
            known = ", ".join([*self._arm, *self.declared.sensors])
            raise FilterError(f"sensor {name!r} was never declared: add it first; there are {known}")
        return found

    def _linear(self, sensor: Sensor, x: Array, back: int) -> Linear:
        if sensor.name in self._arm or not self.history.count:
            return Linear(sensor.reading(x), sensor.jacobian(x), sensor.noise(x))
        return sensor.linear(Instant(x, self.terms.n, self.belief.p, *self.history.motion(back)))

    def _note(self, sensor: Sensor, track: Array, result: Update, t: float, at: Linear) -> None:
        """Keeps a further sensor's record; a run of refusals opens what only this sensor tells."""
        belief = self.belief
        note(track, whiten(result.covariance, result.innovation), result.nis, t, result.accepted)
        if track[Track.STREAK] < REFUSALS:
            return
        track[Track.STREAK] = 0.0
        track[Track.REACQUIRED] += 1
        prior = sensor.own_std() ** 2
        if len(prior):
            belief.P[sensor.own, :] = 0.0
            belief.P[:, sensor.own] = 0.0
            belief.P[sensor.own, sensor.own] = np.diag(prior)
        if not self.declared.vouched(belief, sensor, t):
            # Nobody else tells of the state: it, and not the sensor, must be wrong.
            wider = np.sqrt(max(2.0 * result.nis / sensor.size, 1.0))
            belief.P[: 2 * belief.n, :] *= wider
            belief.P[:, : 2 * belief.n] *= wider
            self._bound()
        self.history.begin(belief.time, belief.x, belief.P)

    def _bound(self) -> None:
        """No angle is less certain than a turn, no speed than twice its limit: blind, the covariance must not run away.

        Scaling rows and columns alike keeps it positive.
        """
        belief, n = self.belief, self.terms.n
        variance = belief.P.diagonal()[: 2 * n]
        if np.all(variance <= self._widest):
            return
        scale = np.sqrt(np.minimum(self._widest / np.maximum(variance, np.finfo(float).tiny), 1.0))
        belief.P[: 2 * n, :] *= scale[:, None]
        belief.P[:, : 2 * n] *= scale

    def _release(self, t: float) -> None:
        """Lets the physics take over what has been learnt, at the parameters' own rate."""
        belief, header = self.belief, self.belief.header
        if t < header[Entry.RELEASED] + 1.0 / self.params.parameter_rate - 1e-9:
            return
        header[Entry.RELEASED] = t
        if self.params.rule == "gradient":
            # θ ← θ − η ∇ of the squared innovation, in units of the prior: section 3.2, step 3.
            belief.theta += self.params.learning_rate * self.parameters.scale**2 * belief.gradient
            belief.gradient[:] = 0.0
            self.parameters.clip(belief.theta)
        belief.model[:] = belief.theta

    def _gather(self, H: Array, weighted: Array) -> None:
        """Adds a reading's share to the gradient: how the step that led to it depends on θ, times S⁻¹ y."""
        n = self.terms.n
        by_theta = H[:, : 2 * n] @ self._F[: 2 * n, 3 * n : 3 * n + self.belief.p]
        self.belief.gradient += by_theta.T @ weighted

    def _observe_next(self, q: Array, v: Array, tau: Array, t: float, dt: float, heard: bool) -> None:
        belief, header, n = self.belief, self.belief.header, self.terms.n
        # The first torque after a start may be a placeholder, so the first step's torque is as good as unknown.
        trusted = heard and header[Entry.FRESH] == 0.0
        header[Entry.FRESH] = 0.0
        self.predict(0.5 * (belief.torque + tau), dt, None if trusted else self.terms.effort_limit)
        header[Entry.TIME] = t
        self.history.retime(t)
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
        if belief.p and trusted:
            # Momentum's innovations by θ: what the step's velocity owes to it.
            by_theta = self._step_mass @ self._F[n : 2 * n, 3 * n : 3 * n + belief.p]
            keep_score(belief.score, whiten(spread, by_theta), belief.innovation)
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
        keep, fresh, changed = follow_regimes(belief, self.params, dt, 0.5 * (dry[0] + dry[1]))
        v = belief.v.copy()
        span = float(belief.header[Entry.SPAN])
        if span > 0.0:
            observed = (v - belief.before) / span
            belief.acceleration += min(span / SPEED_TIME, 1.0) * (observed - belief.acceleration)
        belief.before[:], belief.header[Entry.SPAN] = v, dt
        self._release(float(belief.header[Entry.TIME]))
        theta = belief.model
        moved = step(terms, parameters, belief.q, v, theta, u, belief.disturbance, dt, dry)
        by = jacobians(terms, parameters, moved, v, theta, dt, belief.acceleration, u)
        F, own = self._F, 3 * n + belief.p
        F[: 2 * n, : 2 * n] = by.state
        F[: 2 * n, 2 * n : 3 * n] = by.torque
        F[: 2 * n, 3 * n : own] = by.parameters
        F.flat[2 * n * (belief.size + 1) : 3 * n * (belief.size + 1) : belief.size + 1] = keep
        if changed.any():  # what is drawn afresh has nothing to do with what was
            F[: 2 * n, 2 * n + np.flatnonzero(changed)] = 0.0
        Q = np.zeros_like(F)
        torque_std = np.hypot(torque_std, creep_std(v, 0.5 * (dry[0] + dry[1])))
        white = by.torque * (torque_std * np.sqrt(self._period / dt))
        Q[: 2 * n, : 2 * n] = white @ white.T
        at = np.arange(2 * n, 3 * n)
        Q[at, at] = fresh
        if self.params.rule == "covariance" and np.any(belief.regime != 0.0):
            at = np.arange(3 * n, own)
            Q[at, at] = (self.params.parameter_walk * parameters.scale) ** 2 * dt
        if belief.size > own:
            at = np.arange(own, belief.size)
            Q[at, at] = self._walk * dt
        P = F @ belief.P @ F.T + Q
        belief.P[:] = 0.5 * (P + P.T)
        self._bound()
        learnt = by.parameters @ (belief.theta - theta)
        # Where the model asks for the impossible (a torque in error on a light joint), it is not followed there.
        limit = np.maximum(IMPOSSIBLE * terms.velocity_limit, np.abs(v))
        speed = moved.v + learnt[n:]
        belief.v[:] = np.clip(speed, -limit, limit)
        belief.q[:] = moved.q + learnt[:n] + (0.5 * dt) * (belief.v - speed)
        belief.disturbance *= keep
        belief.header[Entry.TIME] += dt
        self.history.push(float(belief.header[Entry.TIME]), dt, belief.x, moved.a, F, Q)
        self.history.settle(belief.x, belief.P)
        self._by_torque = by.torque
        self._step_mass = moved.mass

    def _unmodelled(self, jump: Array | float) -> Array:
        """Covariance (N, N) that an unmodelled torque of the effort limits' size adds in the last step.

        When within the step it began is not known: a jump of speed moves a joint by 0 to dt times that.

        Args:
            jump: (n,) of the speeds, as measured [rad/s].
        """
        assert self._by_torque is not None
        n = self.terms.n
        spread = self._by_torque * self.terms.effort_limit
        added = np.zeros((self.belief.size, self.belief.size))
        added[: 2 * n, : 2 * n] = spread @ spread.T
        late = jump * (float(self.belief.header[Entry.SPAN]) / np.sqrt(12.0))
        added[np.arange(n), np.arange(n)] += late**2
        return added

    def _open(self, t: float) -> None:
        """An abrupt change: what recent innovations speak for may be anything again that `opening` allows."""
        belief, n = self.belief, self.terms.n
        belief.header[Entry.OPENINGS] += 1
        belief.header[Entry.QUIET] = t + _QUIET_TIME
        if self.params.rule == "gradient" or not belief.p:
            return
        at = slice(3 * n, 3 * n + belief.p)
        now, prior = belief.P[at, at], self.parameters.opening
        changed = suspects(belief.score, self.parameters.groups)
        # Openings do not add up: none makes a parameter less certain than twice its prior.
        room = np.where(changed, np.sqrt(np.clip(2.0 - now.diagonal() / prior.diagonal(), 0.0, 1.0)), 0.0)
        now += prior * np.outer(room, room)
        self.history.opened(room)
        self.history.settle(belief.x, belief.P)


def _covariance(sensor: Sensor, noise: Array) -> Array:
    """R (m, m) from a covariance or from standard deviations."""
    noise, m = np.asarray(noise, dtype=float), sensor.size
    if noise.shape == (m,):
        noise = np.diag(np.square(noise))
    sound = noise.shape == (m, m) and bool(np.all(np.isfinite(noise)))
    if sound:
        noise = 0.5 * (noise + noise.T)
        scale = np.sqrt(np.abs(noise.diagonal()))
        sound = bool(np.all((scale > 1e-9) & (scale < 1e9))) and bool(
            np.linalg.eigvalsh(noise / np.outer(scale, scale)).min() > 0.0
        )
    if not sound:
        raise FilterError(f"{sensor.name}: its noise is neither a positive covariance ({m}, {m}) nor {m} deviations")
    return noise
