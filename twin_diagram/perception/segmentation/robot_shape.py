"""Which points belong to the robot: distance to its collision shapes, posed by the joint estimate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
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
from twin_diagram.perception.segmentation.robot_kernels import (
    BOX,
    CAPSULE,
    CYLINDER,
    ELLIPSOID,
    HULL,
    SPHERE,
    RobotShapes,
    mark_near,
)
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
    """One shape fixed to a body, and the radius of a sphere about its origin that holds it."""

    body: int
    R_BG: Array
    p_BG: Array
    radius: float


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
        placed = add_arm(plant, arm, packages, base_dir, looked_at=False)
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
        self._parts, shapes = [], []
        for index in (i for instance in placed.instances for i in plant.GetBodyIndices(instance)):
            body = plant.get_body(index)
            frame = plant.GetBodyFrameIdOrThrow(index)
            for geometry in inspector.GetGeometries(frame, Role.kProximity):
                if (told := _told(inspector, geometry)) is None:
                    continue
                X_BG = inspector.GetPoseInFrame(geometry)
                self._parts.append(_Part(int(body.index()), X_BG.rotation().matrix(), X_BG.translation(), told[0]))
                shapes.append(told[1:])
        self._shapes = _shapes(shapes)
        self._radii = np.array([part.radius for part in self._parts])
        # Each picture asks two to four times for one arm or two.
        self._placed = lru_cache(maxsize=2)(self._places)

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
        R_WG, p_WG = self._placed(positions.tobytes())
        places = R_WG, p_WG, self._radii + margin
        mark_near(one_layout(np.asarray(points_W, dtype=float)), places, self._shapes, margin, result)
        return result

    def _places(self, positions: bytes) -> tuple[Array, Array]:
        """Return R_WG (K, 3, 3) and p_WG (K, 3) of the shapes at a plant's positions."""
        self._plant.SetPositions(self._scratch, np.frombuffer(positions))
        poses = self._plant.get_body_poses_output_port().Eval(self._scratch)
        p_WG = np.empty((len(self._parts), 3))
        R_WG = np.empty((len(self._parts), 3, 3))
        for k, part in enumerate(self._parts):
            R_WB = poses[part.body].rotation().matrix()
            R_WG[k] = R_WB @ part.R_BG
            p_WG[k] = R_WB @ part.p_BG + poses[part.body].translation()
        return R_WG, p_WG


def _told(inspector: SceneGraphInspector, geometry: object) -> tuple[float, int, Array, Array] | None:
    """Return a shape's bounding radius about G's origin, its kind, sizes (3,) and faces (F, 4); see `RobotShapes`."""
    shape, none = inspector.GetShape(geometry), np.zeros((0, 4))
    if isinstance(shape, Sphere):
        return shape.radius(), SPHERE, np.array([shape.radius(), 0.0, 0.0]), none
    if isinstance(shape, (Capsule, Cylinder)):
        radius, half = shape.radius(), shape.length() / 2
        round_ = isinstance(shape, Capsule)
        reach = radius + half if round_ else float(np.hypot(radius, half))
        return reach, CAPSULE if round_ else CYLINDER, np.array([radius, half, 0.0]), none
    if isinstance(shape, Box):
        half_size = np.array(shape.size()) / 2
        return float(np.linalg.norm(half_size)), BOX, half_size, none
    if isinstance(shape, Ellipsoid):
        axes = np.array([shape.a(), shape.b(), shape.c()])
        return float(axes.max()), ELLIPSOID, axes, none
    hull = inspector.GetConvexHull(geometry) if isinstance(shape, (Mesh, Convex)) else None
    if hull is None:
        return None
    vertices = np.array([hull.vertex(i) for i in range(hull.num_vertices())])
    return float(np.linalg.norm(vertices, axis=1).max()), HULL, np.zeros(3), _planes(vertices)


def _shapes(each: Sequence[tuple[int, Array, Array]]) -> RobotShapes:
    """Return shapes of which kind, sizes (3,) and faces (F, 4) are told."""
    return RobotShapes(
        np.array([kind for kind, _, _ in each], dtype=np.int64),
        np.array([sizes for _, sizes, _ in each]).reshape(-1, 3),
        np.concatenate([np.zeros((0, 4)), *(faces for _, _, faces in each)]),
        np.cumsum([0, *(len(faces) for _, _, faces in each)]),
    )


def _planes(vertices: Array) -> Array:
    """Return the faces' planes (F, 4) of the convex hull of vertices (V, 3); a sheet is given a little thickness."""
    try:
        return np.asarray(ConvexHull(vertices).equations)
    except QhullError:
        corners = TUNING.sheet * (np.indices((2, 2, 2)).reshape(3, 8).T - 0.5)
        return np.asarray(ConvexHull((vertices[:, None] + corners).reshape(-1, 3)).equations)
