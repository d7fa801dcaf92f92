"""Effects in a simulator: how a station puts them into its plant, and how it then drives the arm's motors.

    arm = add_arm(plant, spec, packages)
    fitted = add_to_plant(plant, arm)            # before Finalize: bodies, dampers, brakes, springs
    plant.Finalize()
    motors = connect(builder, plant, arm, fitted)
    builder.Connect(controller, motors.torque)   # (n) in the arm's order, whatever actuators the effects added

Brakes and springs are further actuators of the arm's model instances, so a station never connects an actuation or
desired-state port of those instances itself: `connect` does, and offers the motors alone. Controller gains of the
motors are set before `connect`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointActuatorIndex
from pydrake.systems.framework import (
    BasicVector,
    Context,
    DiagramBuilder,
    DiscreteValues,
    InputPort,
    LeafSystem,
    OutputPort,
)

from twin_diagram.description import Arm
from twin_diagram.effects.effect import Effect, make
from twin_diagram.effects.fitting import Fitting
from twin_diagram.scenario import EffectSpec

Array = npt.NDArray[np.float64]


def add_to_plant(
    plant: MultibodyPlant, arm: Arm, effects: Iterable[Effect | EffectSpec] | None = None
) -> tuple[Effect, ...]:
    """Realises effects in a discrete plant that is not finalized.

    Args:
        plant: holds the arm.
        arm: as `description.add_arm` gave it.
        effects: which; None: those that the description states and those of the arm's spec.

    Returns:
        The effects, for `connect`.
    """
    chosen = [*arm.given, *arm.spec.effects] if effects is None else effects
    made = tuple(make(effect) if isinstance(effect, EffectSpec) else effect for effect in chosen)
    for effect in made:
        effect.before_finalize(plant, arm)
    return made


def measured_position(effects: Sequence[Effect], joints: Sequence[str], q: Array) -> Array:
    """What the encoders read (…, n) at true positions `q`; stations pass their positions through it."""
    for effect in reversed(effects):
        q = effect.measured_position(joints, q)
    return q


@dataclass(frozen=True)
class Motors:
    """The ports by which a station drives its arm; all in the orders of `Arm.joints` and `Arm.gripper_joints`.

    Attributes:
        torque: (n) feed-forward torque, as it is logged [N·m]. May stay unconnected: zero.
        desired_state: (2n) positions as measured and velocities, for motors with controller gains. May stay unconnected
            where none has: zero.
        gripper_torque: (g), likewise [N].
        gripper_desired_state: (2g), likewise.
        torque_logged: (n) what the motors' log shows of the plant's last step: feed-forward and controller, without the
            effects' own actuators [N·m].
        gripper_torque_logged: (g).
    """

    torque: InputPort
    desired_state: InputPort
    gripper_torque: InputPort
    gripper_desired_state: InputPort
    torque_logged: OutputPort
    gripper_torque_logged: OutputPort


def connect(builder: DiagramBuilder, plant: MultibodyPlant, arm: Arm, effects: Sequence[Effect]) -> Motors:
    """Wires the actuators of the arm's model instances; call it once, after Finalize, with the plant in the builder."""
    for effect in effects:
        effect.after_finalize(plant, arm)
    model = plant.GetModelInstanceName(plant.get_joint(arm.joint_indices[0]).model_instance())
    drive = builder.AddNamedSystem(f"{model}_drive", Drive(plant, arm, effects))
    builder.Connect(plant.get_state_output_port(), drive.GetInputPort("state"))
    for instance in arm.instances:
        if plant.num_actuators(instance) > 0:
            name = plant.GetModelInstanceName(instance)
            builder.Connect(drive.GetOutputPort(f"actuation.{name}"), plant.get_actuation_input_port(instance))
            builder.Connect(drive.GetOutputPort(f"desired_state.{name}"), plant.get_desired_state_input_port(instance))
    return Motors(
        drive.GetInputPort("torque"),
        drive.GetInputPort("desired_state"),
        drive.GetInputPort("gripper_torque"),
        drive.GetInputPort("gripper_desired_state"),
        drive.GetOutputPort("torque_logged"),
        drive.GetOutputPort("gripper_torque_logged"),
    )


class Drive(LeafSystem):
    """Spreads motor commands over all the actuators of an arm's model instances, and says what the motors gave.

    The plant's own `net_actuation` does not tell the motor from a brake on the same joint (it reports the sum of all
    controlled actuators of a joint for each of them), so the motor's torque is worked out from the command that the
    last step saw and the state that it ended in, as the plant's implicit step does.

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
        super().__init__()
        fittings = {fitting.name: fitting for effect in effects for fitting in effect.fittings()}
        self._motors = _Actuators.of(plant, arm.actuator_indices, {})
        self._fingers = _Actuators.of(plant, arm.gripper_actuator_indices, {})
        self._effects = tuple(effects)
        self._joints = arm.joints
        n, g = len(self._motors.position), len(self._fingers.position)
        self._n = n
        self._commands = [
            self.DeclareVectorInputPort("torque", n),
            self.DeclareVectorInputPort("gripper_torque", g),
            self.DeclareVectorInputPort("desired_state", 2 * n),
            self.DeclareVectorInputPort("gripper_desired_state", 2 * g),
        ]
        self._state = self.DeclareVectorInputPort("state", plant.num_multibody_states())
        self.DeclareDiscreteState(3 * (n + g) + 1)  # the last step's command, and whether there was one
        self.DeclarePeriodicDiscreteUpdateEvent(plant.time_step(), 0.0, self._hold)

        own = [int(index) for index in (*arm.actuator_indices, *arm.gripper_actuator_indices)]
        command_tickets = {port.ticket() for port in self._commands}
        for instance in arm.instances:
            indices = plant.GetJointActuatorIndices(instance)
            if not indices:
                continue
            name = plant.GetModelInstanceName(instance)
            rows = [(k, own.index(int(index))) for k, index in enumerate(indices) if int(index) in own]
            others = _Actuators.of(plant, indices, fittings)
            curves = any(curve is not None for curve in others.curve)
            actuation_tickets = command_tickets | ({self._state.ticket()} if curves else set())
            self._declare_commands(name, np.array(rows, dtype=int).reshape(-1, 2).T, others, actuation_tickets)
        logged_tickets = {self._state.ticket(), self.xd_ticket()}
        self.DeclareVectorOutputPort("torque_logged", n, self._torque_logged, logged_tickets)
        self.DeclareVectorOutputPort("gripper_torque_logged", g, self._gripper_torque_logged, logged_tickets)

    def _declare_commands(
        self, name: str, rows: npt.NDArray[np.int64], others: _Actuators, actuation_tickets: set[Any]
    ) -> None:
        """Ports of one model instance: `rows` are its actuators that are motors or fingers, and which of these."""
        curves = [(k, p, c) for k, (p, c) in enumerate(zip(others.position, others.curve, strict=True)) if c]

        def actuation(context: Context, output: BasicVector) -> None:
            values = others.torque.copy()
            values[rows[0]] += self._command(context)[0, rows[1]]
            if curves:
                state = np.asarray(self._state.Eval(context))
                for k, position, curve in curves:
                    values[k] += curve(float(state[position]))
            output.SetFromVector(cast(Any, values))

        def desired_state(context: Context, output: BasicVector) -> None:
            command = self._command(context)
            values = np.stack([others.rest, np.zeros_like(others.rest)])
            values[:, rows[0]] = command[1:, rows[1]]
            output.SetFromVector(cast(Any, values.ravel()))

        count = len(others.rest)
        self.DeclareVectorOutputPort(f"actuation.{name}", count, actuation, actuation_tickets)
        tickets = {port.ticket() for port in self._commands}
        self.DeclareVectorOutputPort(f"desired_state.{name}", 2 * count, desired_state, tickets)

    def _command(self, context: Context) -> Array:
        """(3, n + g): torque, true position and velocity that are asked of motors and fingers."""
        torque, gripper_torque, desired, gripper_desired = (
            np.asarray(port.Eval(context)) if port.HasValue(context) else np.zeros(port.size())
            for port in self._commands
        )
        position = desired[: self._n]
        for effect in self._effects:
            position = effect.true_position(self._joints, position)
        g = len(gripper_torque)
        return np.array(
            [
                np.concatenate([torque, gripper_torque]),
                np.concatenate([position, gripper_desired[:g]]),
                np.concatenate([desired[self._n :], gripper_desired[g:]]),
            ]
        )

    def _hold(self, context: Context, values: DiscreteValues) -> None:
        held = np.append(self._command(context).ravel(), 1.0)
        values.set_value(cast(Any, held))

    def _log(self, context: Context, output: BasicVector, actuators: _Actuators, columns: slice) -> None:
        held = np.asarray(context.get_discrete_state_vector().value())
        if held[-1] > 0.0:
            command = held[:-1].reshape(3, -1)[:, columns]
            given = actuators.given(np.asarray(self._state.Eval(context)), command)
        else:
            given = np.zeros(len(actuators.rest))
        output.SetFromVector(cast(Any, given))

    def _torque_logged(self, context: Context, output: BasicVector) -> None:
        self._log(context, output, self._motors, slice(0, self._n))

    def _gripper_torque_logged(self, context: Context, output: BasicVector) -> None:
        self._log(context, output, self._fingers, slice(self._n, None))


@dataclass(frozen=True)
class _Actuators:
    """What is constant about some actuators of a plant, in one order."""

    position: npt.NDArray[np.int64]
    velocity: npt.NDArray[np.int64]
    stiffness: Array
    damping: Array
    limit: Array
    torque: Array
    rest: Array
    curve: list[Any]

    @staticmethod
    def of(plant: MultibodyPlant, indices: Sequence[JointActuatorIndex], fittings: dict[str, Fitting]) -> _Actuators:
        actuators = [plant.get_joint_actuator(index) for index in indices]
        none = Fitting("", "")
        extra = [fittings.get(actuator.name(), none) for actuator in actuators]
        gains = [actuator.get_controller_gains() if actuator.has_controller() else None for actuator in actuators]
        return _Actuators(
            position=np.array([actuator.joint().position_start() for actuator in actuators], dtype=int),
            velocity=np.array(
                [plant.num_positions() + actuator.joint().velocity_start() for actuator in actuators], dtype=int
            ),
            stiffness=np.array([gain.p if gain else 0.0 for gain in gains]),
            damping=np.array([gain.d if gain else 0.0 for gain in gains]),
            # The plant holds controlled actuators alone within their limit.
            limit=np.array([a.effort_limit() if a.has_controller() else np.inf for a in actuators]),
            torque=np.array([fitting.torque for fitting in extra]),
            rest=np.array([fitting.rest for fitting in extra]),
            curve=[fitting.curve for fitting in extra],
        )

    def given(self, state: Array, command: Array) -> Array:
        """The torque of a step with `command` (torque, position, velocity) that ended in `state`."""
        torque, position, velocity = command
        free = torque - self.stiffness * (state[self.position] - position)
        free -= self.damping * (state[self.velocity] - velocity)
        return np.clip(free, -self.limit, self.limit)
