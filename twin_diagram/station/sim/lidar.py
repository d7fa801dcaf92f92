"""The simulated lidar: beams that meet the world's shapes, with noise that grows with distance squared."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Role, Shape, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, DiscreteValues, LeafSystem
from scipy.spatial import ConvexHull, QhullError

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import Lidar, LidarDefects, Scenario
from twin_diagram.scenario import poses as scenario_poses
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station import ports
from twin_diagram.station.scan_cloud import beams
from twin_diagram.station.sim.noise import Stream, generator
from twin_diagram.station.sim.world_plant import WorldPlant


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    sides: int = 64
    """Of the prism that stands for a cylinder."""


TUNING = Tuning()


@dataclass(frozen=True)
class ScannedSolid:
    """A convex shape fixed to a body; an ellipsoid or what lies behind all of its planes.

    Attributes:
        body: index.
        R, p: of its frame G in the body's (3, 3), (3,).
        radius: of a sphere about G's origin that holds it [m].
        axes: (3,) of an ellipsoid [m]; None.
        planes: (F, 4) outward normal n and offset d, n · x + d ≤ 0 inside.
    """

    body: int
    R: Array
    p: Array
    radius: float
    axes: Array | None
    planes: Array


def meet_planes(origin: Array, ways: Array, planes: Array) -> Array:
    """Return how far along beams (N, 3) from an origin (3,) a convex solid is met (N,) [m]; inf where it is not."""
    along, behind = ways @ planes[:, :3].T, planes[:, :3] @ origin + planes[:, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        at = -behind / along
    enters = np.where(along < 0.0, at, -np.inf).max(axis=1)
    leaves = np.where(along > 0.0, at, np.inf).min(axis=1)
    beside = ((along == 0.0) & (behind > 0.0)).any(axis=1)
    return np.where((enters > 0.0) & (enters <= leaves) & ~beside, enters, np.inf)


def meet_ellipsoid(origin: Array, ways: Array, axes: Array) -> Array:
    """Return the same of an ellipsoid about the frame's origin with axes (3,)."""
    o, d = origin / axes, ways / axes
    a, b, c = np.einsum("ij,ij->i", d, d), d @ o, float(o @ o) - 1.0
    root = b**2 - a * c
    at = (-b - np.sqrt(np.maximum(root, 0.0))) / a
    return np.where((root >= 0.0) & (at > 0.0), at, np.inf)


def scan(origin: Array, ways: Array, solids: list[ScannedSolid], poses: list[RigidTransform]) -> Array:
    """Return the ranges (N,) of the first echoes [m]; inf where there is none.

    Args:
        origin: (3,) in W [m].
        ways: (N, 3) unit vectors in W.
        solids: of the world.
        poses: X_WB by the index of the body.
    """
    nearest = np.full(len(ways), np.inf)
    for solid in solids:
        X_WB = poses[solid.body]
        R_WB = X_WB.rotation().matrix()
        R = R_WB @ solid.R
        away = X_WB.translation() + R_WB @ solid.p - origin
        ahead = ways @ away
        near = np.flatnonzero((away @ away - ahead**2 < solid.radius**2) & (ahead > -solid.radius))
        if not len(near):
            continue
        seat, d = -R.T @ away, ways[near] @ R
        met = meet_planes(seat, d, solid.planes) if solid.axes is None else meet_ellipsoid(seat, d, solid.axes)
        nearest[near] = np.minimum(nearest[near], met)
    return nearest


def world_solids(world: WorldPlant) -> list[ScannedSolid]:
    """Return all that can be seen of a world; a mesh as its convex hull."""
    plant, inspector = world.plant, world.scene_graph.model_inspector()
    found: list[ScannedSolid] = []
    for index in range(plant.num_bodies()):
        frame = plant.GetBodyFrameIdIfExists(BodyIndex(index))
        if frame is None:
            continue
        for geometry in inspector.GetGeometries(frame, Role.kIllustration):
            X_BG = inspector.GetPoseInFrame(geometry)
            hull = inspector.GetConvexHull(geometry)
            corners = None if hull is None else np.array([hull.vertex(i) for i in range(hull.num_vertices())])
            for shift, axes, planes, radius in _parts(inspector.GetShape(geometry), corners):
                R = X_BG.rotation().matrix()
                found.append(ScannedSolid(index, R, X_BG.translation() + R @ shift, radius, axes, planes))
    return found


def _parts(shape: Shape, corners: Array | None) -> list[tuple[Array, Array | None, Array, float]]:
    """Return where each convex part lies in G (3,), its axes or None, its planes (F, 4), and its radius."""
    centre, none = np.zeros(3), np.zeros((0, 4))
    if isinstance(shape, Sphere):
        return [(centre, np.full(3, shape.radius()), none, shape.radius())]
    if isinstance(shape, Ellipsoid):
        axes = np.array([shape.a(), shape.b(), shape.c()])
        return [(centre, axes, none, float(axes.max()))]
    if isinstance(shape, Box):
        half = 0.5 * np.asarray(shape.size(), dtype=float)
        planes = np.hstack([np.vstack([np.eye(3), -np.eye(3)]), -np.tile(half, 2)[:, None]])
        return [(centre, None, planes, float(np.linalg.norm(half)))]
    if isinstance(shape, (Cylinder, Capsule)):
        angle = 2.0 * np.pi * np.arange(TUNING.sides) / TUNING.sides
        r, half = shape.radius(), 0.5 * shape.length()
        side = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle, np.full(TUNING.sides, -r)], axis=1)
        planes = np.vstack([side, [0.0, 0.0, 1.0, -half], [0.0, 0.0, -1.0, -half]])
        parts = [(centre, None, planes, float(np.hypot(1.01 * r, half)))]
        if isinstance(shape, Capsule):
            parts += [(np.array([0.0, 0.0, z]), np.full(3, r), none, r) for z in (-half, half)]  # type: ignore[misc]
        return parts  # type: ignore[return-value]
    if corners is None:
        return []
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    try:
        planes = np.unique(np.round(ConvexHull(corners - middle).equations, 9), axis=0)
    except QhullError:  # flat, as a label is: nothing is behind it
        return []
    return [(middle, None, planes, float(np.linalg.norm(corners - middle, axis=1).max()))]


class LidarSystem(LeafSystem):
    """Scans the world, with a lidar's defects.

    .. pydrake_system::

        name: LidarSystem
        input_ports:
        - body_poses
        output_ports:
        - ranges
        - scan_time

    A scan is taken at k / rate, k = 1, 2, …, all beams at once, and stands on the ports `Lidar.latency` later: `ranges`
    (rows · columns) [m] along `scan_cloud.beams`, 0 where there is no echo, and `scan_time` (1) [s], `NEVER` before the
    first. A range r errs along its beam by √(noise² + (growth r²)²) (Hybrid Reality Twins, section 3.3). Noise is a
    function of seed and scan alone.
    """

    def __init__(self, lidar: Lidar, defects: LidarDefects, solids: list[ScannedSolid], seed: int) -> None:
        """Build the lidar.

        Args:
            lidar: as its data sheet tells.
            defects: what it really does.
            solids: that it may meet.
            seed: of the scenario.

        Raises:
            ScenarioError: a defect that makes no sense.
        """
        super().__init__()
        for name in ("noise", "growth", "dropout"):
            if not 0.0 <= getattr(defects, name) < np.inf:
                raise ScenarioError(f"world.lidar_defects.{name}", f"{getattr(defects, name)} is negative or no number")
        if any(len(span) != 2 or not span[0] <= span[1] for span in defects.missing):
            raise ScenarioError("world.lidar_defects.missing", f"{defects.missing}: each is to be [start, end]")
        X_WS = scenario_poses.pose(lidar.X_WS)
        self._lidar, self._defects, self._solids, self._seed = lidar, defects, solids, seed
        self._origin, self._ways = X_WS.translation(), beams(lidar) @ X_WS.rotation().matrix().T
        count = len(self._ways)
        self._poses = self.DeclareAbstractInputPort("body_poses", Value([RigidTransform()]))
        nothing: Any = np.concatenate([np.zeros(count), [NEVER]])
        self._taken, self._shown = self.DeclareDiscreteState(nothing), self.DeclareDiscreteState(nothing)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / lidar.rate, 0.0, self._scan)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / lidar.rate, lidar.latency, self._deliver)
        ticket = {self.discrete_state_ticket(self._shown)}
        self.DeclareVectorOutputPort("ranges", count, self._calc_ranges, ticket)
        self.DeclareVectorOutputPort("scan_time", 1, self._calc_time, ticket)

    def ranges(self, poses: list[RigidTransform], tick: int) -> Array:
        """Return what scan number `tick` measures of bodies at X_WB, by their index (rows · columns,) [m]."""
        true = scan(self._origin, self._ways, self._solids, poses)
        rng, defects = generator(self._seed, Stream.LIDAR, tick), self._defects
        noise, lost = rng.standard_normal(len(true)), rng.uniform(size=len(true)) < defects.dropout
        met = np.isfinite(true) & ~lost
        r = np.where(met, true, 0.0)
        measured = r + noise * np.hypot(defects.noise, defects.growth * r**2)
        near, far = self._lidar.range
        return np.where(met & (measured >= near) & (measured <= far), measured, 0.0)

    def _scan(self, context: Context, discrete: DiscreteValues) -> None:
        now = context.get_time()
        tick = round(now * self._lidar.rate)
        if tick == 0 or any(start <= now < end for start, end in self._defects.missing):
            return
        poses: Any = self._poses.Eval(context)
        discrete.set_value(int(self._taken), np.concatenate([self.ranges(poses, tick), [now]]))

    def _deliver(self, context: Context, discrete: DiscreteValues) -> None:
        discrete.set_value(int(self._shown), context.get_discrete_state(self._taken).value())

    def _calc_ranges(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(context.get_discrete_state(self._shown).value()[:-1])

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        output[0] = context.get_discrete_state(self._shown).value()[-1]


def add_lidar(builder: DiagramBuilder, world: WorldPlant, scenario: Scenario) -> dict[str, int]:
    """Add ``twin.lidar`` to a station, where there is one, and export its ports.

    Returns:
        Sizes of these ports by name.

    Raises:
        ScenarioError: it cannot be built, or another port has its name.
    """
    lidar = scenario.twin.lidar
    if lidar is None:
        return {}
    name = ports.lidar(lidar.name)
    system = builder.AddNamedSystem(
        name, LidarSystem(lidar, scenario.world.lidar_defects, world_solids(world), scenario.seed)
    )
    builder.Connect(world.plant.get_body_poses_output_port(), system.get_input_port())
    builder.ExportOutput(system.GetOutputPort("ranges"), name)
    builder.ExportOutput(system.GetOutputPort("scan_time"), ports.time_of(name))
    return {name: lidar.rows * lidar.columns, ports.time_of(name): 1}
