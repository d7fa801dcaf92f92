"""What the twin thinks, drawn over its scene: the goal, the plan, and how sure it is of each object."""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from twin_diagram.scene.twin_scene import TwinScene
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import POSE_SIZE, TRACK_SIZE, ObjectStatus
from twin_diagram.signals.rotations import matrix
from twin_diagram.visualization.ellipsoids import ellipsoid

PATH: Final = "overlay"
"""Where meshcat's tree holds it."""
COLOURS: Final = {
    ObjectStatus.TRACKED: Rgba(0.10, 0.65, 0.30, 0.5),
    ObjectStatus.MOVING: Rgba(0.95, 0.60, 0.05, 0.5),
    ObjectStatus.STALE: Rgba(0.85, 0.15, 0.15, 0.4),
    ObjectStatus.LOST: Rgba(0.45, 0.45, 0.45, 0.35),
}
"""Of an object's ellipsoid, by its status."""


class MeshcatOverlay(LeafSystem):
    """Draws the goal frame, the planned path of the tool and ellipsoids of the objects' position uncertainty.

    .. pydrake_system::

        name: MeshcatOverlay
        input_ports:
        - tracks
        - plan (optional)
        - goal (optional)

    Ports:
        tracks: (K · TRACK_SIZE), from `SceneGraphUpdater`.
        plan: (knots · n) joint angles, knot by knot.
        goal: (7) X_WT of the tool frame; all-zero quaternion: none.

    Rate: that of the drawing [1/s]. Everything is recorded while meshcat records. An ellipsoid spans three standard
    deviations about the object's origin, green while the object is tracked, orange while it moves, red when it is
    stale, grey when it is lost.
    """

    def __init__(self, meshcat: Meshcat, scene: TwinScene, knots: int, rate: float = 15.0) -> None:
        """Register what is drawn.

        Args:
            meshcat: the server.
            scene: gives the objects' names and the tool's kinematics.
            knots: of the plan.
            rate: drawings per second.
        """
        super().__init__()
        self.set_name("meshcat_overlay")
        self._meshcat: Final = meshcat
        self._scene: Final = scene
        self._knots: Final = knots
        self._kinematics: Final = scene.plant.CreateDefaultContext()
        n = len(scene.arm_position_index)
        self._tracks_in = self.DeclareVectorInputPort("tracks", len(scene.object_names) * TRACK_SIZE)
        self._plan_in = self.DeclareVectorInputPort("plan", knots * n)
        self._goal_in = self.DeclareVectorInputPort("goal", POSE_SIZE)
        self.DeclareInitializationPublishEvent(self._register)
        self.DeclarePeriodicPublishEvent(1.0 / rate, 0.0, self._draw)

    def _register(self, context: Context) -> EventStatus:
        """Make the shapes once per run; nothing shows before it has a place."""
        self._meshcat.Delete(PATH)
        for axis, (rpy, colour) in enumerate(_TRIAD):
            X_GA = RigidTransform(RollPitchYaw(*rpy), 0.04 * np.eye(3)[axis])
            self._meshcat.SetObject(f"{PATH}/goal/{'xyz'[axis]}", Cylinder(0.003, 0.08), colour)
            self._meshcat.SetTransform(f"{PATH}/goal/{'xyz'[axis]}", X_GA)
        for k in range(self._knots):
            self._meshcat.SetObject(f"{PATH}/plan/{k}", Sphere(0.006), Rgba(0.6, 0.1, 0.8, 0.9))
        for name in self._scene.object_names:
            for status, colour in COLOURS.items():
                self._meshcat.SetObject(f"{PATH}/uncertainty/{name}/{status.name.lower()}", Sphere(1.0), colour)
        self._meshcat.SetProperty(f"{PATH}/goal", "visible", False)
        self._meshcat.SetProperty(f"{PATH}/plan", "visible", False)
        return self._draw(context)

    def _draw(self, context: Context) -> EventStatus:
        time = context.get_time()
        tracks = cast(Array, self._tracks_in.Eval(context)).reshape(-1, TRACK_SIZE)
        for name, row in zip(self._scene.object_names, tracks, strict=True):
            self._draw_uncertainty(f"{PATH}/uncertainty/{name}", row, time)
        if self._goal_in.HasValue(context):
            goal = cast(Array, self._goal_in.Eval(context))
            given = bool(goal[:4].any())
            self._meshcat.SetProperty(f"{PATH}/goal", "visible", given, time)
            if given:
                R_WG = RotationMatrix(matrix(goal[:4] / np.linalg.norm(goal[:4])))
                self._meshcat.SetTransform(f"{PATH}/goal", RigidTransform(R_WG, cast(Any, goal[4:])), time)
        if self._plan_in.HasValue(context):
            plan = cast(Array, self._plan_in.Eval(context)).reshape(self._knots, -1)
            self._meshcat.SetProperty(f"{PATH}/plan", "visible", True, time)
            for k, X_WT in enumerate(self._tool_path(plan)):
                self._meshcat.SetTransform(f"{PATH}/plan/{k}", X_WT, time)
        return EventStatus.Succeeded()

    def _draw_uncertainty(self, path: str, row: Array, time: float) -> None:
        status = ObjectStatus(int(row[0]))
        for other in COLOURS:
            self._meshcat.SetProperty(f"{path}/{other.name.lower()}", "visible", other == status, time)
        if status not in COLOURS:
            return
        R_WE, half_axes = ellipsoid(row[15:].reshape(6, 6)[3:, 3:])
        self._meshcat.SetTransform(path, RigidTransform(R_WE, cast(Any, row[6:9])), time)
        self._meshcat.SetProperty(f"{path}/{status.name.lower()}", "scale", half_axes.tolist(), time)

    def _tool_path(self, plan: Array) -> list[RigidTransform]:
        """Return where the tool is at each knot, in W."""
        plant, context = self._scene.plant, self._kinematics
        tool = plant.get_frame(self._scene.arm.tool_frame)
        positions = self._scene.default_positions.copy()
        path = []
        for knot in plan:
            positions[self._scene.arm_position_index] = knot
            plant.SetPositions(context, cast(Any, positions))
            path.append(tool.CalcPoseInWorld(context))
        return path


_TRIAD: Final = (
    ([0.0, np.pi / 2, 0.0], Rgba(0.9, 0.1, 0.1, 1.0)),
    ([-np.pi / 2, 0.0, 0.0], Rgba(0.1, 0.7, 0.1, 1.0)),
    ([0.0, 0.0, 0.0], Rgba(0.1, 0.2, 0.9, 1.0)),
)
"""Axes x, y, z of the goal: roll, pitch and yaw of a cylinder that lies along its own z, and its colour."""
