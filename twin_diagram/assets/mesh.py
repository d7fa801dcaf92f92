"""Textured triangle meshes: reading and writing OBJ, and sampling a coloured cloud from them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.errors import AssetError
from twin_diagram.runtime import atomic_file
from twin_diagram.signals.arrays import Array

Image = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Mesh:
    """Triangles with one normal and one texture coordinate per vertex.

    Attributes:
        vertices: (V, 3) in O [m].
        normals: (V, 3) unit, outward.
        uv: (V, 2) in [0, 1], v upwards as OBJ has it.
        faces: (F, 3) vertex indices, counter-clockwise from outside.
    """

    vertices: Array
    normals: Array
    uv: Array
    faces: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Cloud:
    """Surface points: `points` (M, 3) [m], `normals` (M, 3) unit outward, `colours` (M, 3) RGB in [0, 1].

    `unpainted` (M,) are those whose colours no picture showed, what stood on a table from below; None: none is.
    """

    points: Array
    normals: Array
    colours: Array
    unpainted: npt.NDArray[np.bool_] | None = None


def encode_png(rgb: Image) -> bytes:
    """Return the PNG file of an (h, w, 3) RGB image."""
    good, data = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not good:
        raise AssetError(f"an image of shape {rgb.shape} cannot be written as PNG")
    return cast(bytes, data.tobytes())


def read_png(path: Path) -> Image:
    """Return (h, w, 3) RGB.

    Raises:
        AssetError: missing or not an image.
    """
    data = np.frombuffer(path.read_bytes(), np.uint8) if path.is_file() else np.empty(0, np.uint8)
    bgr = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if bgr is None:
        raise AssetError(f"{path}: no such texture image")
    return cast(Image, cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))


def write_obj(mesh: Mesh, path: Path, texture: Image) -> None:
    """Write `path` (OBJ), and beside it the material and the texture with the same stem."""
    stem = path.stem
    atomic_file.write(path.with_suffix(".png"), encode_png(texture))
    material = f"newmtl surface\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd {stem}.png\n"
    atomic_file.write(path.with_suffix(".mtl"), material.encode())
    lines = [f"mtllib {stem}.mtl\nusemtl surface\n"]
    lines += _rows("v %.6g %.6g %.6g\n", mesh.vertices)
    lines += _rows("vt %.6g %.6g\n", mesh.uv)
    lines += _rows("vn %.5g %.5g %.5g\n", mesh.normals)
    lines += _rows("f %d/%d/%d %d/%d/%d %d/%d/%d\n", np.repeat(mesh.faces + 1, 3, axis=1))
    atomic_file.write(path, "".join(lines).encode())


def _rows(line: str, values: npt.NDArray[Any], at_once: int = 10_000) -> list[str]:
    """Return the rows of values (N, k), each as that line, so many in a text: one by one they take thrice as long."""
    parts = (values[start : start + at_once] for start in range(0, len(values), at_once))
    return [line * len(part) % tuple(part.reshape(-1).tolist()) for part in parts]


def read_obj(path: Path) -> Mesh:
    """Read triangles (and fans of polygons) with texture coordinates; normals are computed where the file has none.

    Raises:
        AssetError: missing file, no triangles, indices out of range, or values that are not finite.
    """
    if not path.is_file():
        raise AssetError(f"{path}: no such mesh")
    raw = parse_obj(path)
    unique, inverse = np.unique(raw.corners.reshape(-1, 3), axis=0, return_inverse=True)
    faces = inverse.reshape(-1, 3)
    vertices = raw.v[unique[:, 0]]
    uv = (raw.vt if len(raw.vt) else np.zeros((1, 2)))[np.maximum(unique[:, 1], 0)]
    if len(raw.vn) and unique[:, 2].min() >= 0:
        normals = raw.vn[unique[:, 2]]
    else:
        flat = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
        normals = np.zeros_like(vertices)
        for k in range(3):
            np.add.at(normals, faces[:, k], flat)
    if not (np.isfinite(uv).all() and np.isfinite(normals).all()):
        raise AssetError(f"{path}: a texture coordinate or a normal is not finite")
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return Mesh(vertices, normals, uv, faces)


@dataclass(frozen=True)
class ObjText:
    """What an OBJ file says, before anything is made of it.

    Attributes:
        v: (V, 3) finite, in the file's unit.
        colours: (V, 3) of the vertices, RGB in [0, 1], where each has one, else None.
        vt: (T, 2).
        vn: (N, 3).
        corners: (F, 3, 3) of each triangle's corners the indices into v, vt and vn, -1 where absent; at least one.
        materials: each triangle's material, "" before the first.
        libraries: names of material files.
    """

    v: Array
    colours: Array | None
    vt: Array
    vn: Array
    corners: npt.NDArray[np.int64]
    materials: tuple[str, ...]
    libraries: tuple[str, ...]


def parse_obj(path: Path) -> ObjText:
    """Read an OBJ file's triangles (and fans of polygons).

    Raises:
        AssetError: no triangles, indices out of range, or values that are not finite.
    """
    raw: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
    corners: list[int] = []  # their numbers among `told`: a corner is named by six triangles or so
    told: list[tuple[int, int, int]] = []
    known: dict[str, int] = {}
    materials, libraries, material = [], [], ""
    try:
        # Numbers are ASCII; names and remarks may have any other encoding.
        for line in path.read_text(encoding="utf-8-sig", errors="surrogateescape").replace("\\\n", " ").splitlines():
            key, *rest = line.split() or [""]
            if "#" in line and (key in raw or key == "f"):  # names may have one in them
                rest = line.partition("#")[0].split()[1:]
            if key in raw:
                raw[key].append([float(x) for x in rest])
            elif key == "f":
                if "-" in line:  # counted back from what is read so far, which is another corner further on
                    known = {}
                for item in rest:
                    if item not in known:
                        known[item] = len(told)
                        told.append(_corner(item, raw))
                fan = [known[item] for item in rest]
                corners += [fan[k] for i in range(1, len(fan) - 1) for k in (0, i, i + 1)]
                materials += [material] * max(len(fan) - 2, 0)
            elif key == "usemtl":
                material = " ".join(rest)
            elif key == "mtllib":
                libraries.append(line.split(maxsplit=1)[1].strip() if rest else "")
    except ValueError as error:
        raise AssetError(f"{path}: not a readable OBJ file ({error})") from None
    if not corners:
        raise AssetError(f"{path}: the mesh has no triangles")
    columns = {"v": 3, "vt": 2, "vn": 3}
    for key, rows in raw.items():
        short = next((row for row in rows if len(row) < columns[key]), None)
        if short is not None:
            raise AssetError(f"{path}: not a readable OBJ file (a line {key!r} has only {len(short)} numbers)")
    v, vt, vn = (np.array([row[:n] for row in raw[key]], dtype=float).reshape(-1, n) for key, n in columns.items())
    every = np.array(told)[corners]
    if (every >= [len(v), len(vt), len(vn)]).any() or every[:, 0].min() < 0 or not np.isfinite(v).all():
        raise AssetError(f"{path}: a face names a vertex that is not there, or a vertex is not finite")
    colours = None
    if all(len(row) >= 6 for row in raw["v"]):
        colours = np.array([row[3:6] for row in raw["v"]])
        # Some programs write bytes; shares may be a little beyond 1.
        colours = np.clip(colours / (255.0 if colours.max(initial=0.0) > 2.0 else 1.0), 0.0, 1.0)
    return ObjText(v, colours, vt, vn, every.reshape(-1, 3, 3), tuple(materials), tuple(libraries))


def _corner(item: str, raw: dict[str, list[list[float]]]) -> tuple[int, int, int]:
    """Return one `v/vt/vn` of a face as indices from zero; -1 where absent."""
    parts = [*item.split("/"), "", ""][:3]
    v, vt, vn = (_index(part, len(raw[key])) for part, key in zip(parts, ("v", "vt", "vn"), strict=True))
    return v, vt, vn


def _index(part: str, count: int) -> int:
    """Return an index from zero, -1 where `part` is empty; negative ones count back from the `count` read so far."""
    if not part:
        return -1
    number = int(part)
    if number > 0:
        return number - 1
    if not -count <= number < 0:
        raise ValueError(f"a face names {number}, counted back from {count}")
    return count + number


def bilinear(image: Image, uv: Array) -> Array:
    """Return RGB in [0, 1] of a texture at `uv` (M, 2), v upwards, clamped at the border."""
    height, width = image.shape[:2]
    x = np.clip(uv[:, 0] * width - 0.5, 0.0, width - 1.0)
    y = np.clip((1.0 - uv[:, 1]) * height - 0.5, 0.0, height - 1.0)
    x0, y0 = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    top = image[y0, x0] * (1 - fx) + image[y0, x0 + 1] * fx
    bottom = image[y0 + 1, x0] * (1 - fx) + image[y0 + 1, x0 + 1] * fx
    return cast(Array, (top * (1 - fy) + bottom * fy) / 255.0)


def sample(mesh: Mesh, texture: Image, count: int, seed: int = 0) -> Cloud:
    """Return `count` points spread evenly over the surface, in random order: the first few are an even sample, too."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    across = np.cross(b - a, c - a)
    doubled = np.linalg.norm(across, axis=1)  # twice the areas: shares are what counts
    rng = np.random.default_rng(seed)
    # One draw per equal share of area keeps the number of points on each face nearly exact.
    position = (np.arange(count) + rng.random(count)) / count * doubled.sum()
    face = np.minimum(np.searchsorted(np.cumsum(doubled), position), len(doubled) - 1)
    r1, r2 = np.sqrt(rng.random(count)), rng.random(count)
    share = np.stack([1 - r1, r1 * (1 - r2), r1 * r2], axis=1)[:, :, None]
    corner = mesh.faces[face]
    order = rng.permutation(count)
    points, normals, uv = ((v[corner] * share).sum(axis=1)[order] for v in (mesh.vertices, mesh.normals, mesh.uv))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    # Where both sides of a sheet share their vertices these have no normal: the triangle's own.
    flat = (across[face] / np.maximum(doubled[face], 1e-300)[:, None])[order]
    normals = np.where(length > 0.0, normals / np.where(length > 0.0, length, 1.0), flat)
    return Cloud(points, normals, bilinear(texture, uv))
