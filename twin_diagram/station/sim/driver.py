"""The simulated arm's own driver: joint impedance about the commanded position, as scenario.Driver describes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.station.add_models import twin_arm
from twin_diagram.station.sim.arm_plant import ArmPlant
from twin_diagram.station.sim.linkage import levers


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    bandwidth: float = 200.0
    """Of the filter through which commands go [rad/s]: it lags a steady motion by 2 / bandwidth = 10 ms."""

    meeting: float = 0.002
    """Fingers told to be so near to where they meet are told to press, the nearer the more [m]: no jump of force."""


TUNING = Tuning()


def follow(q: Array, v: Array, command: Array, speed_limit: Array, dt: float) -> tuple[Array, Array]:
    """Return one exact step of the critically damped filter that smooths commands.

    With e = q − command, ë + 2 w ė + w² e = 0. A command farther away than 2·speed_limit/w counts as one at that
    distance, so that a jump is followed at the speed limit.

    Args:
        q: the filter's position.
        v: its rate.
        command: where to go.
        speed_limit: greatest rate of a steady motion.
        dt: step [s].

    Returns:
        Position and rate after the step.
    """
    w = TUNING.bandwidth
    reach = 2.0 * speed_limit / w
    e = -np.minimum(np.maximum(command - q, -reach), reach)
    target = q - e
    decay = np.exp(-w * dt)
    slope = v + w * e
    return target + decay * (e + slope * dt), decay * (v - w * slope * dt)


def held_back(desired: Array, position: Array, reach: Array) -> Array:
    """Return fingers' desired state with springs wound up by no more than `reach`.

    Args:
        desired: (2g,) positions, then speeds.
        position: (g,) measured.
        reach: (g,) least that a spring is to be wound up by, where its force is the limit [m].

    Returns:
        (2g,); a finger that is held back asks for no speed: its damper would push beyond the limit.
    """
    g = len(position)
    off = desired[:g] - position
    back = np.abs(off) > reach
    return np.concatenate([position + np.minimum(np.maximum(off, -reach), reach), np.where(back, 0.0, desired[g:])])


def pressing(
    desired: Array, closed: Array, inward: Array, reach: Array, meeting: Array | float = TUNING.meeting
) -> Array:
    """Return fingers' desired state with springs wound up in full where they are told to close all the way.

    A spring alone presses a thin thing less than a wide one: between fingers told to meet, a wall of 6 mm by 6 N.

    Args:
        desired: (2g,) positions, then speeds.
        closed: (g,) where they meet [m].
        inward: (g,) sign of the way there.
        reach: (g,) as `held_back`.
        meeting: so near to where they meet they begin to press.

    Returns:
        (2g,), beyond where they meet by up to `reach`, the nearer to there the more.
    """
    g = len(closed)
    left = np.minimum(np.maximum(inward * (closed - desired[:g]) / meeting, 0.0), 1.0)
    return np.concatenate([desired[:g] + inward * (1.0 - left) * reach, desired[g:]])


def _meeting(arm: ArmPlant) -> tuple[Array, Array]:
    """Return where driven fingers meet (k,) [m or rad], and the sign of the way there (k,).

    Fingers that slide meet at the end of their travel that is nearer to zero. The sign is 0 for one that turns, if
    nobody knows its travel, or that has no such end.
    """
    fingers = [arm.fingers[k] for k in arm.driven]
    travel = None if arm.linkage is None else arm.linkage.travel
    if travel is not None:
        closed = travel.closed[arm.driven]
        return closed, np.sign(closed - travel.opened[arm.driven])
    closed, inward = np.zeros(len(fingers)), np.zeros(len(fingers))
    for k, finger in enumerate(fingers):
        if isinstance(finger, PrismaticJoint):
            near, far = sorted((finger.position_lower_limit(), finger.position_upper_limit()), key=abs)
            if np.isfinite([near, far]).all():
                closed[k], inward[k] = near, np.sign(near - far)
    return closed, inward


class NominalGravity:
    """Torques that hold the arm as the driver believes it to be: the twin's description without payload or effects."""

    def __init__(self, scenario: Scenario) -> None:
        """Load ``twin.arm``.

        Raises:
            ScenarioError: it cannot be loaded.
        """
        plant = MultibodyPlant(0.0)
        arm = twin_arm(scenario, plant)
        plant.Finalize()
        joints = [plant.get_joint(index) for index in arm.joint_indices]
        self._plant = plant
        self._context = plant.CreateDefaultContext()  # scratch: positions are overwritten before each use
        self._q_index = np.array([joint.position_start() for joint in joints])
        self._v_index = np.array([joint.velocity_start() for joint in joints])
        self._q = plant.GetPositions(self._context).copy()

    def __len__(self) -> int:
        """Return the number of arm joints."""
        return len(self._q_index)

    def torque(self, q: Array) -> Array:
        """Return (n,) torques that hold the arm at (n,) joint angles `q`."""
        self._q[self._q_index] = q
        self._plant.SetPositions(self._context, self._q)
        return np.asarray(-self._plant.CalcGravityGeneralizedForces(self._context)[self._v_index])


class ArmDriver(LeafSystem):
    """Joint impedance: torque = stiffness (q_d − q) + damping (v_d − v) + nominal gravity + torque_commanded.

    .. pydrake_system::

        name: ArmDriver
        input_ports:
        - position_commanded
        - torque_commanded
        - gripper_commanded
        - gripper_force_limit
        - motor_state
        output_ports:
        - torque
        - desired_state
        - gripper_desired_state

    The spring and the damper act in the plant, implicitly, so that they are stable at its step. A command goes
    through a critically damped filter (`follow`), whose position and rate are q_d and v_d: they lag a steady motion
    by 10 ms. Before the first command the arm holds its pose. An unconnected port and a vector with a NaN in it are
    no command; a torque that is not a number counts as zero.

    The fingers' springs are wound up no further than `gripper_force_limit` allows: what is held is pressed with that
    force from each side, whatever its width, by fingers that are told to close all the way.

    Ports: `position_commanded` (n) [rad], `torque_commanded` (n) [N·m], `gripper_commanded` (g) [m], or
    [rad] where they turn, `gripper_force_limit` (1) of each finger [N], `motor_state`
    (2(n + g)) the motors' positions, as encoders without noise would read them, then speeds; `torque` (n) feed-forward
    [N·m], `desired_state` (2n) and `gripper_desired_state` (2 per driven finger) of the plant's controllers. State: the
    filter's (2(n + g)). Rate: the plant's.
    """

    def __init__(self, arm: ArmPlant, gravity: NominalGravity, time_step: float) -> None:
        """Build the driver.

        Args:
            arm: of a finalized plant.
            gravity: the driver's own model.
            time_step: of the plant [s].

        Raises:
            ScenarioError: the driver's model has another number of joints than the true arm.
        """
        super().__init__()
        n, g = len(arm.joints), len(arm.fingers)
        if len(gravity) != n:
            raise ScenarioError("twin.arm.model", f"has {len(gravity)} joints where world.arm has {n}")
        self._n, self._m = n, n + g
        self._gravity = gravity
        self._dt = time_step
        speed = np.array(
            [min(j.velocity_upper_limits()[0], -j.velocity_lower_limits()[0]) for j in (*arm.joints, *arm.fingers)]
        )
        self._speed_limit = np.where(np.isfinite(speed) & (speed > 0), speed, 1e3)
        self._arm_part = np.concatenate([np.arange(n), self._m + np.arange(n)])
        driven = n + np.array(arm.driven, dtype=int)
        self._finger_part = np.concatenate([driven, self._m + driven])
        self._q = self.DeclareVectorInputPort("position_commanded", n)
        self._tau = self.DeclareVectorInputPort("torque_commanded", n)
        self._fingers = self.DeclareVectorInputPort("gripper_commanded", g) if g else None
        self._force = self.DeclareVectorInputPort("gripper_force_limit", 1) if g else None
        self._driven, self._finger_stiffness = driven, arm.stiffness[n:]
        self._meeting, self._linkage, self._own = _meeting(arm), arm.linkage, arm.driven
        self._motor = self.DeclareVectorInputPort("motor_state", 2 * self._m)
        state = self.DeclareDiscreteState(np.concatenate([arm.q0, np.zeros(self._m)]))
        self.DeclarePeriodicDiscreteUpdateEvent(time_step, 0.0, self._update)
        stored = self.discrete_state_ticket(state)
        self.DeclareVectorOutputPort("torque", n, self._calc_torque, {self._tau.ticket(), self._motor.ticket()})
        self.DeclareVectorOutputPort("desired_state", 2 * n, self._calc_desired, {stored})
        grip = {stored, self._motor.ticket(), *([self._force.ticket()] if self._force else [])}
        self.DeclareVectorOutputPort("gripper_desired_state", 2 * len(driven), self._calc_gripper, grip)

    def _command(self, context: Context, held: Array) -> Array:
        """Return where to go (n + g); `held` where there is no command."""
        command = held.copy()
        if self._q.HasValue(context):
            q = self._q.Eval(context)
            if np.isfinite(q).all():
                command[: self._n] = q
        if self._fingers is not None and self._fingers.HasValue(context):
            fingers = self._fingers.Eval(context)
            if np.isfinite(fingers).all():
                command[self._n :] = fingers
        return command

    def _feedforward(self, context: Context) -> Array:
        """Gravity of the nominal arm and commanded torque (n)."""
        torque = self._gravity.torque(self._motor.Eval(context)[: self._n])
        if self._tau.HasValue(context):
            told = self._tau.Eval(context)
            finite = np.isfinite(told)
            torque = torque + (told if finite.all() else np.where(finite, told, 0.0))
        return torque

    def _update(self, context: Context, discrete: DiscreteValues) -> None:
        x = context.get_discrete_state_vector().value()
        m = self._m
        q, v = x[:m], x[m : 2 * m]
        q_next, v_next = follow(q, v, self._command(context, q), self._speed_limit, self._dt)
        discrete.set_value(np.concatenate([q_next, v_next]))

    def _calc_torque(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self._feedforward(context))

    def _calc_desired(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[self._arm_part])

    def _calc_gripper(self, context: Context, output: BasicVector) -> None:
        desired = context.get_discrete_state_vector().value()[self._finger_part]
        limit = self._force_limit(context)
        if np.isfinite(limit):
            motors = self._motor.Eval(context)
            lever = levers(self._linkage, motors[self._n : self._m], self._own)
            reach = limit * lever / self._finger_stiffness
            desired = pressing(desired, *self._meeting, reach, TUNING.meeting / lever)
            desired = held_back(desired, motors[self._driven], reach)
        output.SetFromVector(desired)

    def _force_limit(self, context: Context) -> float:
        """Return the greatest force of each finger that has a motor [N]; infinite where none is told."""
        if self._force is None or not self._force.HasValue(context):
            return np.inf
        told = float(self._force.Eval(context)[0])
        return max(0.0, told) if np.isfinite(told) else np.inf
