"""The shapes that a camera sees, as triangles, colours and textures that `raster_kernels` draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.geometry import FrameId, GeometryId, Mesh, Role, SceneGraph

from twin_diagram.assets.mesh import parse_obj, read_obj, read_png
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array, Ints
from twin_diagram.station.sim.merged_shapes import plain_colour, smooth, tessellate

Bytes = npt.NDArray[np.uint8]
Stamp = tuple[tuple[str, int, int], ...]
"""Names, times [ns] and sizes of files."""
FILES = (".obj", ".mtl", ".png")
"""Suffixes of what a mesh with one texture is made of."""


@dataclass(frozen=True)
class DrawnPart:
    """One shape: V corners and F triangles.

    Attributes:
        vertices: (V, 3) in its body's frame [m].
        normals: (V, 3) unit, there.
        uv: (V, 2) on its texture, v upwards.
        faces: (F, 3).
        closed: whether the backs of its triangles are never seen.
        colour: (3,) 0 to 1, where there is no texture.
        texture: (h, w, 3); None: it has one colour.
        frame: number of its body among `DrawnShapes.frames`.
        label: of its body.
    """

    vertices: Array
    normals: Array
    uv: Array
    faces: Ints
    closed: bool
    colour: Array
    texture: Bytes | None
    frame: int
    label: int


@dataclass(frozen=True)
class DrawnShapes:
    """All shapes in one set of arrays; V corners and F triangles.

    Attributes:
        frames: whose poses are wanted.
        points, normals: (V, 3) in their frames.
        frame: (V,) which frame that is.
        uv: (V, 2).
        faces: (F, 3).
        closed: (F,) whether its back is never seen.
        base: (F, 3) colours 0 to 255.
        texture: (F, 3) where its texture begins in `texels`, width and height; width 0 where it has none.
        label: (F,) of the body.
        texels: (T, 3) of all textures.
    """

    frames: tuple[FrameId, ...]
    points: Array
    normals: Array
    frame: Ints
    uv: Array
    faces: Ints
    closed: npt.NDArray[np.bool_]
    base: Array
    texture: Ints
    label: Ints
    texels: Bytes


def drawn_shapes(scene_graph: SceneGraph) -> DrawnShapes | None:
    """Return what a camera sees of a SceneGraph; None where some of it cannot be drawn here.

    Drawn are boxes, cylinders, spheres and capsules of one opaque colour, and OBJ meshes with one texture.
    """
    inspector = scene_graph.model_inspector()
    frames = tuple(
        f for f in inspector.GetAllFrameIds() if inspector.NumGeometriesForFrameWithRole(f, Role.kPerception)
    )
    parts: list[DrawnPart] = []
    for number, frame in enumerate(frames):
        for geometry in inspector.GetGeometries(frame, Role.kPerception):
            part = _part(inspector, geometry, number)
            if part is None:
                return None
            parts.append(part)
    return _together(frames, parts) if parts else None


def _part(inspector: Any, geometry: GeometryId, frame: int) -> DrawnPart | None:
    """Return one shape; None where it cannot be drawn here."""
    properties, shape = inspector.GetPerceptionProperties(geometry), inspector.GetShape(geometry)
    X_FG = inspector.GetPoseInFrame(geometry)
    label = int(properties.GetProperty("label", "id")) if properties.HasProperty("label", "id") else -1
    R, p = X_FG.rotation().matrix(), X_FG.translation()
    if isinstance(shape, Mesh):
        found = _mesh(shape)
        if found is None:
            return None
        mesh, texture = found
        scale = np.asarray(shape.scale3())
        normals = mesh.normals / scale
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        points = (mesh.vertices * scale) @ R.T + p
        return DrawnPart(points, normals @ R.T, mesh.uv, mesh.faces, False, np.ones(3), texture, frame, label)
    colour = plain_colour(properties)
    plain = tessellate(shape)
    if plain is None or colour is None:
        return None
    corners, normals, faces = smooth(plain)
    return DrawnPart(
        corners @ R.T + p, normals @ R.T, np.zeros((len(corners), 2)), faces, True, colour, None, frame, label
    )


def _mesh(shape: Mesh) -> tuple[Any, Bytes] | None:
    """Return an OBJ mesh and its texture; None where it is not one with one texture and nothing else."""
    source = shape.source()
    if not source.is_path() or source.extension().lower() != ".obj":
        return None
    path = Path(source.path())
    try:
        return _textured(str(path), _stamp(path.parent))
    except OSError:
        return None


def _stamp(folder: Path) -> Stamp:
    """Return which files of a folder there are, and of when: an asset that is built anew is read anew."""
    told = [(file.name, file.stat()) for file in folder.iterdir() if file.suffix.lower() in FILES]
    return tuple(sorted((name, stat.st_mtime_ns, stat.st_size) for name, stat in told))


@lru_cache(maxsize=64)
def _textured(path: str, stamp: Stamp) -> tuple[Any, Bytes] | None:
    """Return an OBJ file's mesh and texture; None as in `_mesh`. Kept: several cameras show the same."""
    del stamp
    try:
        raw = parse_obj(Path(path))
        if len(raw.libraries) != 1 or len(set(raw.materials)) != 1 or not len(raw.vn) or not len(raw.vt):
            return None
        texture = only_texture(Path(path).parent / raw.libraries[0])
        return None if texture is None else (read_obj(Path(path)), read_png(texture))
    except (AssetError, OSError):
        return None


def only_texture(library: Path) -> Path | None:
    """Return the file of the texture of a material library; None where it says more than a plain white texture."""
    told = [line.split() for line in library.read_text(encoding="utf-8", errors="replace").splitlines() if line.split()]
    plain = {"newmtl": 1, "Ka": 3, "Kd": 3, "Ks": 3, "illum": 1, "map_Kd": 1}
    if any(plain.get(key) != len(rest) for key, *rest in told) or sum(key == "newmtl" for key, *_ in told) != 1:
        return None
    says = {key: rest for key, *rest in told}
    white = all(float(x) == 1.0 for x in says.get("Kd", ["1"]))
    matt = all(float(x) == 0.0 for x in says.get("Ks", ["0"]))
    return library.parent / says["map_Kd"][0] if white and matt and "map_Kd" in says else None


def _together(frames: tuple[FrameId, ...], parts: Sequence[DrawnPart]) -> DrawnShapes:
    corners = np.cumsum([0, *(len(part.vertices) for part in parts)])
    counts = [len(part.faces) for part in parts]
    images = {id(part.texture): part.texture for part in parts if part.texture is not None}
    starts = dict(zip(images, np.cumsum([0, *(image.size // 3 for image in images.values())]), strict=False))
    textures = [
        (0, 0, 0) if part.texture is None else (starts[id(part.texture)], *part.texture.shape[1::-1]) for part in parts
    ]
    return DrawnShapes(
        frames,
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.normals for part in parts]),
        np.repeat([part.frame for part in parts], [len(part.vertices) for part in parts]).astype(np.int64),
        np.concatenate([part.uv for part in parts]),
        np.concatenate([part.faces + first for part, first in zip(parts, corners[:-1], strict=True)]),
        np.repeat([part.closed for part in parts], counts),
        np.repeat([255.0 * part.colour for part in parts], counts, axis=0),
        np.repeat(np.array(textures, dtype=np.int64), counts, axis=0),
        np.repeat([part.label for part in parts], counts).astype(np.int64),
        np.concatenate([image.reshape(-1, 3) for image in images.values()] or [np.zeros((1, 3), np.uint8)]),
    )
