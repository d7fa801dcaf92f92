"""Covers an arm with balls, from outside, so that a planned distance is never above the true one.

The cover of a box, and of a cylinder's side, reaches at most `Tuning.overhang` beyond it (a large box's somewhat more),
that of a capsule `Tuning.capsule_overhang`. Beyond a cylinder's flat ends it bulges by nearly its radius where that is
short: balls as wide as it would be many there.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
from pydrake.geometry import Capsule, Convex, Cylinder, GeometryId, Mesh, SceneGraph, SceneGraphInspector, Shape, Sphere
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import BodyIndex, PrismaticJoint, RigidBody
from pydrake.systems.framework import Diagram, DiagramBuilder

from twin_diagram import scenario
from twin_diagram.errors import ModelError
from twin_diagram.model.description import add_arm as description
from twin_diagram.model.description.followers import Followers
from twin_diagram.planning.collision.convex_solids import bounding_box
from twin_diagram.planning.collision.geometry_to_solids import moved, points_of
from twin_diagram.signals.arrays import Array, Ints


@dataclass(frozen=True)
class Tuning:
    """Constants of the cover, chosen by hand between room lost beside the arm and the time of a tick.

    More balls cost time in proportion; `sims/closed_loop.py --seeds 20` shows where the arm gets through.
    """

    overhang: float = 0.013
    """A ball reaches no farther than this beyond a box, or a cylinder's side, that it covers [m]."""

    capsule_overhang: float = 0.004
    """Nor than this beyond a capsule, which few balls cover closely [m]."""

    most_cells: int = 36
    """Balls that cover one box, at most."""

    bone: float = 0.05
    """Radius of an arm without shapes, as a share of its length: that of slender arms."""

    widest: float = 20.0
    """What spans more than this [m] is no link but a mesh in mm: in these a finger of 2 cm spans as much."""

    turns: int = 17
    """Places of a gripper whose joints turn at which it is looked at: at 10 cm and over 1.5 rad the way between two of
    them leaves the line by 0.1 mm."""

    few_shapes: int = 6
    """Each shape of a link counts as a part of its own, but not where a link has more of them than this."""


TUNING = Tuning()


@dataclass(frozen=True)
class Balls:
    """The arm, as balls on its links; S balls.

    Attributes:
        centres_L: (S, 3) in the frame of the link that each moves with [m].
        radii: (S,) [m]
        links: (S,) ints, 1..n: the number of arm joints that carry it.
        groups: (S,) ints: which shape, or part of a long box, each belongs to.
        pairs: (P, 2) ints: pairs of balls that may touch each other and must not.
    """

    centres_L: Array
    radii: Array
    links: Ints
    groups: Ints
    pairs: Ints


def arm_plant(
    spec: scenario.ArmModel, packages: Mapping[str, str | Path] | None = None
) -> tuple[MultibodyPlant, SceneGraph, description.Arm, Diagram]:
    """Return an arm with its collision geometry.

    Plant, scene graph, where the arm is, and the diagram that owns them.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    arm = description.add_arm(plant, spec, packages, looked_at=False)
    plant.Finalize()
    return plant, scene_graph, arm, builder.Build()


def arm_balls(
    plant: MultibodyPlant,
    scene_graph: SceneGraph,
    arm: description.Arm,
    depth: Ints,
    fingers: float = TUNING.overhang,
) -> Balls:
    """Cover the arm's collision shapes with balls.

    What moves with the gripper's joints is covered wherever these joints may put it: the twin's planner is not told the
    fingers' position. What stands still with the base is left out, for it cannot be moved out of the way.

    Args:
        plant: of `arm_plant`.
        scene_graph: its geometry.
        arm: where the arm is in the plant.
        depth: of `chain.depths`.
        fingers: how far balls may reach beyond what moves with the gripper's joints [m].
    """
    inspector = scene_graph.model_inspector()
    link_pose = _link_poses(plant, arm, depth)
    centres, radii, links, groups, ids = [], [], [], [], []
    group = 0
    for index in range(plant.num_bodies()):
        body = plant.get_body(BodyIndex(index))
        k = int(depth[index])
        if k == 0:
            continue
        X_LBs = link_pose(body)
        geometries = plant.GetCollisionGeometriesForBody(body)
        for geometry in geometries:
            X_BG = inspector.GetPoseInFrame(geometry).GetAsMatrix4()
            _refuse_too_wide(inspector, geometry, f"{arm.spec.model}: link {body.name()!r}")
            for c, r, part in _cover(inspector, geometry, [X_LB @ X_BG for X_LB in X_LBs], fingers):
                centres.append(c)
                radii.append(r)
                links.append(k)
                groups.append(group + part)
                ids.append(geometry)
            if len(geometries) <= TUNING.few_shapes:
                group = max(groups, default=0) + 1
        group = max(groups, default=0) + 1
    if not centres:
        logging.getLogger("twin_diagram").warning(
            "%s has no collision geometry: balls along the lines between its joints stand for it", arm.spec.model
        )
        return _skeleton(plant, arm)
    keep = _not_swallowed(np.array(centres), np.array(radii), np.array(links))
    pairs = [
        (i, j)
        for i, j in product(range(len(keep)), repeat=2)
        if i < j and links[keep[i]] != links[keep[j]] and not inspector.CollisionFiltered(ids[keep[i]], ids[keep[j]])
    ]
    return Balls(
        np.array(centres)[keep],
        np.array(radii)[keep],
        np.array(links)[keep],
        np.array(groups)[keep],
        np.array(pairs, dtype=int).reshape(-1, 2),
    )


def _skeleton(plant: MultibodyPlant, arm: description.Arm) -> Balls:
    """Cover the lines from joint to joint, and on to the tool, of an arm that has no shapes; nothing touches itself."""
    context = plant.CreateDefaultContext()
    frames = [plant.get_joint(index).child_body().body_frame() for index in arm.joint_indices]
    X_WLs = [frame.CalcPoseInWorld(context) for frame in frames]
    ends = [X_WL.translation() for X_WL in X_WLs[1:]]
    ends.append(plant.get_frame(arm.tool_frame).CalcPoseInWorld(context).translation())
    begins = [X_WL.translation() for X_WL in X_WLs]
    lengths = [float(np.linalg.norm(end - begin)) for begin, end in zip(begins, ends, strict=True)]
    radius = max(TUNING.bone * sum(lengths), TUNING.overhang)
    centres, links = [], []
    for k, (X_WL, end, length) in enumerate(zip(X_WLs, ends, lengths, strict=True)):
        tip = X_WL.inverse().multiply(end)
        count = 1 + int(np.ceil(length / radius))
        centres.append(np.linspace(np.zeros(3), tip, count))
        links.append(np.full(count, k + 1))
    numbers = np.concatenate(links)
    no_pairs = np.zeros((0, 2), dtype=int)
    return Balls(np.concatenate(centres), np.full(len(numbers), radius), numbers, numbers - 1, no_pairs)


def _link_poses(plant: MultibodyPlant, arm: description.Arm, depth: Ints) -> Callable[[RigidBody], list[Array]]:
    """Answer, for a body, its poses in the link that carries it: one, or some from end to end of the gripper's travel.

    Where all joints slide the ends are enough.
    """
    followers = Followers.of(plant, arm)
    joints = [plant.get_joint(index) for index in arm.gripper_joint_indices]
    where = [joint.position_start() for joint in joints]
    limits = np.array([[j.position_lower_limits()[0], j.position_upper_limits()[0]] for j in joints]).reshape(-1, 2)
    low, high = np.where(np.isfinite(limits), limits, 0.0).T
    slide = all(isinstance(joint, PrismaticJoint) for joint in (*joints, *followers.joints))
    contexts = []
    for share in np.linspace(0.0, 1.0, 2 if slide else TUNING.turns):
        context = plant.CreateDefaultContext()
        q = plant.GetPositions(context).copy()
        q[where] = low + share * (high - low)
        followers.follow(q)
        plant.SetPositions(context, q)
        contexts.append(context)

    def poses(body: RigidBody) -> list[Array]:
        k = int(depth[int(body.index())])
        link = plant.get_joint(arm.joint_indices[k - 1]).child_body()
        each = [
            np.linalg.solve(
                plant.EvalBodyPoseInWorld(context, link).GetAsMatrix4(),
                plant.EvalBodyPoseInWorld(context, body).GetAsMatrix4(),
            )
            for context in contexts
        ]
        return each[:1] if np.allclose(each, each[0], atol=1e-12) else each

    return poses


def _refuse_too_wide(inspector: SceneGraphInspector, geometry: GeometryId, whose: str) -> None:
    """Refuse a mesh that spans more than any link does; raises ModelError."""
    if not isinstance(inspector.GetShape(geometry), (Mesh, Convex)):
        return
    span = float(np.ptp(points_of(inspector, geometry), axis=0).max())
    if span > TUNING.widest:
        raise ModelError(
            f'{whose}: its collision mesh spans {span:.3g} m; where it is in mm, name it with scale="0.001 0.001 0.001"'
        )


def _cover(
    inspector: SceneGraphInspector, geometry: GeometryId, X_LGs: list[Array], fingers: float
) -> list[tuple[Array, float, int]]:
    """Return balls (centre in L, radius, part) that hold a shape, in one pose or in all between some."""
    shape = inspector.GetShape(geometry)
    if len(X_LGs) == 1 and isinstance(shape, (Sphere, Capsule, Cylinder)):
        balls = _round_cover(shape)
        X_LG = X_LGs[0]
        return [(X_LG[:3, :3] @ c + X_LG[:3, 3], r, 0) for c, r in balls]
    # A box about the shape, in the axes it has at the first end, around where it is in all.
    points = points_of(inspector, geometry)
    X_GL = np.linalg.inv(X_LGs[0])
    swept = np.concatenate([moved(X_GL @ X_LG, points) for X_LG in X_LGs])
    box = bounding_box(swept)
    return [
        (X_LGs[0][:3, :3] @ (c + box.p_GB) + X_LGs[0][:3, 3], r, part)
        for c, r, part in box_cover(2 * box.half, TUNING.overhang if len(X_LGs) == 1 else fingers)
    ]


def _round_cover(shape: Shape) -> list[tuple[Array, float]]:
    if isinstance(shape, Sphere):
        return [(np.zeros(3), shape.radius())]
    radius, length = shape.radius(), shape.length()
    if isinstance(shape, Capsule):
        grown = radius + min(TUNING.capsule_overhang, 0.2 * radius)
        spacing = 2 * np.sqrt(grown**2 - radius**2)
        count = int(np.ceil(length / spacing - 1e-9)) + 1
        grown = float(np.hypot(radius, length / (count - 1) / 2)) if count > 1 else radius
        return [(np.array([0.0, 0.0, z]), grown) for z in np.linspace(-length / 2, length / 2, count)]
    # A cylinder: slices, each in a ball through its rims.
    count = int(np.ceil(length / (2 * np.sqrt((radius + TUNING.overhang) ** 2 - radius**2)) - 1e-9))
    half = length / count / 2
    return [
        (np.array([0.0, 0.0, -length / 2 + half * (2 * i + 1)]), float(np.hypot(radius, half))) for i in range(count)
    ]


def box_cover(size: Array, overhang: float) -> list[tuple[Array, float, int]]:
    """Return balls (centre, radius, part) that hold a box of edge lengths `size` about the origin.

    One ball about each cell of a grid, as coarse as the overhang beyond the faces allows, but of `Tuning.most_cells`
    at most: the cover of a large box reaches farther beyond it. `part` numbers the pieces along the longest edge.
    """
    size = np.asarray(size, dtype=float)
    counts = _grids()
    cells = size / counts
    beyond = np.linalg.norm(cells, axis=1) / 2 - cells.min(axis=1) / 2
    # Fewest cells where the overhang is kept, else the smallest overhang that the number of cells allows.
    best = np.lexsort((beyond, counts.prod(axis=1), np.where(beyond <= overhang, 0, beyond)))[0]
    counts = counts[best]
    cell = size / counts
    radius = float(np.linalg.norm(cell) / 2)
    longest = int(np.argmax(size))
    parts = max(1, round(size[longest] / 0.08))
    return [
        ((np.array(index) + 0.5) * cell - size / 2, radius, index[longest] * parts // counts[longest])
        for index in product(*map(range, counts))
    ]


@cache
def _grids() -> Ints:
    """Return (C, 3) cells along each edge, in all ways of at most `Tuning.most_cells` cells."""
    each = range(1, TUNING.most_cells + 1)
    grids = [
        (x, y, z) for x in each for y in each[: TUNING.most_cells // x] for z in each[: TUNING.most_cells // x // y]
    ]
    return np.array(grids)


def _not_swallowed(centres: Array, radii: Array, links: Array) -> list[int]:
    """Return the indices of the balls that lie in no other ball of their link."""
    keep: list[int] = []
    for i in range(len(radii)):
        far = np.linalg.norm(centres - centres[i], axis=1) + radii[i]
        inside = (far <= radii + 1e-9) & (links == links[i])
        inside[i] = False
        # Of two equal balls the first stays.
        twins = inside & (np.abs(radii - radii[i]) < 1e-9)
        if not (inside & ~twins).any() and not twins[:i].any():
            keep.append(i)
    return keep
