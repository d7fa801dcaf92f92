"""Which points belong to the robot: distance to its collision shapes, posed by the joint estimate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pydrake.geometry import (
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    Mesh,
    Role,
    SceneGraph,
    SceneGraphInspector,
    Sphere,
)
from pydrake.multibody.plant import MultibodyPlant
from scipy.spatial import ConvexHull, QhullError

from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.model.description.followers import Followers
from twin_diagram.perception.segmentation.robot_kernels import within_spheres
from twin_diagram.scenario import ArmModel
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import one_layout


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    sheet: float = 2e-4
    """Thickness of collision meshes that have none, as plates do [m]: nothing beside the margins."""


TUNING = Tuning()


@dataclass(frozen=True)
class _Part:
    """One shape fixed to a body: `distance` of points (N, 3) in G, a sphere about `centre_B` that holds it."""

    body: int
    R_BG: Array
    p_BG: Array
    radius: float
    distance: Callable[[Array], Array]


class RobotShape:
    """The robot's collision shapes; `near` says which points lie within a margin of them.

    Args:
        arm: the arm's description, with collision geometry.
        packages: local folders by package name.
        base_dir: folder that relative paths are looked up in first.
    """

    def __init__(
        self,
        arm: ArmModel,
        packages: Mapping[str, str | Path] | None = None,
        base_dir: str | Path | None = None,
    ) -> None:
        scene_graph = SceneGraph()
        plant = MultibodyPlant(time_step=0.0)
        plant.RegisterAsSourceForSceneGraph(scene_graph)
        placed = add_arm(plant, arm, packages, base_dir)
        plant.Finalize()
        self._plant = plant
        self._scratch = plant.CreateDefaultContext()
        """Overwritten before each use."""
        self._position_index = np.array([plant.get_joint(i).position_start() for i in placed.joint_indices], dtype=int)
        self._positions = plant.GetPositions(self._scratch)
        self._finger_index = np.array(
            [plant.get_joint(i).position_start() for i in placed.gripper_joint_indices], dtype=int
        )
        self._followers = Followers.of(plant, placed)
        self._tool = plant.get_frame(placed.tool_frame)
        for index in placed.gripper_joint_indices:
            joint = plant.get_joint(index)
            low, high = joint.position_lower_limits()[0], joint.position_upper_limits()[0]
            if np.isfinite(low) and np.isfinite(high):
                # Half open: nowhere farther off than half the stroke.
                self._positions[joint.position_start()] = (low + high) / 2
        inspector = scene_graph.model_inspector()
        self._parts = []
        for index in (i for instance in placed.instances for i in plant.GetBodyIndices(instance)):
            body = plant.get_body(index)
            frame = plant.GetBodyFrameIdOrThrow(index)
            for geometry in inspector.GetGeometries(frame, Role.kProximity):
                shape = _distance_to(inspector, geometry)
                if shape is not None:
                    X_BG = inspector.GetPoseInFrame(geometry)
                    self._parts.append(
                        _Part(int(body.index()), X_BG.rotation().matrix(), X_BG.translation(), shape[0], shape[1])
                    )

    @property
    def joint_count(self) -> int:
        """Number of the arm's joints."""
        return len(self._position_index)

    @property
    def finger_count(self) -> int:
        """Number of the gripper's joints."""
        return len(self._finger_index)

    def tool(self, q: Array) -> Array:
        """Return X_WT (4, 4) of the tool at joint angles `q` (n,)."""
        positions = self._positions.copy()
        positions[self._position_index] = q
        self._plant.SetPositions(self._scratch, positions)
        return np.asarray(self._tool.CalcPoseInWorld(self._scratch).GetAsMatrix4())

    def near(self, points_W: Array, q: Array, margin: float, fingers: Array | None = None) -> npt.NDArray[np.bool_]:
        """Return which of the points (N, 3) lie within `margin` [m] of the robot at joint angles `q` (n,).

        Where `fingers` (g,) are is told [m], or they are taken to be half open.
        """
        result = np.zeros(len(points_W), dtype=bool)
        if not len(points_W) or not self._parts:
            return result
        positions = self._positions.copy()
        positions[self._position_index] = q
        if fingers is not None:
            positions[self._finger_index] = fingers
        self._followers.follow(positions)
        self._plant.SetPositions(self._scratch, positions)
        poses = self._plant.get_body_poses_output_port().Eval(self._scratch)
        p_WG = np.empty((len(self._parts), 3))
        R_WG = np.empty((len(self._parts), 3, 3))
        for k, part in enumerate(self._parts):
            R_WB = poses[part.body].rotation().matrix()
            R_WG[k] = R_WB @ part.R_BG
            p_WG[k] = R_WB @ part.p_BG + poses[part.body].translation()
        reach = np.array([part.radius + margin for part in self._parts])
        close = within_spheres(one_layout(np.asarray(points_W, dtype=float)), p_WG, reach)
        for k, part in enumerate(self._parts):
            index = np.flatnonzero(close[k] & ~result)
            if index.size:
                p_G = (points_W[index] - p_WG[k]) @ R_WG[k]
                result[index[part.distance(p_G) < margin]] = True
        return result


def _distance_to(inspector: SceneGraphInspector, geometry: object) -> tuple[float, Callable[[Array], Array]] | None:
    """Bounding radius about G's origin, and the distance from points (N, 3) in G: 0 or less inside."""
    shape = inspector.GetShape(geometry)
    if isinstance(shape, Sphere):
        radius = shape.radius()
        return radius, lambda p: np.linalg.norm(p, axis=1) - radius
    if isinstance(shape, (Capsule, Cylinder)):
        radius, half = shape.radius(), shape.length() / 2
        if isinstance(shape, Capsule):
            return radius + half, lambda p: _from_segment(p, half) - radius
        return float(np.hypot(radius, half)), lambda p: _from_box(
            np.stack([np.hypot(p[:, 0], p[:, 1]), p[:, 2]], axis=1), np.array([radius, half])
        )
    if isinstance(shape, Box):
        half_size = np.array(shape.size()) / 2
        return float(np.linalg.norm(half_size)), lambda p: _from_box(p, half_size)
    if isinstance(shape, (Ellipsoid, Mesh, Convex)):
        if isinstance(shape, Ellipsoid):
            axes = np.array([shape.a(), shape.b(), shape.c()])
            return float(axes.max()), lambda p: (np.linalg.norm(p / axes, axis=1) - 1.0) * axes.min()
        hull = inspector.GetConvexHull(geometry)
        if hull is None:
            return None
        vertices = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
        planes = _planes(vertices)
        # The largest distance to a plane is never more than the distance to the body.
        return float(np.linalg.norm(vertices, axis=1).max()), lambda p: (p @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    return None


def _planes(vertices: Array) -> Array:
    """Return the faces' planes (F, 4) of the convex hull of vertices (V, 3); a sheet is given a little thickness."""
    try:
        return np.asarray(ConvexHull(vertices).equations)
    except QhullError:
        corners = TUNING.sheet * (np.indices((2, 2, 2)).reshape(3, 8).T - 0.5)
        return np.asarray(ConvexHull((vertices[:, None] + corners).reshape(-1, 3)).equations)


def _from_segment(p: Array, half: float) -> Array:
    """Distance of points to the piece of the z axis up to `half` on either side."""
    return np.sqrt(p[:, 0] ** 2 + p[:, 1] ** 2 + np.maximum(np.abs(p[:, 2]) - half, 0.0) ** 2)


def _from_box(p: Array, half: Array) -> Array:
    """Distance of points (N, d) to the box of half edge lengths `half`; negative inside."""
    beyond = np.abs(p) - half
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0))
