"""Distances of the arm to all around it, by Drake's own queries on the shapes of descriptions and assets.

Nothing of the planner's cover of balls or of its solids is used: what stops the arm must not share its faults.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, cast

import numpy as np
import numpy.typing as npt
from pydrake.geometry import (
    Box,
    CollisionFilterDeclaration,
    Convex,
    FramePoseVector,
    GeometryFrame,
    GeometryId,
    GeometryInstance,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    SceneGraph,
    SceneGraphInspector,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import RigidBody
from pydrake.systems.framework import DiagramBuilder

from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.model.description import add_arm as description
from twin_diagram.model.description.fixtures import add_fixture
from twin_diagram.model.description.followers import Followers
from twin_diagram.planning.braking.stop_check import Nearness
from twin_diagram.planning.collision.geometry_to_solids import points_of
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.pose_vectors import as_matrix

Booleans = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    away: float = -50.0
    """Where what is not there waits: z in W [m]; they stand metres apart along x."""

    half_space: float = 10.0
    """Half the edge of the box that stands for a half space, which Drake tells no distances of [m]."""


TUNING = Tuning()

ARM: Final = -1
"""Owner of a shape of the arm, among bodies."""


@dataclass(frozen=True)
class Shapes:
    """What slots hold, and what the hand does.

    Attributes:
        present: (S,) which slots are filled: the library's objects, then further instances, then unknown things.
        assets: of each further instance which of the library's objects it is like.
        things: of each unknown thing the corners (V, 3) of its convex pieces in W [m].
        held: the library's object in the hand, or `ARM`.
        X_TO: (7) of that in the tool's frame.
        on_support: what is held may touch what stands still, and …
        support: … the library's object that bears it, or `ARM`.
        unsure: what is held may be so much nearer to everything than where it is told to be [m].
    """

    present: Booleans
    assets: Sequence[int]
    things: Sequence[Sequence[Array]]
    held: int = ARM
    X_TO: Array | None = None
    on_support: bool = False
    support: int = ARM
    unsure: float = 0.0


class DrakeDistances:
    """The arm, fixtures, the library's objects, and slots for what comes: a plant with a SceneGraph, and one Context.

    That Context is scratch: `surround` and `near` overwrite all of it that they use.

    Attributes:
        names: of the bodies that the arm may meet, in order: fixtures, then slots.
        parts: names of the arm's links, by the index of a body in the plant.
        fixture_count, object_count, further_count, thing_count: of the slots' kinds, in their order.
        finger_count: g.
    """

    def __init__(
        self,
        spec: scenario.ArmModel,
        fixtures: Sequence[scenario.Fixture],
        library: Mapping[str, Asset],
        further: int,
        things: int,
        packages: Mapping[str, str | Path] | None = None,
    ) -> None:
        """Read all shapes; `further` and `things` are how many slots there are.

        Raises:
            ModelError: a shape that cannot be read.
        """
        builder = DiagramBuilder()
        self._plant, self._scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        self._arm: Final = description.add_arm(self._plant, spec, packages, looked_at=False)
        welded = [add_fixture(self._plant, fixture, packages) for fixture in fixtures]
        self._plant.Finalize()
        self._source = self._scene_graph.RegisterSource("around")
        count = len(library) + further + things
        self._frames: Final = [
            self._scene_graph.RegisterFrame(self._source, GeometryFrame(f"slot{k}")) for k in range(count)
        ]
        unnamed = (*("another object" for _ in range(further)), *("an unknown thing" for _ in range(things)))
        # What an MJCF puts into the world itself, a floor or a pillar, stands there as a fixture does.
        own_world = [self._plant.world_body()]
        if self._plant.GetCollisionGeometriesForBody(own_world[0]):
            welded.append(own_world)
        still = [*(fixture.model for fixture in fixtures), self._arm.spec.model][: len(welded)]
        self.names: Final = (*(Path(name).stem for name in still), *library, *unnamed)
        self._pieces: Final = [_pieces(asset) for asset in library.values()]
        self._farthest: Final = [_farthest(pieces) for pieces in self._pieces]
        self.fixture_count: Final = len(welded)
        self.object_count, self.further_count, self.thing_count = len(library), further, things
        self._further: Final = slice(len(library), len(library) + further)
        self._sort_shapes(welded)
        self.parts: Final = {int(body.index()): body.name() for body in self._moving}
        self._diagram = builder.Build()
        root = self._diagram.CreateDefaultContext()
        self._root = root
        self._context = self._plant.GetMyMutableContextFromRoot(root)
        self._shapes = self._scene_graph.GetMyMutableContextFromRoot(root)
        self._poses = self._scene_graph.get_source_pose_port(self._source)
        self._positions: Final = np.array(self._plant.GetPositions(self._context))
        joints = [self._plant.get_joint(index) for index in self._arm.joint_indices]
        self._q_index: Final = np.array([joint.position_start() for joint in joints])
        self._v_index: Final = np.array([joint.velocity_start() for joint in joints])
        fingers = [self._plant.get_joint(index) for index in self._arm.gripper_joint_indices]
        self._finger_index: Final = np.array([joint.position_start() for joint in fingers], dtype=int)
        self.finger_count: Final = len(fingers)
        self._followers: Final = Followers.of(self._plant, self._arm)
        self._hung: list[tuple[int, list[GeometryId]]] = [(0, []) for _ in range(count)]
        self._filtered: tuple[int, bool, int] | None = None
        self._held, self._X_TO, self._unsure = ARM, np.eye(4), 0.0
        for k, pieces in enumerate(self._pieces):
            self._hang(k, k + 1, pieces)

    def _sort_shapes(self, welded: Sequence[Sequence[RigidBody]]) -> None:
        """Note which shape is whose, and let the arm meet what is not the arm, and nothing else meet anything."""
        plant = self._plant
        inspector = self._scene_graph.model_inspector()
        own = [plant.get_body(b) for instance in self._arm.instances for b in plant.GetBodyIndices(instance)]
        fixed = {int(body.index()) for body in plant.GetBodiesWeldedTo(plant.world_body())}
        self._moving = [body for body in own if int(body.index()) not in fixed]
        self._owner: dict[GeometryId, int] = {}
        self._link_of: dict[GeometryId, int] = {}
        balls, in_link = [], []
        for body in self._moving:
            for shape in plant.GetCollisionGeometriesForBody(body):
                self._owner[shape], self._link_of[shape] = ARM, int(body.index())
                centre, radius = _ball(inspector, shape)
                X_BG = inspector.GetPoseInFrame(shape).GetAsMatrix4()
                in_link.append(X_BG)
                balls.append([*(X_BG[:3, :3] @ centre + X_BG[:3, 3]), radius])
        self._balls = np.array(balls).reshape(-1, 4)
        self._in_link = np.array(in_link).reshape(-1, 4, 4)
        for k, bodies in enumerate(welded):
            for body in bodies:
                for shape in plant.GetCollisionGeometriesForBody(body):
                    self._owner[shape] = k
                    _bounded(self._scene_graph, plant, inspector, shape)
        self._arm_shapes = list(self._link_of)
        self._number = {shape: k for k, shape in enumerate(self._arm_shapes)}
        numbers = [int(body.index()) for body in self._moving]
        self._row_of = np.array([numbers.index(link) for link in self._link_of.values()], dtype=int)
        self._last_row = numbers.index(int(self._arm.last_link))
        self._links = np.array(numbers)
        self._still_shapes = [shape for shape, owner in self._owner.items() if owner >= 0]
        based = [g for b in own if int(b.index()) in fixed for g in plant.GetCollisionGeometriesForBody(b)]
        everything = GeometrySet([*self._arm_shapes, *self._still_shapes, *based])
        rules = CollisionFilterDeclaration().ExcludeWithin(GeometrySet(self._arm_shapes))
        rules = rules.ExcludeWithin(GeometrySet(self._still_shapes)).ExcludeBetween(GeometrySet(based), everything)
        self._scene_graph.collision_filter_manager().Apply(rules)
        self._based = based

    def add_asset(self, asset: Asset) -> None:
        """Take in the pieces of an asset that came later; its number follows those of the ones before."""
        self._pieces.append(_pieces(asset))
        self._farthest.append(_farthest(self._pieces[-1]))

    def surround(self, around: Shapes) -> None:
        """Put everything where it is now; what a slot holds is shaped anew where it changed."""
        for k, asset in enumerate(around.assets):
            slot = self._further.start + k
            if around.present[slot]:
                self._hang(slot, int(asset) + 1, self._pieces[int(asset)])
        for k, pieces in enumerate(around.things):
            slot = self._further.stop + k
            if around.present[slot]:
                self._hang(slot, zlib.crc32(b"".join(piece.tobytes() for piece in pieces)) + 1, pieces)
        self.hold(around.held, around.X_TO)
        self._unsure = around.unsure if around.held != ARM else 0.0
        touched = around.on_support, around.support
        if self._filtered != (around.held, *touched):
            self._filter(around.held, *touched)

    def hold(self, held: int, X_TO: Array | None) -> None:
        """Put an object of the library into the hand at X_TO (7), or with `ARM` nothing: for `speed` that is enough."""
        self._held = held
        if held != ARM:
            self._X_TO = as_matrix(cast(Array, X_TO))

    def near(
        self, q: Array, v: Array, fingers: Array | None, present: Booleans, X_WO: Array, within: float
    ) -> Nearness:
        """Return what is within a distance of the arm.

        Args:
            q: (n,) the arm's joints [rad].
            v: (n,) their speeds, those that count as full [rad/s].
            fingers: (g,) where they are [m]; None: as described.
            present: (S,) which slots are filled.
            X_WO: (S, 4, 4) where their frames are.
            within: [m]
        """
        self._move(q, v, fingers)
        poses_ = FramePoseVector()
        for k, frame in enumerate(self._frames):
            if k == self._held:
                X = RigidTransform(self._tool() @ self._X_TO)
            elif present[k]:
                X = RigidTransform(X_WO[k])
            else:
                X = RigidTransform(np.array([float(k), 0.0, TUNING.away]))
            poses_.set_value(frame, X)
        self._poses.FixValue(self._shapes, poses_)
        query: Any = self._scene_graph.get_query_output_port().Eval(self._shapes)
        return self._pairs(query.ComputeSignedDistancePairwiseClosestPoints(within + self._unsure))

    def tool(self, q: Array) -> Array:
        """Return X_WT (4, 4) of the tool frame."""
        self._move(q, np.zeros(len(q)), None)
        return self._tool()

    def speed(self, q: Array, v: Array) -> float:
        """Return how fast any point of the arm, and of what it holds, moves [m/s]."""
        self._move(q, v, None)
        return float(self._speeds().max(initial=0.0))

    def _move(self, q: Array, v: Array, fingers: Array | None) -> None:
        positions, velocities = self._positions.copy(), np.zeros(self._plant.num_velocities())
        positions[self._q_index], velocities[self._v_index] = q, v
        if fingers is not None:
            positions[self._finger_index] = fingers
        self._followers.follow(positions)
        self._plant.SetPositions(self._context, cast(Any, positions))
        self._plant.SetVelocities(self._context, cast(Any, velocities))
        twists = [self._plant.EvalBodySpatialVelocityInWorld(self._context, body) for body in self._moving]
        self._spin = np.array([V.rotational() for V in twists])
        self._fast = np.array([V.translational() for V in twists])
        self._X_WB = np.array([self._plant.EvalBodyPoseInWorld(self._context, b).GetAsMatrix4() for b in self._moving])

    def _tool(self) -> Array:
        frame = self._plant.get_frame(self._arm.tool_frame)
        return np.asarray(frame.CalcPoseInWorld(self._context).GetAsMatrix4())

    def _speeds(self) -> Array:
        """Return (shapes + 1,) a bound on the speed of each shape's points, and last of those of what is held [m/s]."""
        rows = self._row_of
        arms = np.einsum("kij,kj->ki", self._X_WB[rows, :3, :3], self._balls[:, :3])
        spin = self._spin[rows]
        fast = np.linalg.norm(self._fast[rows] + _cross(spin, arms), axis=1)
        result = np.zeros(len(rows) + 1)
        result[:-1] = fast + np.linalg.norm(spin, axis=1) * self._balls[:, 3]
        if self._held != ARM:
            last = self._last_row
            middle = (self._tool() @ self._X_TO)[:3, 3] - self._X_WB[last, :3, 3]
            fast_held = np.linalg.norm(self._fast[last] + _cross(self._spin[last], middle))
            result[-1] = fast_held + np.linalg.norm(self._spin[last]) * self._farthest[self._held]
        return result

    def _pairs(self, found: Sequence[Any]) -> Nearness:
        held = self.fixture_count + self._held if self._held != ARM else None
        shapes: list[int] = []
        others: list[int] = []
        rows: list[Array] = []
        for pair in found:
            mine = [self._owner[shape] in (ARM, held) for shape in (pair.id_A, pair.id_B)]
            if mine[0] == mine[1]:
                continue
            own, other, p, sign = (pair.id_A, pair.id_B, pair.p_ACa, 1.0) if mine[0] else (
                pair.id_B, pair.id_A, pair.p_BCb, -1.0
            )  # fmt: skip
            shapes.append(self._number.get(own, -1))
            others.append(self._owner[other])
            # nhat points from B to A: moving A along it, or B against it, makes room.
            rows.append(np.concatenate([[pair.distance], p, sign * pair.nhat_BA_W]))
        numbers, told = np.array(shapes, dtype=int), np.array(rows).reshape(-1, 7)
        X_WG = np.empty((len(numbers), 4, 4))
        if len(numbers):
            on_arm = numbers >= 0
            X_WG[on_arm] = self._X_WB[self._row_of[numbers[on_arm]]] @ self._in_link[numbers[on_arm]]
            X_WG[~on_arm] = self._tool() @ self._X_TO
        links = np.where(numbers >= 0, self._row_of[numbers], self._last_row)
        p_W = np.einsum("kij,kj->ki", X_WG[:, :3, :3], told[:, 1:4]) + X_WG[:, :3, 3]
        fast = self._fast[links] + _cross(self._spin[links], p_W - self._X_WB[links, :3, 3])
        approach = -np.einsum("kj,kj->k", told[:, 4:], fast)
        distance = told[:, 0] - self._unsure * (numbers < 0)
        return Nearness(self._links[links], np.array(others, dtype=int), distance, approach, self._speeds()[numbers])

    def _hang(self, slot: int, mark: int, pieces: Sequence[Array]) -> None:
        """Give a slot the shape of convex pieces (V, 3) each, unless it has that already."""
        if self._hung[slot][0] == mark:
            return
        for shape in self._hung[slot][1]:
            self._scene_graph.RemoveGeometry(self._shapes, self._source, shape)
            del self._owner[shape]
        shapes = []
        for k, corners in enumerate(pieces):
            hull = Convex(points=np.asarray(corners).T, label=f"slot{slot}")
            instance = GeometryInstance(RigidTransform(), hull, f"{mark}/{k}")
            instance.set_proximity_properties(ProximityProperties())
            shape = self._scene_graph.RegisterGeometry(self._shapes, self._source, self._frames[slot], instance)
            self._owner[shape] = self.fixture_count + slot
            shapes.append(shape)
        self._hung[slot] = mark, shapes
        self._filtered = None

    def _filter(self, held: int, on_support: bool, support: int) -> None:
        """Let the arm, and what it holds, meet all that is not the arm; what it holds not the arm's own shapes."""
        slots = [shape for _, shapes in self._hung for shape in shapes]
        others = GeometrySet([*slots, *self._still_shapes])
        arm = GeometrySet(self._arm_shapes)
        rules = CollisionFilterDeclaration().AllowBetween(arm, GeometrySet(slots)).ExcludeWithin(others)
        rules = rules.ExcludeBetween(GeometrySet(self._based), others)
        if held != ARM:
            mine = GeometrySet(self._hung[held][1])
            free = (held, support) if on_support else (held,)
            rest = [shape for k, (_, shapes) in enumerate(self._hung) for shape in shapes if k not in free]
            if not on_support:
                rest += self._still_shapes
            rules = rules.ExcludeBetween(mine, arm).AllowBetween(mine, GeometrySet(rest))
        self._scene_graph.collision_filter_manager(self._shapes).Apply(rules)
        self._filtered = held, on_support, support


def _cross(a: Array, b: Array) -> Array:
    """Return cross products of vectors of one shape (…, 3); `np.cross` takes several times longer for so few."""
    (x, y, z), (p, q, r) = (tuple(part[..., k] for k in range(3)) for part in (a, b))
    result = np.empty(np.shape(x) + (3,))
    result[..., 0], result[..., 1], result[..., 2] = y * r - z * q, z * p - x * r, x * q - y * p
    return result


def _pieces(asset: Asset) -> tuple[Array, ...]:
    return tuple(np.asarray(piece, float) for piece in asset.convex_pieces)


def _farthest(pieces: Sequence[Array]) -> float:
    """Return how far the farthest corner of convex pieces (V, 3) is from their frame's origin [m]."""
    return max((float(np.linalg.norm(piece, axis=1).max()) for piece in pieces), default=0.0)


def _ball(inspector: SceneGraphInspector, shape: GeometryId) -> tuple[Array, float]:
    """Return a ball about a shape, in its own frame: centre and radius [m]."""
    points = points_of(inspector, shape)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def _bounded(scene_graph: SceneGraph, plant: MultibodyPlant, inspector: SceneGraphInspector, shape: GeometryId) -> None:
    """Put a large box in the place of a half space."""
    if isinstance(inspector.GetShape(shape), HalfSpace):
        far = TUNING.half_space
        X_FG = inspector.GetPoseInFrame(shape) @ RigidTransform(np.array([0.0, 0.0, -far]))
        scene_graph.ChangeShape(plant.get_source_id(), shape, Box(2 * far, 2 * far, 2 * far), X_FG)
