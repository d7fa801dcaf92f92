"""Turns collision geometry that stands still into convex solids, and any shape into points around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydrake.geometry import (
    Box as BoxShape,
)
from pydrake.geometry import (
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    GeometryId,
    HalfSpace,
    Mesh,
    SceneGraph,
    SceneGraphInspector,
    Sphere,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody

from twin_diagram import scenario
from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.model.description.fixtures import add_fixture
from twin_diagram.planning.collision.convex_solids import Ball, Box, Polytope, Solid, solid_of
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """How round and endless shapes become polytopes; chosen by hand."""

    sides: int = 24
    """Sides of the prism around a cylinder: its corners stand out by 0.9 % of the radius."""

    half_space: float = 10.0
    """Half the edge of the box that stands for a half space [m]: farther than any arm reaches."""


TUNING = Tuning()


def fixture_solids(
    fixtures: Sequence[scenario.Fixture], packages: Mapping[str, str | Path] | None = None
) -> list[tuple[str, list[Solid]]]:
    """Return what stands still, as convex solids in W, by name.

    Raises:
        ModelError: a model cannot be read, or something in it can move.
    """
    result: list[tuple[str, list[Solid]]] = []
    for fixture in fixtures:
        plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
        plant.RegisterAsSourceForSceneGraph(scene_graph)
        add_fixture(plant, fixture, packages)
        plant.Finalize()
        if plant.num_positions():
            raise ModelError(
                f"{fixture.model}: a fixture stands still, but this model has {plant.num_positions()} free positions"
            )
        bodies = [plant.get_body(BodyIndex(index)) for index in range(plant.num_bodies())]
        result.append((Path(fixture.model).stem, _standing(plant, scene_graph, bodies)))
    return result


def world_solids(plant: MultibodyPlant, scene_graph: SceneGraph) -> list[Solid]:
    """Return what a description puts into the world itself, as an MJCF's floor or pillar, as convex solids in W.

    Args:
        plant: finalized; holds the description alone.
        scene_graph: its geometry.
    """
    return _standing(plant, scene_graph, [plant.world_body()])


def given_solids(
    arm: scenario.ArmModel,
    fixtures: Sequence[scenario.Fixture],
    packages: Mapping[str, str | Path] | None = None,
) -> list[tuple[str, list[Solid]]]:
    """Return the solids of fixtures, by name, and of what the arm's description puts into the world, if anything.

    Raises:
        ModelError: see `fixture_solids` and `add_arm.add_arm`.
    """
    plant, scene_graph = MultibodyPlant(0.0), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    spec = add_arm(plant, arm, packages, looked_at=False).spec
    plant.Finalize()
    own = world_solids(plant, scene_graph)
    return [*fixture_solids(fixtures, packages), *([(Path(spec.model).stem, own)] if own else [])]


def _standing(plant: MultibodyPlant, scene_graph: SceneGraph, bodies: Sequence[RigidBody]) -> list[Solid]:
    """Return the shapes of bodies, as the plant starts, as convex solids in W."""
    context = plant.CreateDefaultContext()
    inspector = scene_graph.model_inspector()
    solids: list[Solid] = []
    for body in bodies:
        X_WF = plant.EvalBodyPoseInWorld(context, body).GetAsMatrix4()
        for geometry in plant.GetCollisionGeometriesForBody(body):
            X_WG = X_WF @ inspector.GetPoseInFrame(geometry).GetAsMatrix4()
            solids.extend(_solids(inspector, geometry, X_WG))
    return solids


def _solids(inspector: SceneGraphInspector, geometry: GeometryId, X_WG: Array) -> list[Solid]:
    shape = inspector.GetShape(geometry)
    R, p = X_WG[:3, :3], X_WG[:3, 3]
    if isinstance(shape, Sphere):
        return [Ball(p, shape.radius())]
    if isinstance(shape, BoxShape):
        return [Box(np.asarray(shape.size()) / 2, R, p)]
    if isinstance(shape, HalfSpace):
        deep = np.full(3, TUNING.half_space)
        return [Box(deep, R, p - R[:, 2] * TUNING.half_space)]
    if isinstance(shape, Capsule):
        ends = [Ball(p + R[:, 2] * z, shape.radius()) for z in (-shape.length() / 2, shape.length() / 2)]
        return [*ends, Polytope(moved(X_WG, _prism(shape.radius(), shape.length())))]
    return [solid_of(moved(X_WG, points_of(inspector, geometry)))]


def points_of(inspector: SceneGraphInspector, geometry: GeometryId) -> Array:
    """Return the points whose convex hull holds a shape."""
    shape = inspector.GetShape(geometry)
    if isinstance(shape, BoxShape):
        return Box(np.asarray(shape.size()) / 2, np.eye(3), np.zeros(3)).vertices
    if isinstance(shape, Cylinder):
        return _prism(shape.radius(), shape.length())
    if isinstance(shape, (Mesh, Convex)):
        hull = inspector.GetConvexHull(geometry)
        return np.array([hull.vertex(i) for i in range(hull.num_vertices())])
    if isinstance(shape, Sphere):
        return Box(np.full(3, shape.radius()), np.eye(3), np.zeros(3)).vertices
    if isinstance(shape, Capsule):
        return _prism(shape.radius(), shape.length() + 2 * shape.radius())
    if isinstance(shape, Ellipsoid):
        return Box(np.array([shape.a(), shape.b(), shape.c()]), np.eye(3), np.zeros(3)).vertices
    raise ModelError(f"{inspector.GetName(geometry)}: a {type(shape).__name__} cannot be planned around")


def moved(X: Array, points: Array) -> Array:
    """Return the points (V, 3) turned and shifted by X (4, 4)."""
    return points @ X[:3, :3].T + X[:3, 3]


def _prism(radius: float, length: float) -> Array:
    """Return corners of a regular prism around a cylinder about z."""
    angle = (np.arange(TUNING.sides) + 0.5) * 2 * np.pi / TUNING.sides
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius / np.cos(np.pi / TUNING.sides)
    return np.concatenate([np.insert(ring, 2, z, axis=1) for z in (-length / 2, length / 2)])
