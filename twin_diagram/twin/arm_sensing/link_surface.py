"""Points on the surface of one rigid part of the arm, as its description shows it: what a depth camera sees of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.geometry import Box, Capsule, Convex, Cylinder, Ellipsoid, Mesh, Role, SceneGraph, Shape, Sphere
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from scipy.spatial import ConvexHull, QhullError

from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.scenario import ArmModel
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    spacing: float = 0.004
    """Of the points, on average [m]."""

    coarse: float = 0.01
    """Of the points of what else stands there [m]."""

    margin: float = 1e-6
    """Less than this below a shape's surface counts as on it: rounding, where faces of two shapes coincide [m]."""

    margin_share: float = 1e-4
    """The same of an ellipsoid, as a share of its axes."""


TUNING = Tuning()

Points = tuple[Array, Array]
"""Points (M, 3) [m] and outward normals (M, 3)."""


def link_surface(
    arm: ArmModel, link: str, packages: Mapping[str, str | Path] | None = None, spacing: float = TUNING.spacing
) -> Points:
    """Return the surface of a link and of all that is welded to it, in the link's frame.

    Of shapes that overlap only what lies outside the others is left.

    Args:
        arm: the description.
        link: name.
        packages: local folders for `package://` names.
        spacing: of the points [m].

    Raises:
        ModelError: there is no such link, or nothing to see of it.
    """
    scene_graph, plant = _loaded(arm, packages)
    points, normals = surface_of(scene_graph, plant, _named(plant, link, arm.model), spacing)
    if not len(points):
        raise ModelError(f"{link!r} in {arm.model} has no shape to be seen by")
    return points, normals


def other_surfaces(
    arm: ArmModel, link: str, packages: Mapping[str, str | Path] | None = None, spacing: float = TUNING.coarse
) -> dict[str, Points]:
    """Return the surfaces of an arm's other rigid parts, by a link of each: what else stands beside a link.

    Args:
        arm: the description.
        link: name of the one that is left out.
        packages: local folders for `package://` names.
        spacing: of the points [m].

    Raises:
        ModelError: there is no such link.
    """
    scene_graph, plant = _loaded(arm, packages)
    parts = other_parts(plant, _named(plant, link, arm.model))
    surfaces = {body.name(): surface_of(scene_graph, plant, body, spacing) for body in parts}
    return {name: surface for name, surface in surfaces.items() if len(surface[0])}


def other_parts(plant: MultibodyPlant, body: RigidBody) -> list[RigidBody]:
    """Return a body of each rigid part of a plant, in their order, but for that of one body and the world."""
    done = {int(other.index()) for other in plant.GetBodiesWeldedTo(body)}
    found: list[RigidBody] = []
    for index in range(1, plant.num_bodies()):  # 0 is the world
        if index not in done:
            found.append(plant.get_body(BodyIndex(index)))
            done |= {int(other.index()) for other in plant.GetBodiesWeldedTo(found[-1])}
    return found


def _loaded(arm: ArmModel, packages: Mapping[str, str | Path] | None) -> tuple[SceneGraph, MultibodyPlant]:
    scene_graph, plant = SceneGraph(), MultibodyPlant(0.0)
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    add_arm(plant, arm, packages)
    plant.Finalize()
    return scene_graph, plant


def _named(plant: MultibodyPlant, link: str, model: str) -> RigidBody:
    """Return the link of that name; raises ModelError where there is none, or several."""
    bodies = [plant.get_body(BodyIndex(index)) for index in range(plant.num_bodies())]
    found = [body for body in bodies if body.name() == link]
    if len(found) != 1:
        raise ModelError(
            f"{len(found)} links are called {link!r} in {model}" if found else f"no link {link!r} in {model}"
        )
    return found[0]


def surface_of(scene_graph: SceneGraph, plant: MultibodyPlant, body: RigidBody, spacing: float) -> Points:
    """Return what can be seen of a body of a finalized plant and of all that is welded to it, in the body's frame.

    Args:
        scene_graph: with the plant's shapes.
        plant: finalized.
        body: one of it.
        spacing: of the points [m].
    """
    context, inspector = plant.CreateDefaultContext(), scene_graph.model_inspector()
    X_BW = body.EvalPoseInWorld(context).inverse()
    shapes = []
    for each in plant.GetBodiesWeldedTo(body):
        frame, X_BL = plant.GetBodyFrameIdOrThrow(each.index()), X_BW @ each.EvalPoseInWorld(context)
        for geometry in inspector.GetGeometries(frame, Role.kIllustration):
            X_BG = X_BL @ inspector.GetPoseInFrame(geometry)
            hull = inspector.GetConvexHull(geometry)
            corners = None if hull is None else np.array([hull.vertex(i) for i in range(hull.num_vertices())])
            shapes.append((X_BG.rotation().matrix(), X_BG.translation(), inspector.GetShape(geometry), corners))
    rng = np.random.default_rng(0)
    points, normals = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for k, (R, p, shape, corners) in enumerate(shapes):
        p_G, n_G = shape_surface(shape, corners, spacing, rng)
        p_B = p_G @ R.T + p
        free = np.ones(len(p_B), dtype=bool)
        for other, (R_o, p_o, shape_o, corners_o) in enumerate(shapes):
            if other != k:
                free &= ~inside((p_B - p_o) @ R_o, shape_o, corners_o)
        points.append(p_B[free])
        normals.append((n_G @ R.T)[free])
    return np.concatenate(points), np.concatenate(normals)


def shape_surface(shape: Shape, corners: Array | None, spacing: float, rng: np.random.Generator) -> Points:
    """Return the points and normals of one shape, in its own frame, about one to every `spacing`².

    Args:
        shape: a mesh is taken as its convex hull.
        corners: (C, 3) of that hull.
        spacing: [m].
        rng: draws them.
    """
    if isinstance(shape, Box):
        return _box(np.asarray(shape.size(), dtype=float), spacing, rng)
    if isinstance(shape, Cylinder):
        side, caps = _tube(shape.radius(), shape.length(), spacing, rng), _caps(shape, spacing, rng)
        return np.concatenate([side[0], caps[0]]), np.concatenate([side[1], caps[1]])
    if isinstance(shape, Capsule):
        side = _tube(shape.radius(), shape.length(), spacing, rng)
        points, normals = _ball(np.full(3, shape.radius()), spacing, rng)
        points[:, 2] += np.where(normals[:, 2] > 0.0, 0.5, -0.5) * shape.length()
        return np.concatenate([side[0], points]), np.concatenate([side[1], normals])
    if isinstance(shape, Sphere):
        return _ball(np.full(3, shape.radius()), spacing, rng)
    if isinstance(shape, Ellipsoid):
        return _ball(np.array([shape.a(), shape.b(), shape.c()]), spacing, rng)
    if (hull := _convex(corners)) is not None:
        return _hull(hull, spacing, rng)
    return np.zeros((0, 3)), np.zeros((0, 3))


def inside(p: Array, shape: Shape, corners: Array | None) -> np.ndarray:
    """Return which of the points (N, 3), in the shape's frame, are within it by more than `TUNING.margin`."""
    margin = TUNING.margin
    if isinstance(shape, Box):
        return np.asarray(np.all(np.abs(p) < 0.5 * np.asarray(shape.size()) - margin, axis=1))
    if isinstance(shape, (Cylinder, Capsule)):
        r, half = shape.radius() - margin, 0.5 * shape.length()
        if isinstance(shape, Cylinder):
            return np.asarray((np.hypot(p[:, 0], p[:, 1]) < r) & (np.abs(p[:, 2]) < half - margin))
        return np.asarray(p[:, 0] ** 2 + p[:, 1] ** 2 + np.maximum(np.abs(p[:, 2]) - half, 0.0) ** 2 < r**2)
    if isinstance(shape, Sphere):
        return np.asarray(np.linalg.norm(p, axis=1) < shape.radius() - margin)
    if isinstance(shape, Ellipsoid):
        axes = np.array([shape.a(), shape.b(), shape.c()])
        return np.asarray(np.linalg.norm(p / axes, axis=1) < 1.0 - TUNING.margin_share)
    if isinstance(shape, (Mesh, Convex)) and (hull := _convex(corners)) is not None:
        planes = hull.equations
        return np.asarray(np.all(p @ planes[:, :3].T + planes[:, 3] < -margin, axis=1))
    return np.zeros(len(p), dtype=bool)


def _count(area: float, spacing: float) -> int:
    return int(np.ceil(area / spacing**2))


def _box(size: Array, spacing: float, rng: np.random.Generator) -> Points:
    points, normals = [], []
    for axis in range(3):
        across = [i for i in range(3) if i != axis]
        count = _count(float(np.prod(size[across])), spacing)
        for sign in (-1.0, 1.0):
            p = rng.uniform(-0.5, 0.5, (count, 3)) * size
            p[:, axis] = 0.5 * sign * size[axis]
            points.append(p)
            normals.append(np.broadcast_to(sign * np.eye(3)[axis], p.shape))
    return np.concatenate(points), np.concatenate(normals)


def _tube(radius: float, length: float, spacing: float, rng: np.random.Generator) -> Points:
    count = _count(2.0 * np.pi * radius * length, spacing)
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    normals = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
    points = radius * normals
    points[:, 2] = rng.uniform(-0.5, 0.5, count) * length
    return points, normals


def _caps(shape: Cylinder, spacing: float, rng: np.random.Generator) -> Points:
    count = 2 * _count(np.pi * shape.radius() ** 2, spacing)
    angle, r = rng.uniform(0.0, 2.0 * np.pi, count), shape.radius() * np.sqrt(rng.uniform(size=count))
    up = np.where(np.arange(count) % 2 == 0, 1.0, -1.0)
    points = np.stack([r * np.cos(angle), r * np.sin(angle), 0.5 * up * shape.length()], axis=1)
    return points, np.stack([np.zeros(count), np.zeros(count), up], axis=1)


def _ball(axes: Array, spacing: float, rng: np.random.Generator) -> Points:
    count = _count(4.0 * np.pi * float(np.max(axes)) ** 2, spacing)
    on_sphere = rng.normal(size=(count, 3))
    on_sphere /= np.linalg.norm(on_sphere, axis=1, keepdims=True)
    normals = on_sphere / axes
    return on_sphere * axes, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _convex(corners: Array | None) -> ConvexHull | None:
    """Return the hull of corners (C, 3); None of what is flat, as a label is: it has no inside, and hides nothing."""
    try:
        return None if corners is None else ConvexHull(corners)
    except QhullError:
        return None


def _hull(hull: ConvexHull, spacing: float, rng: np.random.Generator) -> Points:
    a, b, c = (hull.points[hull.simplices[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    which = rng.choice(len(area), size=_count(float(area.sum()), spacing), p=area / area.sum())
    s, t = rng.uniform(size=(2, len(which), 1))
    flip = s + t > 1.0
    s, t = np.where(flip, 1.0 - s, s), np.where(flip, 1.0 - t, t)
    return a[which] + s * (b - a)[which] + t * (c - a)[which], hull.equations[which, :3]
