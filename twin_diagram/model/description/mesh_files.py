"""Turns meshes that Drake does not read (STL, PLY, OFF, COLLADA, GLB, plain OBJ) into such as it does, in a cache."""

from __future__ import annotations

import hashlib
import io
import logging
import os
import re
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from pydrake.geometry import Mesh

from twin_diagram.errors import ModelError
from twin_diagram.model.description import collada, scene_files
from twin_diagram.runtime import atomic_file, users_cache
from twin_diagram.signals.arrays import Array

TURNED: frozenset[str] = frozenset({".stl", ".ply", ".off", ".dae", ".glb"})
"""Suffixes, in small letters, of the meshes that are turned, whatever is in them."""

_LAYOUT = "1"
"""Of the OBJ files; another one makes those anew that are kept."""

_LARGE = 200_000
"""Bytes of a mesh from which its hull is worth a file of its own: some 2,000 triangles."""

_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)")
"""Of an STL in letters."""
_HEADER, _TRIANGLE = 84, 50
"""Bytes of a binary STL before its triangles, and of each."""

_told: set[Path] = set()
"""Pictures of which it was said that they cannot be read."""


def readable(path: Path) -> Path:
    """Return a file of the same shape and stem that Drake reads, in the unit of the file: an OBJ, of a GLB a glTF.

    Args:
        path: a mesh; itself where nothing is to be put right.

    Raises:
        ModelError: it cannot be read, or has no triangle.
    """
    content, suffix = path.read_bytes(), path.suffix.lower()
    if suffix == ".obj":
        materials = _materials(path, content)
        odd = any(map(scene_files.other_pictures, materials.values())) and find_spec("cv2") is not None
        return _finished(path, content, materials) if odd or scene_files.lacks_normals(content) else path
    name = f"meshes/{_digest(content)}/{path.stem}"
    if suffix == ".glb":
        return _kept(f"{name}.gltf", lambda _: _read(path, lambda: scene_files.gltf_of(content)))
    return _kept(f"{name}.obj", lambda _: obj_of(_corners(path, content)))


def hull_of(path: Path) -> Path:
    """Return an OBJ of the convex hull of a mesh that Drake reads, which is all that it takes of a collision shape.

    Drake works it out each time that a description is parsed, which takes a third of a second for 50,000 triangles; a
    run parses one several times.

    Args:
        path: a mesh that Drake reads; itself where it is no OBJ, is small, or has no hull.
    """
    if path.suffix.lower() != ".obj" or path.stat().st_size < _LARGE:
        return path
    name = f"meshes/{_digest(b'hull', path.read_bytes())}/{path.stem}.obj"
    try:
        return _kept(name, lambda _: _hull_text(path))
    except RuntimeError:  # what is wrong with it is said where it is parsed
        return path


def _hull_text(path: Path) -> str:
    """Return the convex hull of a mesh as Drake has it, as an OBJ's text; raises RuntimeError where there is none."""
    hull = Mesh(str(path)).GetConvexHull()
    vertices = [hull.vertex(k).tolist() for k in range(hull.num_vertices())]
    faces = [hull.element(k) for k in range(hull.num_faces())]
    lines = ["v {:.17g} {:.17g} {:.17g}".format(*vertex) for vertex in vertices]
    lines += ["f " + " ".join(str(face.vertex(k) + 1) for k in range(face.num_vertices())) for face in faces]
    return "\n".join([*lines, ""])


def _materials(path: Path, content: bytes) -> dict[str, bytes]:
    """Return the texts of the files of materials that an OBJ names and that are beside it, by name."""
    folder = path.parent.resolve()
    own = [name for name in scene_files.libraries(content) if Path(name).name == name and (folder / name).is_file()]
    return {name: (folder / name).read_bytes() for name in own}


def _finished(path: Path, content: bytes, materials: Mapping[str, bytes]) -> Path:
    """Return a copy of an OBJ with normals, and with its materials, whose pictures stay where they are if Drake can."""
    folder = path.parent.resolve()
    named = dict.fromkeys(name for text in materials.values() for name in scene_files.other_pictures(text))
    pictures = {name: (folder / name).read_bytes() for name in named if (folder / name).is_file()}
    place = f"meshes/{_digest(content, str(folder).encode(), *materials.values(), *pictures.values())}"
    turned = {}
    for k, (name, picture) in enumerate(pictures.items()):
        png = _kept(f"{place}/{k}.png", lambda _, picture=picture: _png(picture))  # type: ignore[misc]
        turned[name] = png.name if png.stat().st_size else ""
        if not turned[name] and folder / name not in _told:
            _told.add(folder / name)
            logging.getLogger("twin_diagram").warning(
                "%s: no picture that can be read; drawn without (save it as PNG or JPEG)", folder / name
            )

    def material(text: bytes, home: Path) -> bytes:
        way = os.path.relpath(folder, home)
        return scene_files.with_pictures(
            scene_files.moved(text, way), {f"{way}/{name}": other for name, other in turned.items()}
        )

    for name, text in materials.items():
        _kept(f"{place}/{name}", lambda home, text=text: material(text, home))  # type: ignore[misc]
    whole = scene_files.with_normals if scene_files.lacks_normals(content) else bytes
    return _kept(f"{place}/{path.stem}.obj", lambda _: _read(path, lambda: whole(content)))


def _png(picture: bytes) -> bytes:
    """Return a picture as a PNG; nothing where it cannot be read."""
    import cv2  # not everybody who loads a model has it

    read = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR) if picture else None
    return b"" if read is None else cv2.imencode(".png", read)[1].tobytes()


def _digest(*parts: bytes) -> str:
    return hashlib.sha256(_LAYOUT.encode() + b"".join(parts)).hexdigest()[:24]


def _kept(name: str, made: Callable[[Path], str | bytes]) -> Path:
    """Return a file in the cache, made once; `made` is given the folder that it is for."""
    kept = users_cache.folder() / name
    if kept.is_file():
        return kept
    text = made(kept.parent)
    try:
        return atomic_file.write(kept, text)
    except OSError:
        aside = users_cache.for_this_process() / name
        return aside if aside.is_file() else atomic_file.write(aside, made(aside.parent))


def _read(path: Path, made: Callable[[], bytes]) -> bytes:
    """Return what `made` does, or refuse the file."""
    try:
        return made()
    except ValueError as error:
        raise ModelError(f"{path}: not a mesh that can be read: {' '.join(str(error).split())}") from error


def _corners(path: Path, content: bytes) -> Array:
    suffix = path.suffix.lower()
    try:
        if suffix in (".ply", ".off"):
            corners = _corners_by_trimesh(content, suffix[1:])
        else:
            corners = collada.corners(content) if suffix == ".dae" else stl_corners(content)
    except ValueError as error:
        raise ModelError(f"{path}: not a mesh that can be read: {' '.join(str(error).split())}") from error
    if not len(corners):
        raise ModelError(f"{path}: the mesh has no triangles")
    if not np.all(np.isfinite(corners)):
        raise ModelError(f"{path}: a vertex of the mesh is not finite")
    return corners


def _corners_by_trimesh(content: bytes, kind: str) -> Array:
    """Return the corners (T, 3, 3) of a PLY's or OFF's triangles; none where it holds points alone.

    Raises:
        ValueError: it is cut off, or something else.
    """
    import trimesh

    try:
        read = trimesh.load(io.BytesIO(content), file_type=kind, process=False)
    except Exception as error:  # its readers raise whatever they stumble over
        raise ValueError(f"it is cut off, or no {kind.upper()}") from error
    return np.asarray(read.triangles, dtype=float) if isinstance(read, trimesh.Trimesh) else np.zeros((0, 3, 3))


def stl_corners(content: bytes) -> Array:
    """Return the corners (T, 3, 3) of an STL's triangles, binary or in letters.

    Raises:
        ValueError: it is cut off.
    """
    if len(content) >= _HEADER:
        count = int.from_bytes(content[_HEADER - 4 : _HEADER], "little")
        if len(content) >= _HEADER + _TRIANGLE * count and not (content[:5] == b"solid" and _VERTEX.search(content)):
            rows = np.frombuffer(content, np.uint8, _TRIANGLE * count, _HEADER).reshape(count, _TRIANGLE)
            return np.ascontiguousarray(rows[:, 12:48]).view("<f4").reshape(count, 3, 3).astype(float)
    numbers = np.array(_VERTEX.findall(content)).astype(float)
    if not len(numbers) or len(numbers) % 3:
        raise ValueError("it is cut off, or no STL")
    return numbers.reshape(-1, 3, 3)


def obj_of(corners: Array) -> str:
    """Return an OBJ file's text: triangles (T, 3, 3) with the normals of their planes, but for those without area."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    kept = area > 0.0
    vertices, index = np.unique(corners[kept].reshape(-1, 3), axis=0, return_inverse=True)
    normals = across[kept] / area[kept, None]
    number = np.arange(1, len(normals) + 1)
    faces = np.empty((len(normals), 6), dtype=np.int64)
    faces[:, ::2] = index.reshape(-1, 3) + 1
    faces[:, 1::2] = number[:, None]
    return (
        ("v %.9g %.9g %.9g\n" * len(vertices)) % tuple(vertices.ravel().tolist())
        + ("vn %.6g %.6g %.6g\n" * len(normals)) % tuple(normals.ravel().tolist())
        + ("f %d//%d %d//%d %d//%d\n" * len(faces)) % tuple(faces.ravel().tolist())
    )
