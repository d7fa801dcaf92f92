"""Meshes as people have them: OBJ with its materials, STL, PLY with its picture, glTF, COLLADA.

What they name must lie in their own folder, or in one that was told.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.building.gltf import read_gltf
from twin_diagram.assets.building.mesh_parts import TUNING as PARTS
from twin_diagram.assets.building.mesh_parts import Part, grey
from twin_diagram.assets.building.named_files import Beside, decoded
from twin_diagram.assets.building.obj_materials import Material, materials_of
from twin_diagram.assets.building.other_content import other_content
from twin_diagram.assets.mesh import Image, ObjText, parse_obj
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    most_faces: int = 2_000_000
    """Triangles; what is finer takes minutes and gigabytes, and shows nothing that a camera sees."""


TUNING = Tuning()


@dataclass(frozen=True)
class Source:
    """What a file holds: its parts, and notes on what was named but is not there."""

    parts: tuple[Part, ...]
    notes: tuple[str, ...]


def read_source(path: Path, *, looks: bool = True, root: Path | None = None) -> Source:
    """Read a mesh of any kind that can be read.

    Args:
        path: of the file.
        looks: whether colours and textures are wanted; to decode a picture takes as long as all else.
        root: the folder within which it may name files; None: its own.

    Raises:
        AssetError: not such a file, unreadable, without triangles, with values that are not finite or with files that
            lie elsewhere; the message names it.
    """
    readers: Final[dict[str, Callable[[Path, Beside, bool], list[Part]]]] = {
        ".dae": _read_collada,
        ".obj": _read_obj,
        ".stl": _read_with_trimesh,
        ".ply": _read_ply,
        ".glb": read_gltf,
        ".gltf": read_gltf,
    }
    if not path.exists():
        raise AssetError(f"{path}: no such mesh")
    if path.suffix.lower() not in readers:
        raise AssetError(f"{path}: not a kind of mesh that is read; these are: {', '.join(sorted(readers))}")
    if not path.is_file():
        raise AssetError(f"{path}: no such mesh")
    if held := other_content(path.read_bytes(), path.suffix.lower()):
        raise AssetError(f"{path}: {held}")
    beside = Beside(path, root, looks)
    parts = readers[path.suffix.lower()](path, beside, looks)
    for part in parts:
        numbers = [part.corners, part.colours, *([] if part.uv is None else [part.uv])]
        if not all(np.isfinite(array).all() for array in numbers):
            raise AssetError(f"{path}: a vertex is not finite (NaN or infinite); repair the mesh")
    count = sum(len(part.corners) for part in parts)
    if count == 0:
        raise AssetError(f"{path}: {_why_empty(path)}")
    if count > TUNING.most_faces:
        raise AssetError(f"{path}: {count} triangles, more than {TUNING.most_faces}; simplify the mesh")
    return Source(tuple(parts), tuple(dict.fromkeys(beside.notes)))


def _why_empty(path: Path) -> str:
    """Return why a file may have given no triangle."""
    data, kind = path.read_bytes(), path.suffix.lower()
    told = int.from_bytes(data[80:84], "little")
    if kind == ".stl" and b"\0" in data[:1000] and len(data) != 84 + 50 * told:
        return f"a binary STL of {told} triangles has {84 + 50 * told} bytes, this one {len(data)}; save it anew"
    if kind == ".ply" and b"element tristrips" in data[: data.find(b"end_header")]:
        return "its triangles are in strips, which are not read; save it with faces"
    return "the mesh has no faces (triangles)"


def _read_obj(path: Path, beside: Beside, looks: bool) -> list[Part]:
    """Read an OBJ file: one part for each material."""
    text = parse_obj(path)
    if not looks:
        return [grey(text.v[text.corners[:, :, 0]])]
    materials: dict[str, Material] = {}
    for library in text.libraries:
        try:
            told = beside.get(library).decode("utf-8", errors="replace")
        except FileNotFoundError:
            continue
        materials.update(materials_of(told, str(path.parent / library)))
    names = np.array(text.materials)
    return [_obj_part(text, names == name, materials.get(name, Material()), beside) for name in dict.fromkeys(names)]


def _obj_part(text: ObjText, chosen: npt.NDArray[np.bool_], material: Material, beside: Beside) -> Part:
    """Return the triangles of one material."""
    index = text.corners[chosen]
    corners = text.v[index[:, :, 0]]
    image = None
    if material.texture and len(text.vt) and index[:, :, 1].min() >= 0:
        try:
            image = decoded(beside.get(material.texture), material.texture)
        except FileNotFoundError:
            pass
    uv = text.vt[index[:, :, 1]] if image is not None else None
    colour = 3 * (PARTS.grey,) if material.colour is None else material.colour
    colours = np.tile(np.clip(colour, 0.0, 1.0), (len(index), 1))
    if text.colours is not None:
        colours = text.colours[index[:, :, 0]].mean(axis=1)
    return Part(corners, uv, image, colours)


def _read_ply(path: Path, beside: Beside, looks: bool) -> list[Part]:
    """Read PLY, whose head may name a picture: trimesh takes grey for one that is not there."""
    image = None
    if looks and (name := _ply_picture(path.read_bytes())):
        try:
            image = decoded(beside.get(name), name)
        except FileNotFoundError:
            pass
    return _read_with_trimesh(path, beside, looks, image, skip_materials=True, fix_texture=image is not None)


def _ply_picture(data: bytes) -> str | None:
    """Return the picture that a PLY file's head names, `comment TextureFile NAME`."""
    for line in data[: data.find(b"end_header")].decode("utf-8", errors="replace").splitlines():
        words = line.split(maxsplit=2)
        if len(words) == 3 and words[:2] == ["comment", "TextureFile"]:
            return words[2].strip()
    return None


def _read_with_trimesh(path: Path, beside: Beside, looks: bool, image: Image | None = None, **how: bool) -> list[Part]:
    """Read STL, PLY or COLLADA; one part for each mesh as it is placed.

    Args:
        path: of the file.
        beside: reads what it names.
        looks: whether colours and textures are wanted.
        image: where the file does not hold its own.
        how: options of trimesh's reader.
    """
    import trimesh

    try:
        kind, data = path.suffix.lower()[1:], path.read_bytes()
        if kind == "ply":  # older programs' names of colours
            head, end, body = data.partition(b"end_header")
            data = head.replace(b" diffuse_", b" ") + end + body
        loaded = trimesh.load(io.BytesIO(data), file_type=kind, resolver=beside, force="scene", process=False, **how)
        placed = [
            (loaded.geometry[name], X) for X, name in (loaded.graph[node] for node in loaded.graph.nodes_geometry)
        ]
        parts = [
            _part_of(mesh, X, looks, image)
            for mesh, X in placed
            if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)
        ]
    except FileNotFoundError:
        raise beside.problem or AssetError(beside.notes[-1].removesuffix("; built without it")) from None
    except OSError:
        raise
    except AssetError as error:
        raise beside.problem or AssetError(f"{path}: {error}") from None
    except Exception as error:  # whatever a reader of foreign files meets
        problem = beside.problem or AssetError(f"{path}: cannot be read as {path.suffix.lower()[1:]} ({error!r:.200})")
        raise problem from None
    if beside.problem:
        raise beside.problem  # the reader may have gone on without the file
    return parts


def _read_collada(path: Path, beside: Beside, looks: bool) -> list[Part]:
    """Read COLLADA: its file tells its unit, of which metres are made, and which axis is up, which becomes z."""
    import collada

    parts = _read_with_trimesh(path, beside, looks)
    told = collada.Collada(io.BytesIO(path.read_bytes()), ignore=[collada.common.DaeError]).assetInfo
    scale = float(told.unitmeter or 1.0)
    upright = {"X_UP": x_becomes_up, "Y_UP": z_up}.get(str(told.upaxis), np.asarray)
    return [replace(part, corners=scale * upright(part.corners)) for part in parts]


def z_up(points: Array) -> Array:
    """Return points (…, 3) of axes with y upwards in such with z upwards; x stays."""
    return np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)


def x_becomes_up(points: Array) -> Array:
    """Turn points (…, 3) of axes with x upwards into such with z upwards; y becomes −x, z −y, as COLLADA has it."""
    return np.stack([-points[..., 1], -points[..., 2], points[..., 0]], axis=-1)


def _part_of(mesh: Any, X: Array, looks: bool, image: Image | None) -> Part:
    """Return one mesh of trimesh's, placed."""
    vertices = np.asarray(mesh.vertices, dtype=float) @ X[:3, :3].T + X[:3, 3]
    faces = np.asarray(mesh.faces)
    if np.linalg.det(X[:3, :3]) < 0:  # mirrored
        faces = faces[:, ::-1]
    return Part(vertices[faces], *_look_of(mesh, faces, image)) if looks else grey(vertices[faces])


def _look_of(mesh: Any, faces: npt.NDArray[np.int64], image: Image | None) -> tuple[Array | None, Image | None, Array]:
    """Return texture coordinates, picture and colours of a mesh of trimesh's, as `Part` has them."""
    visual, uv = mesh.visual, None
    plain = np.full((len(faces), 3), PARTS.grey)
    if visual.kind == "texture":
        material = visual.material
        picture = getattr(material, "baseColorTexture", None)
        factor = np.ones(3)
        if getattr(material, "baseColorFactor", None) is not None:
            factor = np.asarray(material.baseColorFactor, dtype=float)[:3] / 255.0  # trimesh keeps bytes
        if visual.uv is not None and (image is not None or picture is not None):
            image = np.round(_pixels(picture) * factor).astype(np.uint8) if image is None else image
            uv = np.asarray(visual.uv, dtype=float)[faces]
        elif picture is None and (told := mesh.vertex_attributes.get("color")) is not None:  # of a PLY file
            return None, None, np.asarray(told)[:, :3][faces].mean(axis=1) / 255.0
        colours = np.tile(factor, (len(faces), 1)) if picture is not None or factor.min() < 1 else plain
        return uv, image if uv is not None else None, colours
    if visual.kind == "vertex":
        return None, None, np.asarray(visual.vertex_colors)[:, :3][faces].mean(axis=1) / 255.0
    if visual.kind == "face":
        return None, None, np.asarray(visual.face_colors)[:, :3] / 255.0
    return None, None, plain


def _pixels(picture: Any) -> Image:
    """Return the RGB of a picture of Pillow's, which reads it only now."""
    try:
        return np.asarray(picture.convert("RGB"))
    except (OSError, SyntaxError, ValueError) as error:
        raise AssetError(f"a picture in it cannot be read ({error})") from None
