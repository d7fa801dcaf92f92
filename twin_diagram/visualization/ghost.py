"""Makes the twin's scene look like a ghost, so that it can stand in the same picture as the real one.

The colours are changed in the SceneGraph itself, before its Context is made: every viewer then shows them, live or
recorded, however late it loads the meshes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, cast

import numpy as np
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    GeometryId,
    GeometryInstance,
    IllustrationProperties,
    InMemoryMesh,
    Mesh,
    Rgba,
    Role,
    SceneGraph,
    SceneGraphInspector,
    Shape,
    SourceId,
    Sphere,
)

from twin_diagram.scene.twin_scene import TwinScene
from twin_diagram.signals.arrays import Array

OBJECT_COLOUR: Final = Rgba(0.10, 0.45, 1.0, 0.40)
"""Blue, and clear enough to see the object in it."""
SWELL: Final = 0.0015
"""How far a ghost stands out [m], so that one that is right does not flicker with what it coincides with."""
ARM_COLOUR: Final = Rgba(0.10, 0.45, 1.0, 0.25)
"""Fainter: the arm's ghost all but coincides with the arm."""


def make_ghost(scene: TwinScene) -> None:
    """Turn the twin's arm and objects translucent blue, and hide its fixtures, which would cover the real ones.

    Only the illustration role changes. Meshes that bring their own colours (.obj with a material) lose them; other mesh
    formats keep theirs. Call before the Diagram is built, and not where there is no real scene to see.
    """
    scene_graph, plant = scene.scene_graph, scene.plant
    source = cast(SourceId, plant.get_source_id())
    inspector = scene_graph.model_inspector()
    arm = {
        plant.get_body(index).index() for instance in scene.arm.instances for index in plant.GetBodyIndices(instance)
    }
    objects = {
        index for name in scene.object_names for index in plant.GetBodyIndices(plant.GetModelInstanceByName(name))
    }
    shown = [
        (geometry_id, plant.GetBodyFromFrameId(inspector.GetFrameId(geometry_id)))
        for geometry_id in inspector.GetAllGeometryIds(Role.kIllustration)
    ]
    for geometry_id, body in shown:
        if body is not None and body.index() in arm:
            _recolour(scene_graph, inspector, source, geometry_id, ARM_COLOUR)
        elif body is not None and body.index() in objects:
            _recolour(scene_graph, inspector, source, geometry_id, OBJECT_COLOUR)
        else:
            scene_graph.RemoveRole(source, geometry_id, Role.kIllustration)


def _recolour(
    scene_graph: SceneGraph, inspector: SceneGraphInspector, source: SourceId, geometry_id: GeometryId, colour: Rgba
) -> None:
    properties = IllustrationProperties()
    properties.AddProperty("phong", "diffuse", colour)
    shape = _swollen(inspector.GetShape(geometry_id))
    name = f"{inspector.GetName(geometry_id)}_ghost"
    instance = GeometryInstance(inspector.GetPoseInFrame(geometry_id), shape, name)
    instance.set_illustration_properties(properties)
    scene_graph.RegisterGeometry(source, inspector.GetFrameId(geometry_id), instance)
    scene_graph.RemoveRole(source, geometry_id, Role.kIllustration)


def _swollen(shape: Shape) -> Shape:
    """Return a shape a little larger, a mesh in .obj format also without its material.

    What is not known stays as it is.
    """
    if isinstance(shape, Box):
        return Box(*(shape.size() + 2 * SWELL))
    if isinstance(shape, Cylinder):
        return Cylinder(shape.radius() + SWELL, shape.length() + 2 * SWELL)
    if isinstance(shape, Capsule):
        return Capsule(shape.radius() + SWELL, shape.length())
    if isinstance(shape, Sphere):
        return Sphere(shape.radius() + SWELL)
    if isinstance(shape, Ellipsoid):
        return Ellipsoid(shape.a() + SWELL, shape.b() + SWELL, shape.c() + SWELL)
    if isinstance(shape, Mesh) and shape.extension() == ".obj" and shape.source().is_path():
        return _swollen_mesh(Path(shape.source().path()), np.asarray(shape.scale3()))
    return shape


def _swollen_mesh(path: Path, scale: Array) -> Mesh:
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()  # names may be in any encoding
    is_vertex = [line.split(None, 1)[:1] == ["v"] for line in lines]  # with a tab after it, or blanks before, as well
    vertices = np.array([line.split()[1:4] for line, own in zip(lines, is_vertex, strict=True) if own], dtype=float)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    # About its middle, so that it stays where it is.
    grown = 1.0 + 2 * SWELL / np.maximum(np.abs(scale) * (high - low), SWELL)
    moved = iter((vertices - (low + high) / 2) * grown + (low + high) / 2)
    kept = [
        "v " + " ".join(f"{x:.6g}" for x in next(moved)) if own else line
        for line, own in zip(lines, is_vertex, strict=True)
        if not line.lstrip().startswith(("mtllib", "usemtl"))
    ]
    file = MemoryFile(contents="\n".join(kept) + "\n", extension=".obj", filename_hint=path.name)
    return Mesh(InMemoryMesh(mesh_file=file), scale3=cast(Any, scale))
