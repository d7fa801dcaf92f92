"""The arm as it will be, and how sure the twin is of its hand: a ghost and ellipsoids in Meshcat."""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np
from pydrake.geometry import Meshcat, Rgba, Role, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from twin_diagram.scene.twin_scene import TwinScene
from twin_diagram.signals.arrays import Array
from twin_diagram.visualization.ellipsoids import ellipsoid, position_covariance

PATH: Final = "arm_overlay"
"""Where meshcat's tree holds it."""
AHEAD: Final = 0.25
"""How far the ghost is ahead [s]."""
MAGNIFIED: Final = 20.0
"""By how much the ellipsoids are: encoders know the hand to some hundredths of a millimetre."""
GHOST: Final = Rgba(0.55, 0.20, 0.85, 0.30)
"""Violet, and clear enough to see the arm through it."""
NOW: Final = Rgba(0.95, 0.55, 0.05, 0.6)
"""Orange: the hand's covariance at present."""
THEN: Final = Rgba(0.55, 0.20, 0.85, 0.6)
"""The ghost's violet: the hand's covariance `AHEAD`."""
LEAST: Final = 0.01
"""A ghost that is nearer to the arm than this in every joint is not shown [rad or m]."""


class ArmOverlay(LeafSystem):
    """Draws the arm `AHEAD` from now and the hand's covariance, now and then.

    .. pydrake_system::

        name: ArmOverlay
        input_ports:
        - arm_state
        - covariance

    Ports:
        arm_state: (2n) x̂ = [q, v] [rad, rad/s].
        covariance: ((2n + p)²) of [q, v, θ], row by row.

    Rate: that of the drawing [1/s]. Everything is recorded while meshcat records. The ghost is the arm moved on at the
    speed that it has, within its joints' limits; no plan and no command goes into it. An ellipsoid spans three standard
    deviations of the tool frame's origin, magnified by `MAGNIFIED`.
    """

    def __init__(self, meshcat: Meshcat, scene: TwinScene, covariance_size: int, rate: float = 15.0) -> None:
        """Register what is drawn.

        Args:
            meshcat: the server.
            scene: gives the arm's shapes and kinematics.
            covariance_size: of the port `covariance`.
            rate: drawings per second.
        """
        super().__init__()
        self.set_name("meshcat_arm_overlay")
        self._meshcat: Final = meshcat
        self._scene: Final = scene
        plant = scene.plant
        self._kinematics: Final = plant.CreateDefaultContext()
        joints = [plant.get_joint(index) for index in scene.arm.joint_indices]
        n = len(joints)
        self._velocity_index = np.array([joint.velocity_start() for joint in joints], dtype=int)
        self._lower = np.array([joint.position_lower_limits()[0] for joint in joints])
        self._upper = np.array([joint.position_upper_limits()[0] for joint in joints])
        moved = plant.GetBodiesKinematicallyAffectedBy([scene.arm.joint_indices[0]])
        own = {int(index) for instance in scene.arm.instances for index in plant.GetBodyIndices(instance)}
        self._bodies = [plant.get_body(index) for index in moved if int(index) in own]
        self._size = round(np.sqrt(covariance_size))
        self._state_in = self.DeclareVectorInputPort("arm_state", 2 * n)
        self._covariance_in = self.DeclareVectorInputPort("covariance", covariance_size)
        self.DeclareInitializationPublishEvent(self._register)
        self.DeclarePeriodicPublishEvent(1.0 / rate, 0.0, self._draw)

    def _register(self, context: Context) -> EventStatus:
        """Make the shapes once per run: afterwards they only move and change their size, which is recorded."""
        self._meshcat.Delete(PATH)
        inspector = self._scene.scene_graph.model_inspector()
        for body in self._bodies:
            frame = self._scene.plant.GetBodyFrameIdOrThrow(body.index())
            for k, geometry in enumerate(inspector.GetGeometries(frame, Role.kIllustration)):
                path = f"{PATH}/ghost/{body.name()}/{k}"
                self._meshcat.SetObject(path, inspector.GetShape(geometry), GHOST)
                self._meshcat.SetTransform(path, inspector.GetPoseInFrame(geometry))
        for name, colour in (("now", NOW), ("then", THEN)):
            self._meshcat.SetObject(f"{PATH}/{name}/sphere", Sphere(1.0), colour)
        return self._draw(context)

    def _draw(self, context: Context) -> EventStatus:
        time = context.get_time()
        q, v = cast(Array, self._state_in.Eval(context)).reshape(2, -1)
        P = cast(Array, self._covariance_in.Eval(context)).reshape(self._size, self._size)
        q_then = np.clip(q + AHEAD * v, self._lower, self._upper)
        self._draw_hand("now", q, P, 0.0, time)
        self._draw_hand("then", q_then, P, AHEAD, time)
        apart = bool(np.abs(q_then - q).max() > LEAST)
        self._meshcat.SetProperty(f"{PATH}/ghost", "visible", apart, time)
        self._meshcat.SetProperty(f"{PATH}/then", "visible", apart, time)
        if apart:  # the kinematics are those of `then`
            for body in self._bodies:
                self._meshcat.SetTransform(f"{PATH}/ghost/{body.name()}", self._pose(body), time)
        return EventStatus.Succeeded()

    def _pose(self, body: Any) -> RigidTransform:
        return cast(RigidTransform, self._scene.plant.EvalBodyPoseInWorld(self._kinematics, body))

    def _draw_hand(self, name: str, q: Array, P: Array, ahead: float, time: float) -> None:
        plant, positions = self._scene.plant, self._scene.default_positions.copy()
        positions[self._scene.arm_position_index] = q
        plant.SetPositions(self._kinematics, cast(Any, positions))
        tool, world = plant.get_frame(self._scene.arm.tool_frame), plant.world_frame()
        J = plant.CalcJacobianTranslationalVelocity(
            self._kinematics, JacobianWrtVariable.kV, tool, np.zeros((3, 1)), world, world
        )[:, self._velocity_index]
        R_WE, lengths = ellipsoid(position_covariance(J, P, ahead), scale=MAGNIFIED)
        p_WT = tool.CalcPoseInWorld(self._kinematics).translation()
        self._meshcat.SetTransform(f"{PATH}/{name}", RigidTransform(R_WE, p_WT), time)
        self._meshcat.SetProperty(f"{PATH}/{name}/sphere", "scale", lengths.tolist(), time)
