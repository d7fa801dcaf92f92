"""The adaptive extended Kalman filter, usable without any Diagram.

    ekf = Ekf(ArmTerms.from_model(model), scenario.Filter())
    ekf.observe(q, v, tau, t)                  # a whole message of the arm, or by hand:
    ekf.predict(tau, dt)
    ekf.update("encoder", q)
    ekf.add(BodyPose(ekf.terms, "panda_hand"))
    ekf.update("camera", z, t)                 # fused at t, though newer readings came first

`Ekf.observe` sorts a message out; `Ekf._cycle` is what it then goes through, from top to bottom. The parts are
functions of the modules beside this one; none of them calls back.

It follows the predict and update cycle of Hybrid Reality Twins (section 3.2, algorithm A-EKF, steps 1, 2 and 4).
State and parameters are estimated together; where the outline adapts θ by a gradient, here the joint covariance
adapts it, which weighs every reading by what it tells about θ. `standings` says which parameters are answers.

**What the motion does not excite stays as it was**: see `disturbance`. A direction of θ that no torque depends on is
never touched either, its gain being zero.

**A surprise is not an outlier.** Where a reading leaves its χ² gate, the filter asks whether an unmodelled torque
within the joints' effort limits explains it. If so, the sensors are right and the model is not: the state follows
them, with a covariance that says so, and θ hardly moves. If not, the reading is refused. Where surprises persist, the
parameters themselves must have changed, and their covariance opens. A parameter that readings have pulled far from what
its prior says, a motor that is no data sheet's, refutes the prior: see `parameter_adaptation.refute`.

**Two time scales.** The state moves with every reading. The physics takes over the parameters learnt at
`Filter.parameter_rate`, and at once where that is much; in between, what has been learnt acts through the derivatives,
so nothing of it is lost.

**Late readings** are fused at their own time: see `delayed_measurements`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin_diagram.errors import expect
from twin_diagram.estimation.filter.arm_messages import TUNING as ARM_MESSAGES
from twin_diagram.estimation.filter.arm_messages import (
    Course,
    count,
    course_of,
    follows,
    heard,
    keep_record,
    sized,
    start,
    within_own_gate,
)
from twin_diagram.estimation.filter.base import Core
from twin_diagram.estimation.filter.belief import HEADER, Entry, SensorTrack
from twin_diagram.estimation.filter.belief import TUNING as BELIEF
from twin_diagram.estimation.filter.fault_isolation import alarming
from twin_diagram.estimation.filter.noise_adaptation import adapt, noise_now
from twin_diagram.estimation.filter.outlier_streaks import gather, take_for_noise
from twin_diagram.estimation.filter.parameter_adaptation import open_again, open_up, refute
from twin_diagram.estimation.filter.parameter_status import Standing, standings
from twin_diagram.estimation.filter.predict import TUNING as PREDICT
from twin_diagram.estimation.filter.predict import propagate
from twin_diagram.estimation.filter.sensor_registry import FilterError
from twin_diagram.estimation.filter.update import TUNING as UPDATE
from twin_diagram.estimation.filter.update import Update, absorb, fuse, gate, take
from twin_diagram.estimation.sensors import Sensor
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import AlarmKind

__all__ = ["Ekf", "FilterError", "Update"]


class Ekf(Core):
    """An adaptive EKF of n joints and p parameters: what users call. Its attributes are those of `Core`."""

    def add(self, sensor: Sensor) -> None:
        """Declare a further sensor; readings may then name it. What the filter knows already is kept.

        Raises:
            FilterError: a sensor of that name is there already.
        """
        expect(sensor, Sensor, "sensor", "a Sensor (of twin_diagram.estimation.sensors, or a subclass)")
        if sensor.name in self.own:
            raise FilterError(f"a sensor {sensor.name!r} is declared already: give each a name of its own")
        before, start = self.belief, 3 * self.terms.n + self.parameters.size
        payload = self.parameters.payload
        at = None if payload is None else slice(3 * self.terms.n + payload.start, 3 * self.terms.n + payload.stop)
        self.declared.add(sensor, start, at)
        self.resize()
        after = self.belief
        same = HEADER + BELIEF.memory * before.n + before.p * (before.p + 4)
        after.vector[:same] = before.vector[:same]
        after.x[: before.size] = before.x
        after.P[: before.size, : before.size] = before.P
        new = np.arange(before.size, after.size)
        after.P[new, new] = self.declared.prior()[before.size - start :]
        for old, track in zip([*before.tracks, *before.levels], [*after.tracks[:-1], *after.levels[:-1]], strict=True):
            track[:] = old
        if after.valid:
            self.history.begin(after.time, after.x, after.P)

    # What the filter knows.

    def labels(self, joints: Sequence[str]) -> list[str]:
        """Return the names with units of the parameters (p,) and of the sensors' own states, as they follow in x."""
        return self.parameters.labels(joints) + self.declared.labels()

    def noise(self) -> dict[str, Array]:
        """Return the deviations as adapted, over those that were given, of each sensor (N,) and of `torque`."""
        encoder, velocity, torque = np.exp(0.5 * self.belief.noise)
        found = {"encoder": encoder, "velocity": velocity, "torque": torque}
        for name, level in zip(self.declared.sensors, self.belief.levels, strict=True):
            found[name] = np.exp(0.5 * level)
        return found

    def standings(self, joints: Sequence[str]) -> list[Standing]:
        """Return how each parameter stands: settled, not excited by the motion, held at a bound, in doubt.

        Nothing is settled while an alarm stands that the filter was told of (`heed`).

        Args:
            joints: names of the n joints, for the labels.
        """
        belief, start = self.belief, 3 * self.terms.n
        if not belief.valid:
            return standings(self.parameters, self.parameters.mean, self.parameters.covariance, joints)
        covariance = belief.P[start : start + belief.p, start : start + belief.p]
        alarm = bool(belief.header[Entry.ALARM] > belief.time)
        return standings(
            self.parameters, belief.theta, covariance, joints, self.params.rule, alarm=alarm, freed=belief.freed
        )

    def hold_noise(self, until: float) -> None:
        """Hold the noise as it is until this time [s], since an alarm stands."""
        header = self.belief.header
        header[Entry.ALARM] = max(header[Entry.ALARM], until)

    def heed(self, alarm: Array) -> None:
        """Heed what a drift monitor says: call it before each message, with the monitor's word so far.

        While an alarm stands the noise is not adapted. A new one about the joints is a change of the arm: the
        parameters that recent innovations speak for open, so that they are learnt faster.

        Args:
            alarm: (4,) of a monitor: whether one stands, its `AlarmKind`, when it was raised [s], its statistic.
        """
        belief, header = self.belief, self.belief.header
        if not belief.valid:
            return
        if alarm[0] > 0.5:
            self.hold_noise(belief.time + 2.0 * self.period)
        # An alarm of the future is one from before a clock was set back.
        if not header[Entry.HEEDED] < alarm[2] <= belief.time or alarm[1] in (AlarmKind.NONE, AlarmKind.SENSOR):
            return
        header[Entry.HEEDED] = alarm[2]
        if belief.time >= header[Entry.QUIET]:
            open_up(self, belief.time)

    def suspicion(self) -> dict[str, float]:
        """Return how strongly each further sensor contradicts the rest: above 1 it does. See `Declared.suspicion`."""
        return self.declared.suspicion(self.belief)

    def odd_one_out(self) -> str | None:
        """Return the sensor that contradicts the others, `joints` for the arm's own; None where all agree."""
        return self.declared.odd_one_out(self.belief)

    def counters(self) -> dict[str, dict[str, int]]:
        """Count of each further sensor how many readings were accepted, refused and so on: see `belief.SensorTrack`."""
        counts = [entry for entry in SensorTrack if SensorTrack.ACCEPTED <= entry < SensorTrack.RUN]
        return {
            name: {entry.name.lower(): int(track[entry]) for entry in counts}
            for name, track in zip(self.declared.sensors, self.belief.tracks, strict=True)
        }

    def start(self, q: Array, v: Array, tau: Array, t: float) -> None:
        """Take the state from a message; θ, its covariance and the counters are kept, at the first set to the prior.

        Args:
            q: (n,) [rad].
            v: (n,) [rad/s].
            tau: (n,) [N·m].
            t: [s].
        """
        start(self, q, v, tau, t)

    # The cycle.

    def predict(self, u: Array, dt: float, torque_std: Array | float | None = None) -> None:
        """Move the belief on by dt under the motors' torque.

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
        if dt > PREDICT.longest_prediction:
            raise FilterError(f"a prediction over {dt} s is no prediction: start the filter anew from a message")
        propagate(self, u, dt, self.params.torque_std if torque_std is None else torque_std)

    def update(
        self,
        sensor: Sensor | str,
        z: Array,
        t: float | None = None,
        noise: Array | None = None,
        *,
        explain: bool = True,
    ) -> Update:
        """Take in a reading.

        Args:
            sensor: its name, or its model; `encoder`, `velocity` and `joints` are there, others are declared by `add`.
            z: (sensor.length,).
            t: when it was taken [s]; None: now. A later time is first predicted to, with the last torque; at an earlier
                one the reading is fused where it belongs, to the nearest step within `Filter.history`.
            noise: R (m, m) of this reading, or standard deviations (m,); None: the sensor's own.
            explain: whether an unmodelled torque may explain a reading that leaves its gate.

        Raises:
            FilterError: a sensor that was not declared, z or noise has the wrong size, t is not finite, lies before all
                that the filter remembers or too far ahead, or there is no state yet.
        """
        return fuse(self, self.find(sensor), z, t, noise, explain)

    def observe(self, q: Array, v: Array, tau: Array, t: float) -> bool:
        """Take in one message of the arm, whatever it holds; the belief is never poisoned.

        Args:
            q: (n,) measured positions [rad].
            v: (n,) estimated velocities [rad/s].
            tau: (n,) measured motor torques [N·m].
            t: measurement time [s]; `NEVER` or any negative, stale or non-finite time means that there is no message.

        Returns:
            Whether the message was used.

        Raises:
            FilterError: q, v or τ are not n numbers, whatever their values.
        """
        q, v, tau = (sized(self.terms.n, name, value) for name, value in (("q", q), ("v", v), ("torque", tau)))
        known = heard(tau, self.terms.effort_limit)
        course = course_of(self, q, v, t, known)
        count(self.belief, course, known)
        if course is Course.LATE:
            return self._late(q, v, tau, t, known)
        if course not in (Course.FIRST, Course.RESTART, Course.NEXT):
            return False
        if not known:
            tau = self.belief.torque
        if course is not Course.NEXT:
            self.start(q, v, tau, t)
            return True
        kept = self.belief.vector.copy()
        try:
            with np.errstate(all="ignore"):
                self._cycle(q, v, tau, t, known)
            sound = self.belief.sound(2.0 * ARM_MESSAGES.absurd)
        except (np.linalg.LinAlgError, FilterError):
            sound = False
        if not sound:
            # The model ran away, as it may under absurd torques: parameters as before, state from the sensors.
            self.belief.vector[:] = kept
            self.belief.header[Entry.RESTARTS] += 1
            self.start(q, v, tau, t)
        return True

    def _late(self, q: Array, v: Array, tau: Array, t: float, heard: bool) -> bool:
        """Fuse a message at its own time, which lies before the state's; return whether it was used.

        Args:
            q: (n,) [rad].
            v: (n,) [rad/s].
            tau: (n,) [N·m].
            t: [s].
            heard: whether the torques are the message's own.
        """
        belief, header = self.belief, self.belief.header
        newest, before = follows(belief, t), float(header[Entry.MESSAGE])
        try:
            whole = fuse(self, self.joints, np.concatenate([q, v]), t)
        except FilterError:  # it was left out
            header[Entry.INVALID] += 1
            return False
        if newest:
            # All is as it should be with it: it is the state that another sensor took ahead.
            header[Entry.MESSAGE] = t
            self.step_mass = self._mass()
            keep_record(self, whole, t - before, trusted=False)
            if whole.accepted:
                header[Entry.HEARD] = t
            if heard:
                belief.torque[:] = tau
        return whole.accepted

    def _cycle(self, q: Array, v: Array, tau: Array, t: float, heard: bool) -> None:
        """Take in the next message: predict, gate, update, adapt, learn.

        Args:
            q: (n,) [rad].
            v: (n,) [rad/s].
            tau: (n,) [N·m].
            t: [s].
            heard: whether the torques are the message's own.
        """
        belief, header, dt = self.belief, self.belief.header, t - self.belief.time
        # Predict. The first torque after a start may be a placeholder, so that of the first step is as good as unknown.
        trusted = heard and header[Entry.FRESH] == 0.0
        header[Entry.FRESH] = 0.0
        torque_std = self.params.torque_std if trusted else self.terms.effort_limit
        propagate(self, 0.5 * (belief.torque + tau), dt, torque_std)
        header[[Entry.TIME, Entry.MESSAGE]], belief.torque[:] = t, tau
        self.history.retime(t)
        # Gate.
        at = self.linear(self.joints, belief.x, belief.P, 0)
        R = noise_now(self, self.joints, None, at, None)
        gated = gate(self, self.joints, np.concatenate([q, v]), at, R, explain=True)
        whole = gated.result
        # Update.
        if whole.accepted:
            absorb(self, gated)
        # Adapt the noise. Where the message as a whole was refused, half of it may do.
        adapt(self, self.joints, None, at, None, whole, t)
        if whole.accepted:
            header[Entry.HEARD] = t
        elif half := within_own_gate(self, whole, q, v):
            take(self, *half, None, None, False)
        keep_record(self, whole, dt, trusted)
        gather(belief, whole.innovation, whole.surprise or not whole.accepted)
        if header[Entry.GATHERED] >= UPDATE.refusals and header[Entry.CALM] == 0.0:
            # Where it is no noise, ten refusals make the next message begin anew.
            if take_for_noise(belief, self.params, whole.covariance.diagonal()):
                self.history.begin(t, belief.x, belief.P)
        # Learn. The update moved θ already; what it cannot hold any more is opened, or given up.
        if t < header[Entry.QUIET]:
            return
        open_again(self)
        if header[Entry.NIS_MEAN] > self.params.opening or (
            header[Entry.STREAK] == 0.0 and alarming(belief.score, self.parameters.groups)
        ):
            open_up(self, t)
        else:
            refute(self, t)
