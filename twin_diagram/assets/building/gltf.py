"""Reads glTF 2.0: triangles where their nodes stand, with materials, pictures and colours of vertices.

Pictures are sRGB, as cameras' are; factors and vertices' colours are linear light, and are made sRGB.

Source: Khronos Group, glTF 2.0 specification (2021), sections 3.7 and 3.9; KHR_texture_transform.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.building.gltf_file import GltfFile
from twin_diagram.assets.building.mesh_parts import Part, grey
from twin_diagram.assets.building.named_files import Beside, decoded
from twin_diagram.assets.mesh import Image
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array

Indices = npt.NDArray[np.int64]

TRIANGLES: Final = 4
"""Mode of a primitive whose indices are three a triangle; below it are points and lines (section 5.24.4)."""

STRIP: Final = 5
"""Mode of one in which each further index makes a triangle with the two before it."""

FAN: Final = 6
"""Mode of one in which it does so with the one before it and the first."""

CLAMPED: Final = 33071
"""Wrapping of a texture whose edge goes on without an end (section 5.26.3)."""

SPECULAR: Final = "KHR_materials_pbrSpecularGlossiness"
"""The extension that tells a material's colour as `diffuse…`, archived but found in many files."""

WHITE: Final = (1.0, 1.0, 1.0)
"""Linear light of what tells no factor (section 5.22.1)."""


def read_gltf(path: Path, beside: Beside, looks: bool) -> list[Part]:
    """Read a .gltf or .glb file; parts with one picture are one.

    Args:
        path: of the file.
        beside: reads what it names.
        looks: whether colours and textures are wanted.

    Raises:
        AssetError: it cannot be read; the message names it.
    """
    try:
        file = GltfFile(path, beside)
        reader = _Looks(file, path, beside) if looks else None
        parts = list(_parts(file, reader, path, beside))
    except FileNotFoundError:
        raise beside.problem or AssetError(beside.notes[-1].removesuffix("; built without it")) from None
    except (OSError, AssetError):
        raise
    except Exception as error:  # whatever a foreign file holds in the place of what it should
        raise AssetError(f"{path}: cannot be read as {path.suffix.lower()[1:]} ({error!r:.200})") from None
    return _joined(parts)


def _parts(file: GltfFile, looks: _Looks | None, path: Path, beside: Beside) -> Iterator[Part]:
    """Yield the triangles of each primitive as it is placed."""
    for node, X in file.placed_nodes():
        if "mesh" not in node:
            continue
        if "skin" in node:
            beside.notes.append(f"{path}: hangs on a skeleton (skin); its triangles are taken as they are stored")
        for primitive in file.told["meshes"][node["mesh"]]["primitives"]:
            if primitive.get("mode", TRIANGLES) < TRIANGLES:  # points and lines
                continue
            with np.errstate(invalid="ignore"):  # what is not finite is refused by name afterwards
                vertices = file.array(primitive["attributes"]["POSITION"]) @ X[:3, :3].T + X[:3, 3]
            faces = _faces(file, primitive, len(vertices))
            if np.linalg.det(X[:3, :3]) < 0:  # mirrored
                faces = faces[:, ::-1]
            part = grey(vertices[faces])
            yield part if looks is None else looks.put_on(part, primitive, faces)


def _faces(file: GltfFile, primitive: dict[str, Any], vertices: int) -> Indices:
    """Return the triangles (F, 3) of a primitive."""
    mode = primitive.get("mode", TRIANGLES)
    told = file.array(primitive["indices"])[:, 0] if "indices" in primitive else np.arange(vertices)
    corners = told.astype(np.int64)
    if mode == TRIANGLES:
        return corners.reshape(-1, 3)
    if mode == STRIP:
        faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
        faces[1::2] = faces[1::2, [1, 0, 2]]
        return faces
    if mode == FAN:
        return np.stack([np.broadcast_to(corners[:1], len(corners) - 2), corners[1:-1], corners[2:]], axis=1)
    raise ValueError(f"no such mode: {mode}")


@dataclass(frozen=True)
class _Material:
    """What is read of a material: its factor (3,) of linear light, its picture's place, whether any colour is told."""

    factor: Array
    picture: dict[str, Any] | None
    told: bool


class _Looks:
    """Gives triangles their colours and pictures; each picture is read once."""

    def __init__(self, file: GltfFile, path: Path, beside: Beside) -> None:
        self._file, self._path, self._beside = file, path, beside
        self._pictures: dict[int, Image | None] = {}
        self._tinted: dict[tuple[int, bytes], Image] = {}

    def put_on(self, part: Part, primitive: dict[str, Any], faces: Indices) -> Part:
        """Return a part as its primitive's material and its vertices' colours have it."""
        attributes, material = primitive["attributes"], self._material(primitive)
        tint = None
        if "COLOR_0" in attributes:
            tint = np.clip(self._file.array(attributes["COLOR_0"])[:, :3], 0.0, 1.0)
        picture = material.picture
        if picture is not None and (image := self._picture(picture["index"])) is not None:
            bent = picture.get("extensions", {}).get("KHR_texture_transform", {})
            name = f"TEXCOORD_{bent.get('texCoord', picture.get('texCoord', 0))}"
            if name in attributes:
                uv = _moved(self._file.array(attributes[name]).astype(float), bent)
                if self._sampler(picture["index"]).get("wrapS") == CLAMPED:
                    uv = np.clip(uv, 0.0, 1.0)
                uv[:, 1] = 1.0 - uv[:, 1]
                factor = material.factor if tint is None else material.factor * self._one_tint(tint)
                return replace(part, uv=uv[faces], image=self._lit(picture["index"], image, factor))
        if tint is not None:
            return replace(part, colours=srgb(material.factor * tint[faces].mean(axis=1)))
        return replace(part, colours=np.tile(srgb(material.factor), (len(faces), 1))) if material.told else part

    def _material(self, primitive: dict[str, Any]) -> _Material:
        material = self._file.told["materials"][primitive["material"]] if "material" in primitive else {}
        if material.get("alphaMode") == "MASK":
            self._beside.notes.append(f"{self._path}: what its pictures cut out (alphaMode MASK) counts as solid")
        told, factor, picture = material.get("pbrMetallicRoughness", {}), "baseColorFactor", "baseColorTexture"
        if SPECULAR in material.get("extensions", {}):
            told, factor, picture = material["extensions"][SPECULAR], "diffuseFactor", "diffuseTexture"
        linear = np.clip(np.array(told.get(factor, WHITE), dtype=float)[:3], 0.0, 1.0)
        return _Material(linear, told.get(picture), factor in told or picture in told)

    def _picture(self, texture: int) -> Image | None:
        """Return a texture's picture; None, noted, where it is not there or of a kind that is not read."""
        if texture not in self._pictures:
            told = self._file.told["textures"][texture]
            source = told.get("extensions", {}).get("EXT_texture_webp", {}).get("source", told.get("source"))
            if source is None:
                self._beside.notes.append(f"{self._path}: a picture of a kind that is not read; built without it")
                self._pictures[texture] = None
            else:
                self._pictures[texture] = self._read(self._file.told["images"][source])
        return self._pictures[texture]

    def _read(self, image: dict[str, Any]) -> Image | None:
        uri = image.get("uri", "")
        try:
            data = self._file.named(uri) if uri else self._file.bytes_of(image["bufferView"])
        except FileNotFoundError:
            return None
        try:
            return decoded(data, "")
        except AssetError:
            name = "" if uri.startswith("data:") else uri or image.get("name", "")
            raise AssetError(f"{self._path}: a picture in it cannot be read ({name})") from None

    def _sampler(self, texture: int) -> dict[str, Any]:
        told = self._file.told["textures"][texture]
        return dict(self._file.told["samplers"][told["sampler"]]) if "sampler" in told else {}

    def _one_tint(self, tint: Array) -> Array:
        """Return the colour of all vertices; white, noted, where they differ: a picture has no room for that."""
        if np.ptp(tint, axis=0).max() < 1e-3:
            return np.asarray(tint.mean(axis=0))
        self._beside.notes.append(f"{self._path}: colours of vertices beside a picture (COLOR_0) are left out")
        return np.array(WHITE)

    def _lit(self, texture: int, image: Image, factor: Array) -> Image:
        """Return a picture times a factor of linear light."""
        if np.all(factor == 1.0):
            return image
        key = (texture, factor.tobytes())
        if key not in self._tinted:
            table = np.round(255.0 * srgb(linear(np.arange(256.0)[:, None] / 255.0) * factor)).astype(np.uint8)
            self._tinted[key] = np.stack([table[image[..., k], k] for k in range(3)], axis=-1)
        return self._tinted[key]


def _moved(uv: Array, told: dict[str, Any]) -> Array:
    """Return coordinates (V, 2), v downwards, as KHR_texture_transform has them: scaled, turned, shifted."""
    angle = float(told.get("rotation", 0.0))
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return np.asarray((uv * told.get("scale", (1.0, 1.0))) @ turn.T + told.get("offset", (0.0, 0.0)))


def srgb(linear_light: Array) -> Array:
    """Return linear light in [0, 1] as sRGB (IEC 61966-2-1)."""
    bright = 1.055 * np.maximum(linear_light, 1e-12) ** (1 / 2.4) - 0.055
    return np.where(linear_light <= 0.0031308, 12.92 * linear_light, bright)


def linear(colours: Array) -> Array:
    """Return sRGB in [0, 1] as linear light (IEC 61966-2-1)."""
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def _joined(parts: list[Part]) -> list[Part]:
    """Return parts, those with the same picture as one, and those without as another."""
    alike: dict[int, list[Part]] = {}
    for part in parts:
        alike.setdefault(id(part.image), []).append(part)
    return [
        Part(
            np.concatenate([part.corners for part in group]),
            None if group[0].image is None else np.concatenate([part.uv for part in group if part.uv is not None]),
            group[0].image,
            np.concatenate([part.colours for part in group]),
        )
        for group in alike.values()
    ]
