"""Meshes as people have them: OBJ with its materials, STL, PLY, glTF.

What they name must lie in their own folder, or in one that was told.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.assets.mesh import Image, ObjText, parse_obj
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    most_faces: int = 2_000_000
    """Triangles; what is finer takes minutes and gigabytes, and shows nothing that a camera sees."""

    grey: float = 0.7
    """RGB of what has no colour: light enough to be told from a shadow."""


TUNING = Tuning()


@dataclass(frozen=True)
class Part:
    """Triangles with one look, in the file's unit and axes.

    Attributes:
        corners: (F, 3, 3) of each triangle's corners the place; counter-clockwise from outside, if the file is right.
        uv: (F, 3, 2) texture coordinates, v upwards, or None.
        image: RGB, where there is a texture; then `uv` is there, too.
        colours: (F, 3) RGB in [0, 1] of each triangle, where there is no texture.
    """

    corners: Array
    uv: Array | None
    image: Image | None
    colours: Array


@dataclass(frozen=True)
class Source:
    """What a file holds: its parts, and notes on what was named but is not there."""

    parts: tuple[Part, ...]
    notes: tuple[str, ...]


PICTURES: Final = (".png", ".jpg", ".jpeg", ".webp", ".ktx2", ".tga", ".bmp", ".gif", ".tif", ".tiff")
"""Suffixes of what materials name."""


class Beside:
    """Reads the files that a mesh names: only such as lie, links followed, in one folder or below.

    Args:
        mesh: that names them, from its own folder on.
        root: the folder that holds them all; None: the mesh's own.
        pictures: whether they are wanted.
    """

    def __init__(self, mesh: Path, root: Path | None = None, pictures: bool = True) -> None:
        self._mesh, self._folder = mesh, mesh.parent
        self._root, self._pictures = (mesh.parent if root is None else root).resolve(), pictures
        self._where = "the mesh's folder" if root is None else str(root)
        self.notes: list[str] = []
        self.problem: AssetError | None = None

    def get(self, name: str) -> bytes:
        """Return a file's contents.

        Raises:
            AssetError: it lies elsewhere.
            FileNotFoundError: it is not there; noted.
        """
        path = self._folder / name.strip()
        if not self._pictures and path.suffix.lower() in PICTURES:
            raise FileNotFoundError(str(path))
        try:
            inside = path.resolve().is_relative_to(self._root)
        except (OSError, ValueError, RuntimeError):  # a circle of links, a name with \0
            inside = False
        if not inside:
            self.problem = AssetError(
                f"{self._mesh}: names {name!r}, which lies outside of {self._where}; copy it there, named by itself, "
                "or tell a folder that holds both, --root"
            )
            raise self.problem
        if not path.is_file():
            self.notes.append(f"{self._mesh}: names {name!r}, which is not there; built without it")
            raise FileNotFoundError(str(path))
        return path.read_bytes()

    __getitem__ = get


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
        ".ply": _read_with_trimesh,
        ".glb": _read_with_trimesh,
        ".gltf": _read_with_trimesh,
    }
    if not path.exists():
        raise AssetError(f"{path}: no such mesh")
    if path.suffix.lower() not in readers:
        raise AssetError(f"{path}: not a kind of mesh that is read; these are: {', '.join(sorted(readers))}")
    if not path.is_file():
        raise AssetError(f"{path}: no such mesh")
    beside = Beside(path, root, looks)
    parts = readers[path.suffix.lower()](path, beside, looks)
    for part in parts:
        numbers = [part.corners, part.colours, *([] if part.uv is None else [part.uv])]
        if not all(np.isfinite(array).all() for array in numbers):
            raise AssetError(f"{path}: a vertex is not finite (NaN or infinite); repair the mesh")
    count = sum(len(part.corners) for part in parts)
    if count == 0:
        raise AssetError(f"{path}: the mesh has no faces (triangles)")
    if count > TUNING.most_faces:
        raise AssetError(f"{path}: {count} triangles, more than {TUNING.most_faces}; simplify the mesh")
    return Source(tuple(parts), tuple(dict.fromkeys(beside.notes)))


def _read_obj(path: Path, beside: Beside, looks: bool) -> list[Part]:
    """Read an OBJ file: one part for each material."""
    text = parse_obj(path)
    if not looks:
        return [_grey(text.v[text.corners[:, :, 0]])]
    materials: dict[str, _Material] = {}
    for library in text.libraries:
        materials.update(_materials(library, path, beside))
    names = np.array(text.materials)
    return [_obj_part(text, names == name, materials.get(name, _Material()), beside) for name in dict.fromkeys(names)]


@dataclass
class _Material:
    """One material of an .mtl file: its colour, and its texture's file, if any."""

    colour: tuple[float, float, float] = (TUNING.grey, TUNING.grey, TUNING.grey)
    texture: str | None = None


def _materials(library: str, path: Path, beside: Beside) -> dict[str, _Material]:
    """Read an .mtl file; none where it is missing."""
    try:
        text = beside.get(library).decode("utf-8", errors="replace")
    except FileNotFoundError:
        return {}
    found: dict[str, _Material] = {}
    material = _Material()
    for line in text.splitlines():
        key, *rest = line.split() or [""]
        if key == "newmtl":
            material = found.setdefault(" ".join(rest), _Material())
        elif key == "Kd":
            try:
                r, g, b = (float(x) for x in rest)
            except ValueError:
                raise AssetError(f"{path.parent / library}: a colour is three numbers, not {line.strip()!r}") from None
            material.colour = (r, g, b)
        elif key.lower() == "map_kd":
            material.texture = _texture_name(rest)
    return found


def _texture_name(words: list[str]) -> str:
    """Return the file that a line `map_Kd` names, without the options before it."""
    at = 0
    while at < len(words) and words[at].startswith("-") and len(words) > at + 1:
        option, at = words[at], at + 1
        if option in ("-o", "-s", "-t"):  # one to three numbers
            while at < len(words) - 1 and _is_number(words[at]):
                at += 1
        else:
            at += 2 if option == "-mm" else 1
    return " ".join(words[at:])


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _obj_part(text: ObjText, chosen: npt.NDArray[np.bool_], material: _Material, beside: Beside) -> Part:
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
    colours = np.tile(np.clip(material.colour, 0.0, 1.0), (len(index), 1))
    if text.colours is not None:
        colours = text.colours[index[:, :, 0]].mean(axis=1)
    return Part(corners, uv, image, colours)


def decoded(data: bytes, name: str) -> Image:
    """Return an image file's RGB.

    Raises:
        AssetError: not an image.
    """
    try:
        bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    except cv2.error:  # one of 2³⁰ pixels and more
        bgr = None
    if bgr is None:
        raise AssetError(f"{name}: not an image that can be read")
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def _read_with_trimesh(path: Path, beside: Beside, looks: bool) -> list[Part]:
    """Read STL, PLY or glTF; one part for each mesh as it is placed."""
    import trimesh

    if path.suffix.lower() in (".glb", ".gltf"):
        _refuse_compressed(path)
    try:
        kind = path.suffix.lower()[1:]
        loaded = trimesh.load(
            io.BytesIO(path.read_bytes()), file_type=kind, resolver=beside, force="scene", process=False
        )
        placed = [
            (loaded.geometry[name], X) for X, name in (loaded.graph[node] for node in loaded.graph.nodes_geometry)
        ]
        parts = [
            _part_of(mesh, X, looks) for mesh, X in placed if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)
        ]
    except FileNotFoundError:
        raise beside.problem or AssetError(beside.notes[-1].removesuffix("; built without it")) from None
    except OSError:
        raise
    except Exception as error:  # whatever a reader of foreign files meets
        problem = beside.problem or AssetError(f"{path}: cannot be read as {path.suffix.lower()[1:]} ({error!r:.200})")
        raise problem from None
    if beside.problem:
        raise beside.problem  # the reader may have gone on without the file
    return parts


def _refuse_compressed(path: Path) -> None:
    """Refuse a glTF whose triangles are compressed: the reader would take zeros in their place."""
    data = path.read_bytes()
    if path.suffix.lower() == ".glb" and data[:4] != b"glTF":
        raise AssetError(f"{path}: cannot be read as glb: it does not begin as one")
    told = data[20 : 20 + int.from_bytes(data[12:16], "little")] if data[:4] == b"glTF" else data
    try:
        required = set(json.loads(told).get("extensionsRequired", ()))
    except (ValueError, AttributeError, TypeError):
        raise AssetError(f"{path}: cannot be read as {path.suffix.lower()[1:]}: it holds no JSON object") from None
    if unread := required & {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"}:
        raise AssetError(f"{path}: its triangles are compressed ({min(unread)}); export it without compression")


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
    """Turn points (…, 3) of axes with x upwards into such with z upwards; y becomes −x, as COLLADA has it."""
    return np.stack([-points[..., 1], points[..., 2], points[..., 0]], axis=-1)


def _grey(corners: Array) -> Part:
    """Return triangles (F, 3, 3) without a look of their own."""
    return Part(corners, None, None, np.full((len(corners), 3), TUNING.grey))


def _part_of(mesh: Any, X: Array, looks: bool) -> Part:
    """Return one mesh of trimesh's, placed."""
    vertices = np.asarray(mesh.vertices, dtype=float) @ X[:3, :3].T + X[:3, 3]
    faces = np.asarray(mesh.faces)
    if np.linalg.det(X[:3, :3]) < 0:  # mirrored
        faces = faces[:, ::-1]
    if not looks:
        return _grey(vertices[faces])
    uv = image = None
    colours = np.full((len(faces), 3), TUNING.grey)
    visual = mesh.visual
    if visual.kind == "texture":
        material = visual.material
        picture = getattr(material, "baseColorTexture", None)
        factor = np.ones(3)
        if getattr(material, "baseColorFactor", None) is not None:
            factor = np.asarray(material.baseColorFactor, dtype=float)[:3]
            factor = factor / 255.0 if factor.max() > 1.0 else factor  # trimesh keeps bytes
        colours = np.tile(factor if picture is not None or factor.min() < 1 else colours[0], (len(faces), 1))
        if picture is not None and visual.uv is not None:
            image = np.round(np.asarray(picture.convert("RGB")) * factor).astype(np.uint8)
            uv = np.asarray(visual.uv, dtype=float)[faces]
    elif visual.kind == "vertex":
        colours = np.asarray(visual.vertex_colors)[:, :3][faces].mean(axis=1) / 255.0
    elif visual.kind == "face":
        colours = np.asarray(visual.face_colors)[:, :3] / 255.0
    return Part(vertices[faces], uv, image, colours)
