"""The arm as it will be with what it holds, and how sure the twin is of both: ghosts and ellipsoids in Meshcat."""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np
from pydrake.geometry import Meshcat, Rgba, Role, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from twin_diagram.scene.twin_scene import TwinScene
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import HAND_SIZE, NOTHING, Hand
from twin_diagram.signals.rotations import matrix, normalized
from twin_diagram.visualization.ellipsoids import DEVIATIONS, ellipsoid

PATH: Final = "arm_overlay"
"""Where meshcat's tree holds it."""
MAGNIFIED: Final = 20.0
"""By how much the present ellipsoid is: encoders know the hand to some hundredths of a millimetre."""
GHOST: Final = Rgba(0.55, 0.20, 0.85, 0.30)
"""Violet, and clear enough to see the arm through it."""
NOW: Final = Rgba(0.95, 0.55, 0.05, 0.6)
"""Orange: the hand's covariance at present."""
THEN: Final = Rgba(0.55, 0.20, 0.85, 0.25)
"""The ghost's violet, as clear: the covariance of what is foreseen."""
FORESEEN: Final = 1.0
"""How many standard deviations that ellipsoid's surface is from its centre: three would hide the hand."""
LEAST: Final = 0.01
"""A ghost that is nearer to the arm than this in every joint is not shown [rad or m]."""


class ArmOverlay(LeafSystem):
    """Draws the arm and what it holds as they are foreseen, and the hand's covariance, now and then.

    .. pydrake_system::

        name: ArmOverlay
        input_ports:
        - arm_state
        - covariance
        - position_previewed
        - preview_covariance
        - hand (optional)

    Ports:
        arm_state: (2n) x̂ = [q, v] [rad, rad/s].
        covariance: ((2n + p)²) of [q, v, θ], row by row.
        position_previewed: (n) as `Preview` foresees it [rad].
        preview_covariance: (n²) of that, row by row.
        hand: (HAND_SIZE) what is held, which goes with the arm; see `signals.hand`.

    Rate: that of the drawing [1/s]. Everything is recorded while meshcat records. An orange ellipsoid spans three
    standard deviations of the tool frame's origin now, magnified by `MAGNIFIED`, a violet one one standard deviation,
    in its true size, of that origin as foreseen, or of what is held.
    """

    def __init__(self, meshcat: Meshcat, scene: TwinScene, covariance_size: int, rate: float = 15.0) -> None:
        """Register what is drawn.

        Args:
            meshcat: the server.
            scene: gives the arm's shapes and kinematics, and the objects' shapes.
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
        moved = plant.GetBodiesKinematicallyAffectedBy([scene.arm.joint_indices[0]])
        own = {int(index) for instance in scene.arm.instances for index in plant.GetBodyIndices(instance)}
        self._bodies = [plant.get_body(index) for index in moved if int(index) in own]
        self._size = round(np.sqrt(covariance_size))
        self._state_in = self.DeclareVectorInputPort("arm_state", 2 * n)
        self._covariance_in = self.DeclareVectorInputPort("covariance", covariance_size)
        self._previewed_in = self.DeclareVectorInputPort("position_previewed", n)
        self._unsure_in = self.DeclareVectorInputPort("preview_covariance", n * n)
        self._hand_in = self.DeclareVectorInputPort("hand", HAND_SIZE)
        self.DeclareInitializationPublishEvent(self._register)
        self.DeclarePeriodicPublishEvent(1.0 / rate, 0.0, self._draw)

    def _register(self, context: Context) -> EventStatus:
        """Make the shapes once per run: afterwards they only move and change their size, which is recorded."""
        self._meshcat.Delete(PATH)
        plant = self._scene.plant
        shown = {f"ghost/{body.name()}": body for body in self._bodies}
        for name in self._scene.object_names:
            shown[f"held/{name}"] = plant.GetBodyByName("object", plant.GetModelInstanceByName(name))
        inspector = self._scene.scene_graph.model_inspector()
        for path, body in shown.items():
            frame = plant.GetBodyFrameIdOrThrow(body.index())
            for k, geometry in enumerate(inspector.GetGeometries(frame, Role.kIllustration)):
                self._meshcat.SetObject(f"{PATH}/{path}/{k}", inspector.GetShape(geometry), GHOST)
                self._meshcat.SetTransform(f"{PATH}/{path}/{k}", inspector.GetPoseInFrame(geometry))
        for name, colour in (("now", NOW), ("then", THEN)):
            self._meshcat.SetObject(f"{PATH}/{name}/sphere", Sphere(1.0), colour)
        return self._draw(context)

    def _draw(self, context: Context) -> EventStatus:
        time = context.get_time()
        q, _ = cast(Array, self._state_in.Eval(context)).reshape(2, -1)
        n = len(q)
        P = cast(Array, self._covariance_in.Eval(context)).reshape(self._size, self._size)[:n, :n]
        q_then = np.array(self._previewed_in.Eval(context))
        hand = Hand.unpack(np.array(self._hand_in.Eval(context))) if self._hand_in.HasValue(context) else Hand()
        self._place(q)
        self._draw_ellipsoid("now", P, np.zeros(3), np.zeros((3, 3)), DEVIATIONS * MAGNIFIED, time)
        self._place(q_then)
        held = hand.held != NOTHING
        hand = hand if held else Hand()
        X_TO = RigidTransform(RotationMatrix(matrix(normalized(hand.X_TO[:4]))), hand.X_TO[4:])
        S = cast(Array, self._unsure_in.Eval(context)).reshape(n, n)
        self._draw_ellipsoid("then", S, X_TO.translation(), hand.covariance[3:, 3:], FORESEEN, time)
        apart = bool(np.abs(q_then - q).max() > LEAST)
        self._meshcat.SetProperty(f"{PATH}/ghost", "visible", apart, time)
        self._meshcat.SetProperty(f"{PATH}/then", "visible", apart, time)
        for k, name in enumerate(self._scene.object_names):
            self._meshcat.SetProperty(f"{PATH}/held/{name}", "visible", apart and hand.held == k, time)
        if not apart:
            return EventStatus.Succeeded()
        for body in self._bodies:
            pose = cast(RigidTransform, self._scene.plant.EvalBodyPoseInWorld(self._kinematics, body))
            self._meshcat.SetTransform(f"{PATH}/ghost/{body.name()}", pose, time)
        if held:
            X_WO = self._tool().CalcPoseInWorld(self._kinematics).multiply(X_TO)
            self._meshcat.SetTransform(f"{PATH}/held/{self._scene.object_names[hand.held]}", X_WO, time)
        return EventStatus.Succeeded()

    def _tool(self) -> Any:
        return self._scene.plant.get_frame(self._scene.arm.tool_frame)

    def _place(self, q: Array) -> None:
        """Put the kinematics' arm at `q` (n,) [rad]."""
        positions = self._scene.default_positions.copy()
        positions[self._scene.arm_position_index] = q
        self._scene.plant.SetPositions(self._kinematics, cast(Any, positions))

    def _draw_ellipsoid(self, name: str, P: Array, p_TO: Array, own: Array, deviations: float, time: float) -> None:
        """Draw how sure a point p_TO (3,) of the hand is [m], by P (n, n) of q and what is `own` to it, (3, 3) in T."""
        plant, tool = self._scene.plant, self._tool()
        J = plant.CalcJacobianTranslationalVelocity(
            self._kinematics, JacobianWrtVariable.kV, tool, p_TO.reshape(3, 1), plant.world_frame(), plant.world_frame()
        )[:, self._velocity_index]
        X_WT = tool.CalcPoseInWorld(self._kinematics)
        R_WT = X_WT.rotation().matrix()
        R_WE, lengths = ellipsoid(J @ P @ J.T + R_WT @ own @ R_WT.T, deviations)
        self._meshcat.SetTransform(f"{PATH}/{name}", RigidTransform(R_WE, X_WT.multiply(p_TO)), time)
        self._meshcat.SetProperty(f"{PATH}/{name}/sphere", "scale", lengths.tolist(), time)
