"""The simulated arm's own driver: joint impedance about the commanded position, as scenario.Driver describes."""

from __future__ import annotations

from typing import Final

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Scenario
from twin_diagram.signals import Array
from twin_diagram.station.arm_plant import ArmPlant, select_joints
from twin_diagram.station.parsing import add_model, transform, weld_roots

BANDWIDTH: Final = 200.0
"""Of the filter through which commands go [rad/s]: it lags a steady motion by 2 / BANDWIDTH = 10 ms."""


def follow(q: Array, v: Array, command: Array, speed_limit: Array, dt: float) -> tuple[Array, Array]:
    """One exact step of the critically damped filter that smooths commands.

    With e = q − command, ë + 2 w ė + w² e = 0. A command farther away than 2·speed_limit/w counts as one at that distance,
    so that a jump is followed at the speed limit.

    Args:
        q, v: the filter's position and rate.
        command: where to go.
        speed_limit: greatest rate of a steady motion.
        dt: step [s].

    Returns:
        Position and rate after the step.
    """
    w = BANDWIDTH
    reach = 2.0 * speed_limit / w
    e = -np.clip(command - q, -reach, reach)
    target = q - e
    decay = np.exp(-w * dt)
    slope = v + w * e
    return target + decay * (e + slope * dt), decay * (v - w * slope * dt)


class NominalGravity:
    """Torques that hold the arm as the driver believes it to be: the twin's description without payload or effects."""

    def __init__(self, scenario: Scenario) -> None:
        """Loads ``twin.arm``.

        Raises:
            ScenarioError: its joints are not as many as the true arm's.
        """
        spec = scenario.twin.arm
        plant = MultibodyPlant(0.0)
        instances = add_model(plant, spec.model, scenario.packages)
        weld_roots(plant, instances, transform(spec.X_WB, "twin.arm.X_WB"))
        joints, _ = select_joints(plant, instances[0], spec, "twin.arm")
        plant.Finalize()
        self._plant = plant
        self._context = plant.CreateDefaultContext()  # scratch: positions are overwritten before each use
        self._q_index = np.array([joint.position_start() for joint in joints])
        self._v_index = np.array([joint.velocity_start() for joint in joints])
        self._q = plant.GetPositions(self._context).copy()

    def __len__(self) -> int:
        """Number of arm joints."""
        return len(self._q_index)

    def torque(self, q: Array) -> Array:
        """(n,) torques that hold the arm at (n,) joint angles `q`."""
        positions = self._q.copy()
        positions[self._q_index] = q
        self._plant.SetPositions(self._context, positions)
        return np.asarray(-self._plant.CalcGravityGeneralizedForces(self._context)[self._v_index])


class ArmDriver(LeafSystem):
    """Joint impedance: torque = stiffness (q_d − q) + damping (v_d − v) + gravity of the nominal arm + torque_commanded.

    .. pydrake_system::

        name: ArmDriver
        input_ports:
        - position_commanded
        - torque_commanded
        - gripper_commanded
        - motor_state
        output_ports:
        - desired_state
        - actuation
        - motor_torque

    The spring and the damper act in the plant, implicitly, so that they are stable at its step. A command goes through a
    critically damped filter (`follow`), whose position and rate are q_d and v_d: they lag a steady motion by 10 ms. Before the
    first command the arm holds its pose. An unconnected port and a vector with a NaN in it are no command; a
    torque that is not a number counts as zero.

    Ports: `position_commanded` (n) [rad], `torque_commanded` (n) [N·m], `gripper_commanded` (g) [m], `motor_state`
    (2(n + g)) true positions then speeds of the motors; `desired_state` (2a) and `actuation` (a) of the a actuators of the
    arm's model instance; `motor_torque` (n) that the arm's motors gave in the step that ends now [N·m], within their limits.
    State: filter (2(n + g)), then what the plant was told in the last step (3(n + g)). Rate: the plant's.
    """

    def __init__(self, plant: MultibodyPlant, arm: ArmPlant, gravity: NominalGravity, fingers0: Array) -> None:
        """Builds the driver of a finalized plant.

        Args:
            plant: the world's.
            arm: its arm.
            gravity: the driver's own model.
            fingers0: (g,) finger positions at the start [m].

        Raises:
            ScenarioError: the driver's model has another number of joints than the true arm.
        """
        super().__init__()
        n, g = len(arm.joints), len(arm.fingers)
        if len(gravity) != n:
            raise ScenarioError("twin.arm.model", f"has {len(gravity)} joints where world.arm has {n}")
        self._n, self._g, self._m = n, g, n + g
        self._gravity = gravity
        self._dt = plant.time_step()
        self._stiffness, self._damping = arm.stiffness, arm.damping
        self._limit = np.array([motor.effort_limit() for motor in arm.motors])
        speed = np.array([min(j.velocity_upper_limits()[0], -j.velocity_lower_limits()[0]) for j in (*arm.joints, *arm.fingers)])
        self._speed_limit = np.where(np.isfinite(speed) & (speed > 0), speed, 1e3)
        self._actuators = int(plant.num_actuators(arm.instance))
        starts = sorted(plant.get_joint_actuator(i).input_start() for i in plant.GetJointActuatorIndices(arm.instance))
        self._slots = np.array([starts.index(motor.input_start()) for motor in arm.motors])
        # Actuators that are no motors (effects) hold the position at which they were born and no speed.
        self._q = self.DeclareVectorInputPort("position_commanded", n)
        self._tau = self.DeclareVectorInputPort("torque_commanded", n)
        self._fingers = self.DeclareVectorInputPort("gripper_commanded", g) if g else None
        self._motor = self.DeclareVectorInputPort("motor_state", 2 * self._m)
        start = np.concatenate([arm.q0, fingers0])
        rest = np.zeros(self._m)
        state = self.DeclareDiscreteState(np.concatenate([start, rest, start, rest, rest]))
        self.DeclarePeriodicDiscreteUpdateEvent(self._dt, 0.0, self._update)
        self.DeclareVectorOutputPort(
            "desired_state", 2 * self._actuators, self._calc_desired, prerequisites_of_calc={self.discrete_state_ticket(state)}
        )
        self.DeclareVectorOutputPort(
            "actuation", self._actuators, self._calc_actuation, prerequisites_of_calc={self._tau.ticket(), self._motor.ticket()}
        )
        self.DeclareVectorOutputPort(
            "motor_torque",
            n,
            self._calc_motor_torque,
            prerequisites_of_calc={self.discrete_state_ticket(state), self._motor.ticket()},
        )

    def _command(self, context: Context, held: Array) -> Array:
        """Where to go (n + g); `held` where there is no command."""
        command = held.copy()
        if self._q.HasValue(context):
            q = self._q.Eval(context)
            if np.all(np.isfinite(q)):
                command[: self._n] = q
        if self._fingers is not None and self._fingers.HasValue(context):
            fingers = self._fingers.Eval(context)
            if np.all(np.isfinite(fingers)):
                command[self._n :] = fingers
        return command

    def _feedforward(self, context: Context) -> Array:
        """Gravity of the nominal arm and commanded torque (n + g)."""
        u = np.zeros(self._m)
        u[: self._n] = self._gravity.torque(self._motor.Eval(context)[: self._n])
        if self._tau.HasValue(context):
            u[: self._n] += np.nan_to_num(self._tau.Eval(context), nan=0.0, posinf=0.0, neginf=0.0)
        return u

    def _update(self, context: Context, discrete: DiscreteValues) -> None:
        x = context.get_discrete_state_vector().value()
        m = self._m
        q, v = x[:m], x[m : 2 * m]
        q_next, v_next = follow(q, v, self._command(context, q), self._speed_limit, self._dt)
        discrete.set_value(np.concatenate([q_next, v_next, q, v, self._feedforward(context)]))

    def _calc_desired(self, context: Context, output: BasicVector) -> None:
        x = context.get_discrete_state_vector().value()
        desired = np.zeros(2 * self._actuators)
        desired[self._slots] = x[: self._m]
        desired[self._actuators + self._slots] = x[self._m : 2 * self._m]
        output.SetFromVector(desired)

    def _calc_actuation(self, context: Context, output: BasicVector) -> None:
        actuation = np.zeros(self._actuators)
        actuation[self._slots] = self._feedforward(context)
        output.SetFromVector(actuation)

    def _calc_motor_torque(self, context: Context, output: BasicVector) -> None:
        # The plant's controllers are implicit: they act on the state at the end of the step, which is the state now.
        m = self._m
        q_d, v_d, u = context.get_discrete_state_vector().value()[2 * m :].reshape(3, m)
        now = self._motor.Eval(context)
        torque = self._stiffness * (q_d - now[:m]) + self._damping * (v_d - now[m:]) + u
        output.SetFromVector(np.clip(torque, -self._limit, self._limit)[: self._n])
