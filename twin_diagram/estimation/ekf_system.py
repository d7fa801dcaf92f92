"""The adaptive EKF as a LeafSystem: a thin shell around `Ekf`."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, EventStatus, InputPort

from twin_diagram.errors import ModelError
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.filter.arm_messages import TUNING as ARM_MESSAGES
from twin_diagram.estimation.filter.belief import HEADER, Belief, Entry, SensorTrack
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.filter.model_swap import hand_over
from twin_diagram.estimation.filter.sensor_registry import FilterError
from twin_diagram.estimation.sensors import BodyPose
from twin_diagram.estimation.sensors.from_scenario import make_sensor
from twin_diagram.model.model import Model
from twin_diagram.model.model_user import ModelUser
from twin_diagram.runtime.timing import timed
from twin_diagram.scenario import Filter
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import ALARM_SIZE, NEVER


class AdaptiveEkf(ModelUser[Ekf]):
    """Estimates the arm's state and the parameters that the model was not told of.

    .. pydrake_system::

        name: AdaptiveEkf
        input_ports:
        - position_measured
        - velocity_estimated
        - torque_measured
        - measurement_time
        - alarm
        output_ports:
        - arm_state
        - parameters
        - covariance
        - innovation
        - nis
        - message_time
        - sensor_tracks

    Rate: `Filter.rate`, a periodic discrete update that reads its inputs as they are before other updates of the same
    instant. Latency: `arm_state` none, it is carried on from the newest message to the present (by 20 ms at most,
    then it is held); the other outputs are as of the newest message's measurement time.

    Ports:
        position_measured: (n) joint positions [rad].
        velocity_estimated: (n) [rad/s].
        torque_measured: (n) motor torques, joint side [N·m].
        measurement_time: (1) of that message [s], negative (`NEVER`) before the first.
        alarm: (4) as a `DriftMonitor` gives it; may be left open.
        arm_state: (2n) x̂ = [q rad, v rad/s] at the present, `home` before the first message.
        parameters: (p) θ̂, see `Ekf.parameters`; for a payload its mass [kg] and first moment [kg·m] in the last link's
            frame.
        covariance: ((2n + p)²) of [q, v, θ], row by row.
        innovation: (n) of the velocities, as joint torque and whitened: about standard normal per joint.
        nis: (1) normalised innovation squared of positions and velocities, 2n on average.
        message_time: (1) when the newest message that could be used was measured [s], `NEVER` before the first.
        sensor_tracks: there with further sensors: of each in turn its record by `belief.SensorTrack`, then its mean
            whitened innovation.

    A message that is not newer than the last is not used again; NaN, infinities and absurd values are refused and
    counted. Nothing that arrives can spoil the state.

    For each of `Filter.sensors` there are further inputs: `<name>.reading` as the sensor has it, `<name>.time` (1) when
    it was taken [s], negative before the first, and for a pose `<name>.noise` (36), its R row by row, zeros for the
    sensor's own. A reading is used once, when its time has changed; what arrives late is fused at its own time.

    While an alarm stands the noise is not adapted, lest a fault be taken for noise, and a new one about the joints
    opens the parameters: see `Ekf.heed`.

    Which of its models a Context uses is a numeric parameter of that Context (0, the given one, at first): see
    `ModelUser`; what the filter knows is carried over to a corrected one, see `hand_over`.
    """

    def __init__(self, model: Model | ArmTerms, params: Filter, home: Array | None = None) -> None:
        """Declare ports and state.

        Args:
            model: the twin's model, or the terms of any arm.
            params: tuning.
            home: (n,) joint angles that are reported before the first message [rad]; zeros where None.
        """
        super().__init__()
        self._params = params
        self.ekf = self._filter(model)
        self._begin_with(self.ekf)
        ekf, n, p = self.ekf, self.ekf.terms.n, self.ekf.parameters.size
        declared = ekf.declared
        self._view = Belief(n, p, declared.own, declared.sizes)
        self._inputs = [
            self.DeclareVectorInputPort(name, size)
            for name, size in (
                ("position_measured", n),
                ("velocity_estimated", n),
                ("torque_measured", n),
                ("measurement_time", 1),
            )
        ]
        self._further: list[tuple[str, InputPort, InputPort, InputPort | None]] = []
        for name, sensor in declared.sensors.items():
            reading = self.DeclareVectorInputPort(f"{name}.reading", sensor.length)
            time = self.DeclareVectorInputPort(f"{name}.time", 1)
            pose = isinstance(sensor, BodyPose)
            noise = self.DeclareVectorInputPort(f"{name}.noise", sensor.size**2) if pose else None
            self._further.append((name, reading, time, noise))
        self._alarm = self.DeclareVectorInputPort("alarm", ALARM_SIZE)
        start = Belief(n, p, declared.own, declared.sizes)
        if home is not None:
            start.q[:] = home
        start.theta[:] = ekf.parameters.mean
        # Before the first message all is possible within the joints' speed limits and one turn.
        start.P[: 2 * n, : 2 * n] = np.diag(np.concatenate([np.full(n, np.pi**2), ekf.terms.velocity_limit**2]))
        start.P[3 * n : 3 * n + p, 3 * n : 3 * n + p] = ekf.parameters.covariance
        own = np.arange(3 * n + p, start.size)
        start.P[own, own] = declared.prior()
        state = self.DeclareDiscreteState(start.vector)
        if self._further:  # only then can anything arrive late
            self.DeclareDiscreteState(ekf.history.vector)
            self.DeclareDiscreteState(cast(Any, np.full(len(self._further), NEVER)))
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / params.rate, 0.0, self._update)
        for name, size, calc in (
            ("arm_state", 2 * n, self._calc_state),
            ("parameters", p, self._calc_parameters),
            ("covariance", (2 * n + p) ** 2, self._calc_covariance),
            ("innovation", n, self._calc_innovation),
            ("nis", 1, self._calc_nis),
            ("message_time", 1, self._calc_message_time),
        ):
            known = {self.discrete_state_ticket(state)} | ({self.time_ticket()} if name == "arm_state" else set())
            self.DeclareVectorOutputPort(name, size, calc, prerequisites_of_calc=known)
        if self._further:
            size, known = sum(len(track) for track in start.tracks), {self.discrete_state_ticket(state)}
            self.DeclareVectorOutputPort("sensor_tracks", size, self._calc_tracks, prerequisites_of_calc=known)

    @staticmethod
    def of_plant(
        plant: MultibodyPlant, joints: list[str], params: Filter, tool_frame: str | None = None
    ) -> AdaptiveEkf:
        """Return a filter for n joints of any finalized plant on a fixed base, without a `Model`.

        Args:
            plant: finalized; its other joints are held where its default positions have them.
            joints: names of the n joints, in order from the base.
            params: tuning.
            tool_frame: where a payload is expected; None: at the last link's origin.

        Raises:
            ModelError: see `ArmTerms`.
        """
        return AdaptiveEkf(ArmTerms(plant, joints, tool_frame=tool_frame), params)

    def belief(self, context: Context) -> Belief:
        """Return a copy of all that the filter knows, its counters included."""
        declared = self.ekf.declared
        belief = Belief(self._view.n, self._view.p, declared.own, declared.sizes)
        belief.vector[:] = context.get_discrete_state(0).value()
        return belief

    def counters(self, context: Context) -> dict[str, int]:
        """Return how many messages were accepted, refused and so on: see `belief.Entry`."""
        header = context.get_discrete_state(0).value()[:HEADER]
        return {entry.name.lower(): int(header[entry]) for entry in Entry if entry >= Entry.ACCEPTED}

    def recount(self, context: Context, change: Array) -> None:
        """Count angles anew: all positions are others by `change` (n,) [rad] from now on, in this system's Context."""
        ekf = self._in_use(context)
        ekf.load(cast(Array, context.get_discrete_state(0).value()))
        if not ekf.belief.valid:
            return
        ekf.belief.q[:] += change
        ekf.load(ekf.belief.vector.copy())  # what is late now was measured before
        context.SetDiscreteState(0, ekf.belief.vector)
        if self._further:
            context.SetDiscreteState(1, ekf.history.vector)

    def _hand_over(self, context: Context, made: Ekf) -> None:
        hand_over(self.belief(context), made)
        context.SetDiscreteState(0, made.belief.vector)
        if self._further:
            context.SetDiscreteState(1, made.history.vector)

    def _make(self, model: Model | ArmTerms) -> Ekf:
        ekf = self._filter(model)
        if ekf.terms.n != self.ekf.terms.n:
            raise ModelError(f"the corrected model has {ekf.terms.n} joints where the filter has {self.ekf.terms.n}")
        return ekf

    def _filter(self, model: Model | ArmTerms) -> Ekf:
        ekf = Ekf(model, self._params)
        for spec in self._params.sensors:
            ekf.add(make_sensor(ekf.terms, spec))
        ekf.history.whole = bool(self._params.sensors)  # only then can anything arrive late
        return ekf

    @timed("AdaptiveEkf")
    def _update(self, context: Context, discrete: DiscreteValues) -> EventStatus:
        q, v, tau, t = (cast(Array, port.Eval(context)) for port in self._inputs)
        ekf = self._in_use(context)
        before = cast(Array, context.get_discrete_state(0).value())
        ekf.load(before, cast(Array, context.get_discrete_state(1).value()) if self._further else None)
        if self._alarm.HasValue(context):
            ekf.heed(cast(Array, self._alarm.Eval(context)))
        ekf.observe(q, v, tau, float(t[0]))
        if self._further:
            discrete.set_value(2, cast(Any, self._read_further(context, ekf)))
            discrete.set_value(1, ekf.history.vector)
        discrete.set_value(0, ekf.belief.vector)
        return EventStatus.Succeeded()

    def _read_further(self, context: Context, ekf: Ekf) -> Array:
        """Take in what is new of the further sensors; (k,) times of the readings seen."""
        seen = np.array(context.get_discrete_state(2).value())
        for index, (name, reading, time, noise) in enumerate(self._further):
            t = float(cast(Array, time.Eval(context))[0])
            if not np.isfinite(t) or t < 0.0 or t == seen[index] or not ekf.belief.valid:
                continue
            seen[index] = t
            sensor = ekf.declared.sensors[name]
            R = None if noise is None else cast(Array, noise.Eval(context)).reshape(sensor.size, sensor.size)
            track = ekf.declared.track(ekf.belief, sensor)
            assert track is not None
            stale = float(track[SensorTrack.STALE])
            try:
                ahead = t - ekf.belief.time
                if ahead > ARM_MESSAGES.longest_gap:
                    raise FilterError(f"{sensor.name}: a reading of the future")
                ekf.update(sensor, cast(Array, reading.Eval(context)), t, None if R is None or not np.any(R) else R)
            except (FilterError, np.linalg.LinAlgError):
                track[SensorTrack.INVALID] += track[SensorTrack.STALE] == stale  # what came too late is counted as that
        return seen

    def _of(self, context: Context) -> Belief:
        self._view.vector[:] = context.get_discrete_state(0).value()
        return self._view

    def _calc_state(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(cast(Any, self._of(context).state_at(context.get_time())))

    def _calc_parameters(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._of(context).theta)

    def _calc_covariance(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(cast(Any, self._of(context).outside_covariance().ravel()))

    def _calc_innovation(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._of(context).innovation)

    def _calc_nis(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._of(context).header[Entry.NIS : Entry.NIS + 1])

    def _calc_message_time(self, context: Context, output: BasicVector) -> None:
        output[0] = float(self._of(context).header[Entry.MESSAGE])

    def _calc_tracks(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(np.concatenate(self._of(context).tracks))
