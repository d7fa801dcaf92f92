"""Drives an arm's motors, with what effects make of their torque, and the actuators that effects add."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from pydrake.common.value import AbstractValue
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.framework import BasicVector, CacheEntry, Context, DiscreteValues, LeafSystem, ValueProducer

from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.effects.actuation import Gain, TimeDelay, TorqueSaturation
from twin_diagram.model.effects.effect import Effect
from twin_diagram.model.effects.sensing import EncoderOffset
from twin_diagram.model.effects.simulated.actuators import Actuators
from twin_diagram.model.effects.simulated.brakes import Brakes
from twin_diagram.model.effects.simulated.delay_line import Line
from twin_diagram.model.effects.simulated.realisation import Realisation, realisations, realises
from twin_diagram.signals.arrays import Array


@realises(TimeDelay, EncoderOffset)
class WorkedOutByTheDrive(Realisation[Effect]):
    """What `Drive` and `measured_position` make of torques and readings, from a run's begin to its end."""

    changes_plant = True


class Drive(LeafSystem):
    """Spreads motor commands over all the actuators of an arm's model instances, and says what the motors gave.

    The plant's own `net_actuation` does not tell the motor from a brake on the same joint (it reports the sum of all
    controlled actuators of a joint for each of them), so the motor's torque is worked out from the command that the
    last step saw and the state that it ended in, as the plant's implicit step does.

    What a motor logs and what reaches its joint differ by the effects on its torque:

    - a gain or a bound that is always there is put into the motor's own gains and limit (implicit, at any step);
    - one that starts or ends is added as the difference that it made to the last step's torque, and the log is what
      the law makes of the sum;
    - where the torque waits, the motors' controllers are worked out here, explicitly, as they would be far away.

    Units N·m, rad, rad/s (N, m, m/s for prismatic joints). The commands pass without delay; `torque_logged` is that of
    the plant's last step, zero before the first. Commands may stay unconnected (zero).

    .. pydrake_system::

        name: Drive
        input_ports:
        - torque
        - desired_state
        - gripper_torque
        - gripper_desired_state
        - state
        output_ports:
        - actuation.<model instance>
        - desired_state.<model instance>
        - torque_logged
        - gripper_torque_logged
    """

    def __init__(self, plant: MultibodyPlant, arm: Arm, effects: Sequence[Effect]) -> None:
        """Build it for a finalized plant, whose motors' gains and limits it may change."""
        super().__init__()
        self._motors = Actuators.of(plant, arm.actuator_indices)
        self._fingers = Actuators.of(plant, arm.gripper_actuator_indices)
        self._effects = tuple(effects)
        self._joints = arm.joints
        n, g = len(self._motors.position), len(self._fingers.position)
        self._n = n
        self._step = plant.time_step()
        steady = [e for e in effects if isinstance(e, (Gain, TorqueSaturation)) and not e.when.timed]
        self._changing = [e for e in effects if isinstance(e, (Gain, TorqueSaturation)) and e.when.timed]
        self._scale: Array = np.ones(n)
        self._cap: Array = np.full(n, np.inf)
        for effect in steady:
            if isinstance(effect, Gain):
                self._scale, self._cap = effect.applied(arm.joints, self._scale), effect.applied(arm.joints, self._cap)
            elif isinstance(effect, TorqueSaturation):
                self._cap = np.minimum(self._cap, effect.limits(arm.joints))
        delay = sum(effect.delay for effect in effects)
        self._line = Line(delay / self._step, n) if delay > 0.0 else None
        self._set_motors(plant, arm)
        self._bare = np.flatnonzero(~np.isfinite(self._motors.limit))  # the plant bounds controlled motors alone
        realised = realisations(effects)
        self._brakes = Brakes(plant, arm, realised)

        self._commands = [
            self.DeclareVectorInputPort("torque", n),
            self.DeclareVectorInputPort("gripper_torque", g),
            self.DeclareVectorInputPort("desired_state", 2 * n),
            self.DeclareVectorInputPort("gripper_desired_state", 2 * g),
        ]
        self._state = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        # The last step's command, and whether there was one; then what was added to the motors' torque in it, what the
        # brakes hold with, and the torque that waits.
        sizes = (3 * (n + g) + 1, n, self._brakes.count, self._line.size if self._line else 0)
        self._parts = np.cumsum([0, *sizes])
        self.DeclareDiscreteState(int(self._parts[-1]))
        self.DeclarePeriodicDiscreteUpdateEvent(plant.time_step(), 0.0, self._hold)

        own = [int(index) for index in (*arm.actuator_indices, *arm.gripper_actuator_indices)]
        tickets = {port.ticket() for port in self._commands}
        # Every port and the step read these, so each is worked out once a step.
        self._command_now = self._declare_array("command", (3, n + g), self._command, tickets)
        of = {self._state.ticket(), self.xd_ticket(), self.time_ticket()} if self._line or self._changing else set()
        of.add(self._command_now.ticket())
        self._motor_torque_now = self._declare_array("motor torque", (n + g,), self._motor_torque, of)
        for instance in arm.instances:
            indices = plant.GetJointActuatorIndices(instance)
            if not indices:
                continue
            name = plant.GetModelInstanceName(instance)
            rows = [(k, own.index(int(index))) for k, index in enumerate(indices) if int(index) in own]
            others = Actuators.of(plant, indices, realised)
            brakes = self._brakes.rows([plant.get_joint_actuator(index).name() for index in indices])
            self._declare_commands(name, np.array(rows, dtype=int).reshape(-1, 2).T, others, brakes, tickets)
        logged_tickets = {self._state.ticket(), self.xd_ticket()}
        self.DeclareVectorOutputPort("torque_logged", n, self._torque_logged, logged_tickets)
        self.DeclareVectorOutputPort("gripper_torque_logged", g, self._gripper_torque_logged, logged_tickets)

    def _declare_array(
        self, name: str, shape: tuple[int, ...], calc: Callable[[Context], Array], tickets: set[Any]
    ) -> CacheEntry:
        """Declare an array that is worked out again only when what it comes from changed."""

        def store(context: Context, value: AbstractValue) -> None:
            value.get_mutable_value()[:] = calc(context)

        producer = ValueProducer(allocate=lambda: AbstractValue.Make(np.zeros(shape)), calc=store)
        return self.DeclareCacheEntry(name, producer, tickets)

    def _set_motors(self, plant: MultibodyPlant, arm: Arm) -> None:
        """Put what is always there into the motors' own gains and limits."""
        for k, index in enumerate(arm.actuator_indices):
            motor = plant.get_joint_actuator(index)
            if self._line is not None:
                motor.set_controller_gains(PdControllerGains(p=0.0, d=0.0))
            elif motor.has_controller():
                scale = float(self._scale[k])
                gains = motor.get_controller_gains()
                motor.set_effort_limit(max(min(float(self._cap[k]), scale * motor.effort_limit()), 1e-12))
                motor.set_controller_gains(PdControllerGains(p=scale * gains.p, d=scale * gains.d))

    def _declare_commands(
        self,
        name: str,
        rows: npt.NDArray[np.int64],
        others: Actuators,
        brakes: list[tuple[int, int]],
        tickets: set[Any],
    ) -> None:
        """Ports of one model instance: `rows` are its actuators that are motors or fingers, and which of these."""
        changes = bool(self._changing or self._line or brakes)
        follows = changes or any(law is not None for law in others.law)
        passing = any(effect is not None and effect.when.timed for effect in others.effect)
        more = {self._state.ticket()} if follows else set()
        together, resting = others.together(), np.stack([others.rest, np.zeros_like(others.rest)])
        more |= {self.xd_ticket(), self.time_ticket()} if changes or passing else set()

        def actuation(context: Context, output: BasicVector) -> None:
            state = np.asarray(self._state.Eval(context)) if follows else np.zeros(0)
            values = others.pushes(state, context.get_time())
            values[rows[0]] += self._motor_torque_now.Eval(context)[rows[1]]
            if brakes:
                friction = self._brakes.torque(state, self._part(context, 2), self._given(context), context.get_time())
                for k, brake in brakes:
                    values[k] += friction[brake]
            output.SetFromVector(cast(Any, together @ values))

        def desired_state(context: Context, output: BasicVector) -> None:
            command = self._command_now.Eval(context)
            values = resting.copy()
            values[:, rows[0]] = command[1:, rows[1]]
            output.SetFromVector(cast(Any, values.ravel()))

        count = len(others.rest)
        self.DeclareVectorOutputPort(f"actuation.{name}", count, actuation, tickets | more)
        self.DeclareVectorOutputPort(f"desired_state.{name}", 2 * count, desired_state, tickets)

    def _command(self, context: Context) -> Array:
        """Return (3, n + g): torque, true position and velocity that are asked of motors and fingers."""
        torque, gripper_torque, desired, gripper_desired = (
            np.asarray(port.Eval(context)) if port.HasValue(context) else np.zeros(port.size())
            for port in self._commands
        )
        position = desired[: self._n]
        for effect in self._effects:
            position = effect.true_position(self._joints, position)
        n, g = self._n, len(gripper_torque)
        command = np.empty((3, n + g))
        command[0, :n], command[0, n:] = torque, gripper_torque
        command[1, :n], command[1, n:] = position, gripper_desired[:g]
        command[2, :n], command[2, n:] = desired[n:], gripper_desired[g:]
        return command

    def _part(self, context: Context, which: int) -> Array:
        whole = np.asarray(context.get_discrete_state_vector().value())
        return whole[self._parts[which] : self._parts[which + 1]]

    def _motor_torque(self, context: Context) -> Array:
        """Return (n + g,) what is put into the motors' actuation ports.

        Beside which their controllers in the plant work.
        """
        command = self._command_now.Eval(context)
        torque = command[0].copy()
        motors = torque[: self._n]
        if self._line is not None:
            motors[:] = self._reaching(self._line.end(self._part(context, 3), self._asked(context, command)))
        else:
            motors *= self._scale
            bare = self._bare
            if len(bare):
                motors[bare] = np.clip(motors[bare], -self._cap[bare], self._cap[bare])
        motors += self._change(context)
        return torque

    def _asked(self, context: Context, command: Array) -> Array:
        """Return (n,) what the motors' controllers ask for now, worked out here."""
        return self._motors.given(np.asarray(self._state.Eval(context)), command[:, : self._n])

    def _reaching(self, torque: Array) -> Array:
        """Return what is left of it by gains and bounds that are always there."""
        return np.clip(torque * self._scale, -self._cap, self._cap)

    def _given(self, context: Context) -> Array:
        """Return (n,) what the motors gave in the last step, by gains and bounds that are always there alone."""
        if self._line is not None:
            return self._reaching(self._line.last(self._part(context, 3)))
        return self._reaching(self._asked_last(context, self._motors, slice(0, self._n)))

    def _change(self, context: Context) -> Array:
        """Return (n,) what effects that start or end change in the motors' torque, by the last step's."""
        if not self._changing:
            return np.zeros(self._n)
        before = after = self._given(context)
        for effect in self._changing:
            if effect.when.active(np.array(context.get_time())):
                after = effect.applied(self._joints, after)
        return after - before

    def _hold(self, context: Context, values: DiscreteValues) -> None:
        command = self._command_now.Eval(context)
        state = np.asarray(self._state.Eval(context))
        held = [command.ravel(), [1.0], self._change(context)]
        if self._brakes.count:
            held.append(self._brakes.held(state, self._part(context, 2), self._given(context), context.get_time()))
        if self._line is not None:
            held.append(self._line.moved(self._part(context, 3), self._asked(context, command)))
        values.set_value(cast(Any, np.concatenate(held)))

    def _asked_last(self, context: Context, actuators: Actuators, columns: slice) -> Array:
        held = self._part(context, 0)
        if held[-1] == 0.0:
            return np.zeros(len(actuators.rest))
        return actuators.given(np.asarray(self._state.Eval(context)), held[:-1].reshape(3, -1)[:, columns])

    def _torque_logged(self, context: Context, output: BasicVector) -> None:
        if self._line is not None:
            logged = self._line.newest(self._part(context, 3))
        else:
            logged = self._asked_last(context, self._motors, slice(0, self._n))
        if self._changing:
            # The sum that reached the joints, as the laws read it: where they forget, the motor's own torque stands.
            since = np.array(context.get_time() - 0.5 * self._step)
            acting = [effect for effect in self._changing if effect.when.active(since)]
            if acting and not any(effect.loses for effect in acting):
                total = self._reaching(logged) + self._part(context, 1)
                for effect in reversed(acting):
                    total = effect.logged(self._joints, total)
                logged = total / self._scale
        output.SetFromVector(cast(Any, logged))

    def _gripper_torque_logged(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(cast(Any, self._asked_last(context, self._fingers, slice(self._n, None))))
