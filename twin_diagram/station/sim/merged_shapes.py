"""Makes one mesh of each body's plain shapes, so that a renderer draws bodies, not shapes.

What a software renderer takes grows with the number of shapes: an arm of 75 boxes, cylinders and spheres, merged into
eleven meshes, renders in three fifths of the time. The shapes' colours become a palette, a texture with a texel each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import trimesh
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Box,
    Capsule,
    Cylinder,
    GeometryId,
    GeometryInstance,
    InMemoryMesh,
    Mesh,
    PerceptionProperties,
    RenderLabel,
    Role,
    SceneGraph,
    Shape,
    SourceId,
    Sphere,
)
from pydrake.math import RigidTransform

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    sides: int = 32
    """Of what is round."""

    sharp: float = 0.6
    """An angle between faces beyond which their edge is sharp [rad]."""

    grey: tuple[float, ...] = (0.7, 0.7, 0.7, 1.0)
    """Colour of a shape that has none (r, g, b, a)."""


TUNING = Tuning()


_KINDS: dict[str, type[Box] | type[Cylinder] | type[Sphere] | type[Capsule]] = {
    kind.__name__: kind for kind in (Box, Cylinder, Sphere, Capsule)
}
"""Plain shapes, by name."""


def _sizes(shape: Shape) -> tuple[float, ...] | None:
    """Return what a plain shape is made with [m]; None where it is no such shape."""
    if isinstance(shape, Box):
        return tuple(map(float, shape.size()))
    if isinstance(shape, (Cylinder, Capsule)):
        return float(shape.radius()), float(shape.length())
    return (float(shape.radius()),) if isinstance(shape, Sphere) else None


def tessellate(shape: Shape) -> trimesh.Trimesh | None:
    """Return the triangles of a plain shape in its own frame; None where it is no such shape."""
    if isinstance(shape, Box):
        return trimesh.creation.box(extents=shape.size())
    if isinstance(shape, Cylinder):
        return trimesh.creation.cylinder(shape.radius(), shape.length(), sections=TUNING.sides)
    if isinstance(shape, Sphere):
        return trimesh.creation.uv_sphere(shape.radius(), count=[TUNING.sides // 2, TUNING.sides])
    if isinstance(shape, Capsule):
        capsule = trimesh.creation.capsule(shape.length(), shape.radius(), count=[TUNING.sides // 2, TUNING.sides])
        capsule.apply_translation(-capsule.bounds.mean(axis=0))  # the middle, whichever end trimesh starts at
        return capsule
    return None


Part = tuple[str, tuple[float, ...], bytes, tuple[float, ...]]
"""A plain shape of a body, so that it can be compared: its kind and sizes [m], its pose as bytes, its colour."""


@lru_cache(maxsize=64)
def merged_mesh(parts: tuple[Part, ...]) -> Mesh:
    """Return the mesh of a body's shapes. Kept: each camera, and each station of a process, shows the same arm."""
    found: list[trimesh.Trimesh] = []
    for kind, sizes, pose, _ in parts:
        part = tessellate(_KINDS[kind](*sizes))
        assert part is not None
        part.apply_transform(np.frombuffer(pose).reshape(4, 4))
        found.append(part)
    return Mesh(wavefront(found, [colour for *_, colour in parts]))


def wavefront(parts: Sequence[trimesh.Trimesh], colours: Sequence[Sequence[float] | Array]) -> InMemoryMesh:
    """Return one textured mesh of several parts.

    Args:
        parts: in the mesh's frame.
        colours: (r, g, b) of each, 0 to 1.
    """
    lines = ["mtllib palette.mtl", "usemtl palette"]
    first = 1
    for k, part in enumerate(parts):
        shaded = _shaded(np.asarray(part.vertices).tobytes(), np.asarray(part.faces, dtype=np.int64).tobytes())
        lines += [shaded.vertices, f"vt {(k + 0.5) / len(parts):.7g} 0.5"]
        lines += [f"f {a}/{k + 1}/{a} {b}/{k + 1}/{b} {c}/{k + 1}/{c}" for a, b, c in (shaded.faces + first).tolist()]
        first += shaded.count
    palette = np.rint(255.0 * np.array(colours)[None, :, ::-1]).astype(np.uint8)
    png = cv2.imencode(".png", palette)[1].tobytes()
    material = "newmtl palette\nKd 1 1 1\nmap_Kd palette.png\n"
    return InMemoryMesh(
        mesh_file=MemoryFile("\n".join(lines) + "\n", ".obj", "merged"),
        supporting_files={
            "palette.mtl": MemoryFile(material, ".mtl", "palette.mtl"),
            "palette.png": MemoryFile(png, ".png", "palette.png"),
        },
    )


@dataclass(frozen=True)
class _Shaded:
    """A part with smooth normals: lines of its vertices and normals, how many, and its triangles (F, 3)."""

    vertices: str
    count: int
    faces: npt.NDArray[np.int64]


@lru_cache(maxsize=256)
def _shaded(vertices: bytes, faces: bytes) -> _Shaded:
    """Return a part as text. Kept: colour and depth cameras, and further stations, show the same shapes."""
    corners, normals, triangles = _smooth(vertices, faces)
    lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in corners.tolist()]
    lines += [f"vn {x:.5g} {y:.5g} {z:.5g}" for x, y, z in normals.tolist()]
    return _Shaded("\n".join(lines), len(corners), triangles)


def smooth(part: trimesh.Trimesh) -> tuple[Array, Array, npt.NDArray[np.int64]]:
    """Return corners (V, 3), unit normals (V, 3) and triangles (F, 3) of a part, its flat edges smoothed; read-only."""
    return _smooth(np.asarray(part.vertices).tobytes(), np.asarray(part.faces, dtype=np.int64).tobytes())


@lru_cache(maxsize=256)
def _smooth(vertices: bytes, faces: bytes) -> tuple[Array, Array, npt.NDArray[np.int64]]:
    part = trimesh.Trimesh(
        np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(faces, np.int64).reshape(-1, 3), process=False
    )
    found = trimesh.graph.smooth_shade(part, angle=TUNING.sharp)
    result = np.array(found.vertices), np.array(found.vertex_normals), np.array(found.faces, dtype=np.int64)
    for array in result:
        array.setflags(write=False)
    return result


def merge_shapes(scene_graph: SceneGraph, source: SourceId) -> None:
    """Merge, body by body, the plain and opaque shapes that a camera sees.

    Args:
        scene_graph: before its Context is made. Its other roles stay as they are.
        source: of the geometry.
    """
    inspector = scene_graph.model_inspector()
    for frame in [*inspector.FramesForSource(source), inspector.world_frame_id()]:
        chosen: list[GeometryId] = []
        parts: list[Part] = []
        label = RenderLabel.kDontCare
        for geometry in inspector.GetGeometries(frame, Role.kPerception):
            properties = inspector.GetPerceptionProperties(geometry)
            colour = plain_colour(properties)
            shape = inspector.GetShape(geometry)
            sizes = _sizes(shape)
            if sizes is None or colour is None or not inspector.BelongsToSource(geometry, source):
                continue
            pose = np.ascontiguousarray(inspector.GetPoseInFrame(geometry).GetAsMatrix4()).tobytes()
            if not chosen:
                label = inspector.GetPerceptionProperties(geometry).GetPropertyOrDefault("label", "id", label)
            chosen.append(geometry)
            parts.append((type(shape).__name__, sizes, pose, tuple(colour.tolist())))
        if len(chosen) < 2:
            continue
        for geometry in chosen:
            scene_graph.RemoveRole(source, geometry, Role.kPerception)
        mesh = merged_mesh(tuple(parts))
        name = f"merged_{frame.get_value()}"
        merged = scene_graph.RegisterGeometry(source, frame, GeometryInstance(RigidTransform(), mesh, name))
        properties = PerceptionProperties()
        properties.AddProperty("label", "id", label)
        scene_graph.AssignRole(source, merged, properties)


def plain_colour(properties: PerceptionProperties) -> Array | None:
    """Return (r, g, b) of a shape; None where one colour does not say it all."""
    if properties.HasProperty("phong", "diffuse_map"):
        return None
    rgba = np.array(TUNING.grey)
    if properties.HasProperty("phong", "diffuse"):
        diffuse: Any = properties.GetProperty("phong", "diffuse")
        rgba = np.array(diffuse.rgba if hasattr(diffuse, "rgba") else diffuse)
    return rgba[:3] if rgba[3] >= 1.0 else None
