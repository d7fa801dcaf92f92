"""What a depth image shows of surfaces whose places are known: the arm's parts, and the table's top."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from pydrake.geometry import Mesh, Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody
from scipy.spatial import cKDTree

from twin_diagram import scenario
from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.model.description.followers import Followers
from twin_diagram.perception.calibration import KnownSurface
from twin_diagram.perception.pinhole import DepthImage, Pinhole
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.lens import rays_through
from twin_diagram.twin.arm_sensing.link_surface import other_parts, surface_of


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    spacing: float = 0.005
    """Of the points on the arm's surface [m]: a tangent plane so near a point errs by less than 0.1 mm."""

    stride: int = 4
    """Every n-th pixel is looked at: neighbours err together over more than that."""

    near: float = 0.035
    """A point farther than this from the arm's surface is not of it [m]: as far off as a camera is at 2 m."""

    apart: float = 0.06
    """What is nearer to the table than this may be either's, the arm's or what stands there [m]."""

    table_near: float = 0.03
    """What is farther from the table's top is not of it [m]."""

    facing: float = 0.35
    """Least cosine of a normal and the line of sight: at rims, depth flies."""

    jump: float = 0.03
    """Where depth changes by more than this from one pixel looked at to the next, it is no surface's [m]."""

    arm_std: float = 0.0005
    """How well a part of the arm's surface is where the joints tell [m]: of arms' descriptions."""

    table_std: float = 0.002
    """How well the table's top is where it is told [m], all of it alike."""

    late: float = 0.035
    """Depth may be so late [s], half a frame's period at 15 Hz."""

    most: tuple[int, int] = (400, 400)
    """Points of the arm and of the table that are kept of an image."""


TUNING = Tuning()

TABLE = -1
"""Stands for a part's number: the table."""


@dataclass(frozen=True)
class ArmView:
    """What one image shows of known surfaces; N points.

    Attributes:
        q, v: (n,) joint angles at the capture [rad], and speeds [rad/s].
        pixels: (N, 2) columns and rows [px].
        depth: (N,) as delivered [m].
        parts: (N,) numbers of parts of the arm, or `TABLE`.
        strides: of the arm's points and the table's: each stands for the square of this many pixels [px].
    """

    q: Array
    v: Array
    pixels: Array
    depth: Array
    parts: Array
    strides: tuple[int, int] = (TUNING.stride, TUNING.stride)


class ArmParts:
    """The arm's rigid parts, fingers left out, and those whose shapes are not known exactly (meshes).

    Args:
        arm: the twin's.
        packages: local folders for `package://` names.
    """

    def __init__(self, arm: scenario.ArmModel, packages: Mapping[str, str | Path] | None = None) -> None:
        scene_graph, plant = SceneGraph(), MultibodyPlant(0.0)
        plant.RegisterAsSourceForSceneGraph(scene_graph)
        placed = add_arm(plant, arm, packages)
        plant.Finalize()
        self._plant, self._scratch = plant, plant.CreateDefaultContext()
        """Overwritten before each use."""
        joints = [plant.get_joint(index) for index in placed.joint_indices]
        self._q = np.array([joint.position_start() for joint in joints], dtype=int)
        self._v = np.array([joint.velocity_start() for joint in joints], dtype=int)
        fingers = {int(joint.child_body().index()) for joint in Followers.gripping(plant, placed)}
        root = plant.get_body(placed.base)
        parts = [body for body in other_parts(plant, root) if int(body.index()) not in fingers]
        parts += [root] if self._seen(scene_graph, root) else []
        plain = [body for body in parts if not self._has_mesh(scene_graph, body)]
        surfaces = [surface_of(scene_graph, plant, body, TUNING.spacing) for body in plain]
        self._bodies = [body for body, (points, _) in zip(plain, surfaces, strict=True) if len(points)]
        """A link of each part."""
        self._surfaces = [(cKDTree(points), points, normals) for points, normals in surfaces if len(points)]
        self._balls = []
        for _, points, _ in self._surfaces:
            middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
            self._balls.append((middle, float(np.linalg.norm(points - middle, axis=1).max())))

    @property
    def joints(self) -> int:
        """Number of the arm's joints."""
        return len(self._q)

    def poses(self, q: Array) -> list[tuple[Array, Array]]:
        """Return R_WB (3, 3) and p_WB (3,) of each part at joint angles q (n,)."""
        positions = self._plant.GetPositions(self._scratch)
        positions[self._q] = q
        self._plant.SetPositions(self._scratch, positions)
        found = [body.EvalPoseInWorld(self._scratch) for body in self._bodies]
        return [(X.rotation().matrix(), X.translation()) for X in found]

    def speeds(self, q: Array, v: Array) -> list[float]:
        """Return how fast the middle of each part moves [m/s]."""
        velocities = np.zeros(self._plant.num_velocities())
        velocities[self._v] = v
        poses = self.poses(q)
        self._plant.SetVelocities(self._scratch, velocities)
        result = []
        for body, (R, _), (middle, _) in zip(self._bodies, poses, self._balls, strict=True):
            V = body.EvalSpatialVelocityInWorld(self._scratch)
            result.append(float(np.linalg.norm(V.translational() + np.cross(V.rotational(), R @ middle))))
        return result

    def nearest(self, part: int, R: Array, p: Array, points_W: Array) -> tuple[Array, Array]:
        """Return the nearest points of a part's surface and its normals there, (N, 3) each in W; the part at R, p."""
        tree, points, normals = self._surfaces[part]
        _, index = tree.query((points_W - p) @ R, workers=1)
        return points[index] @ R.T + p, normals[index] @ R.T

    def parts_of(self, points_W: Array, p_WC: Array, q: Array) -> Array:
        """Return (N,) whose surface each point is on, as seen from p_WC; -2 where it is nobody's."""
        best, part = np.full(len(points_W), TUNING.near), np.full(len(points_W), -2)
        for k, (R, p) in enumerate(self.poses(q)):
            tree, _, normals = self._surfaces[k]
            middle, radius = self._balls[k]
            around = points_W - (R @ middle + p)
            close = np.flatnonzero(np.einsum("ni,ni->n", around, around) < (radius + TUNING.near) ** 2)
            distance, index = tree.query((points_W[close] - p) @ R, distance_upper_bound=TUNING.near, workers=1)
            hit = np.flatnonzero(distance < best[close])
            where, normal = close[hit], normals[index[hit]] @ R.T
            sight = p_WC - points_W[where]
            facing = np.einsum("ni,ni->n", normal, sight) > TUNING.facing * np.linalg.norm(sight, axis=1)
            best[where] = distance[hit]
            part[where] = np.where(facing, k, -2)
        return part

    def sample(self, depth: DepthImage, camera: Pinhole, scale: float, table: float, q: Array, v: Array) -> ArmView:
        """Return what a depth image shows of the arm and of the table.

        Args:
            depth: (H, W) as delivered [m], 0 where there is none.
            camera: that took it, as believed.
            scale: what its depth is to be multiplied by, as believed.
            table: height of the table's top [m].
            q: (n,) joint angles at the capture [rad].
            v: (n,) joint speeds [rad/s].
        """
        step = TUNING.stride
        z = np.asarray(depth[::step, ::step], dtype=float)
        smooth = z > 0.0
        for axis in (0, 1):
            jump = np.abs(np.diff(z, axis=axis)) > TUNING.jump
            ahead = [slice(None), slice(None)]
            behind = [slice(None), slice(None)]
            ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
            smooth[tuple(ahead)] &= ~jump
            smooth[tuple(behind)] &= ~jump
        row, column = np.nonzero(smooth)
        rays = rays_through(camera.optics, step * column, step * row) @ camera.R_WC.T
        points = camera.p_WC + scale * z[row, column][:, None] * rays
        part = self.parts_of(points, camera.p_WC, q)
        height = points[:, 2] - table
        part[(part >= 0) & (height < TUNING.apart)] = -2
        part[(part == -2) & (np.abs(height) < TUNING.table_near)] = TABLE
        groups = np.flatnonzero(part >= 0), np.flatnonzero(part == TABLE)
        kept = [
            group[np.linspace(0, len(group) - 1, min(most, len(group))).round().astype(int)]
            for group, most in zip(groups, TUNING.most, strict=True)
        ]
        arm, ground = (
            round(step * np.sqrt(len(group) / max(len(own), 1)) or step)
            for group, own in zip(groups, kept, strict=True)
        )
        index = np.concatenate(kept)
        pixels = step * np.column_stack([column[index], row[index]]).astype(float)
        return ArmView(q, v, pixels, z[row[index], column[index]], part[index], (arm, ground))

    def surfaces(self, samples: list[ArmView], table: float) -> list[KnownSurface]:
        """Return the surfaces that images show, for `calibrate`.

        Args:
            samples: one of each image.
            table: height of the table's top [m].
        """
        found = []
        for frame, sample in enumerate(samples):
            poses, speeds = self.poses(sample.q), self.speeds(sample.q, sample.v)
            for part in np.unique(sample.parts).astype(int):
                own, stride = sample.parts == part, sample.strides[int(part == TABLE)]
                if part == TABLE:
                    nearest, place = partial(_on_table, height=table), TUNING.table_std
                else:
                    nearest = partial(self.nearest, part, *poses[part])
                    place = float(np.hypot(TUNING.arm_std, TUNING.late * speeds[part]))
                pixels, depth = sample.pixels[own], sample.depth[own]
                found.append(KnownSurface(pixels, depth, nearest, place, stride, frame, part + 1))
        return found

    def _seen(self, scene_graph: SceneGraph, body: RigidBody) -> bool:
        """Return whether a link has a shape that can be seen."""
        frame = self._plant.GetBodyFrameIdOrThrow(body.index())
        return bool(scene_graph.model_inspector().GetGeometries(frame, Role.kIllustration))

    def _has_mesh(self, scene_graph: SceneGraph, link: RigidBody) -> bool:
        """Return whether a part has a mesh, of which the hull alone is known."""
        inspector = scene_graph.model_inspector()
        for body in self._plant.GetBodiesWeldedTo(link):
            frame = self._plant.GetBodyFrameIdOrThrow(body.index())
            shapes = (inspector.GetShape(g) for g in inspector.GetGeometries(frame, Role.kIllustration))
            if any(isinstance(shape, Mesh) for shape in shapes):
                return True
        return False


def _on_table(points_W: Array, height: float) -> tuple[Array, Array]:
    """Return the nearest points of a level table and its normals there."""
    places = points_W.copy()
    places[:, 2] = height
    return places, np.tile([0.0, 0.0, 1.0], (len(points_W), 1))
