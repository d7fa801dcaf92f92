"""What a glTF 2.0 file holds: its JSON, its arrays, its pictures, and where its nodes stand.

Source: Khronos Group, glTF 2.0 specification (2021), sections 3.5, 3.6 and 4.4; KHR_mesh_quantization.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from twin_diagram.assets.building.named_files import Beside
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array

KINDS: Final = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""NumPy's names of an accessor's `componentType` (section 3.6.2.2)."""

WIDTHS: Final = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
"""Numbers in one row of an accessor's `type`."""

COMPRESSED: Final = {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"}
"""Extensions that pack triangles; where a file requires one, it holds nothing else."""

LOOKS: Final = ("KHR_materials_", "KHR_texture_", "KHR_technique", "KHR_lights", "EXT_texture_", "MSFT_texture_")
"""Beginnings of extensions that change looks alone."""


class GltfFile:
    """Reads one .gltf or .glb file.

    Args:
        path: of the file.
        beside: reads what it names.

    Raises:
        AssetError: it is none, another version, or its triangles are compressed.
    """

    def __init__(self, path: Path, beside: Beside) -> None:
        data = path.read_bytes()
        kind = path.suffix.lower()[1:]
        if kind == "glb" and data[:4] != b"glTF":
            raise AssetError(f"{path}: cannot be read as glb: it does not begin as one")
        chunks = list(_chunks(data)) if data[:4] == b"glTF" else [data]
        try:
            self.told: dict[str, Any] = json.loads(chunks[0])
            required = set(self.told.get("extensionsRequired", ()))
        except (ValueError, AttributeError, TypeError, IndexError):
            raise AssetError(f"{path}: cannot be read as {kind}: it holds no JSON object") from None
        version = str(self.told.get("asset", {}).get("version", "none"))
        if not version.startswith("2."):
            raise AssetError(f"{path}: glTF of version {version} is not read; export it as glTF 2.0")
        if unread := required & COMPRESSED:
            raise AssetError(f"{path}: its triangles are compressed ({min(unread)}); export it without compression")
        if unread := {name for name in required if not name.startswith(("KHR_mesh_quantization", *LOOKS))}:
            raise AssetError(f"{path}: needs {min(unread)}, which is not read; export it without")
        self._path, self._beside, self._chunks = path, beside, chunks
        self._buffers: dict[int, bytes] = {}

    def array(self, index: int) -> Array:
        """Return the rows (count, width) of an accessor: whole numbers, or floats where it holds such or shares."""
        told = self.told["accessors"][index]
        kind, width, count = np.dtype(KINDS[told["componentType"]]), WIDTHS[told["type"]], int(told["count"])
        if "bufferView" in told:
            rows = self._rows(told, kind, count, width)
        else:
            rows = np.zeros((count, width), kind)
        if sparse := told.get("sparse"):
            at = sparse["indices"]
            which = self._rows(at, np.dtype(KINDS[at["componentType"]]), int(sparse["count"]), 1)[:, 0]
            rows[which] = self._rows(sparse["values"], kind, len(which), width)
        if told.get("normalized") and kind.kind != "f":
            return np.maximum(rows / np.iinfo(kind).max, -1.0)
        return rows

    def _rows(self, place: dict[str, Any], kind: np.dtype[Any], count: int, width: int) -> npt.NDArray[Any]:
        """Return rows from a part of a buffer, each at its stride."""
        stride = self.told["bufferViews"][place["bufferView"]].get("byteStride", width * kind.itemsize)
        data, offset = self.bytes_of(place["bufferView"]), int(place.get("byteOffset", 0))
        return np.ndarray((count, width), kind, data, offset, (stride, kind.itemsize)).copy()

    def bytes_of(self, view: int) -> bytes:
        """Return what lies in one part of a buffer."""
        told = self.told["bufferViews"][view]
        index, start, length = told["buffer"], told.get("byteOffset", 0), told["byteLength"]
        if index not in self._buffers:
            self._buffers[index] = self._buffer(index)
        data = self._buffers[index][start : start + length]
        if len(data) < length:
            raise ValueError("a buffer is shorter than it is told to be")
        return data

    def _buffer(self, index: int) -> bytes:
        uri = self.told["buffers"][index].get("uri")
        if uri is not None:
            return self.named(uri)
        if index or len(self._chunks) < 2:
            raise ValueError("a buffer has no data")
        return self._chunks[1]

    def named(self, uri: str) -> bytes:
        """Return what a URI holds itself, or the file that it names.

        Raises:
            FileNotFoundError: that file is not there.
        """
        if uri.startswith("data:"):
            return base64.b64decode(uri.partition("base64,")[2], validate=True)
        return self._beside.get(unquote(uri))

    def placed_nodes(self) -> Iterator[tuple[dict[str, Any], Array]]:
        """Yield the nodes of the scene that is shown, each once, with its pose and scale (4, 4) in the scene."""
        nodes: list[dict[str, Any]] = self.told.get("nodes", [])
        if scenes := self.told.get("scenes"):
            roots = scenes[self.told.get("scene", 0)].get("nodes", ())
        else:
            children = {child for node in nodes for child in node.get("children", ())}
            roots = [k for k in range(len(nodes)) if k not in children]
        waiting, seen = [(root, np.eye(4)) for root in reversed(roots)], set[int]()
        while waiting:
            k, above = waiting.pop()
            if k in seen:
                continue
            seen.add(k)
            X = above @ _own_place(nodes[k])
            yield nodes[k], X
            waiting.extend((child, X) for child in reversed(nodes[k].get("children", ())))


def _chunks(data: bytes) -> Iterator[bytes]:
    """Yield the chunks of a .glb file, JSON first."""
    at = 12
    while at + 8 <= len(data):
        length = int.from_bytes(data[at : at + 4], "little")
        yield data[at + 8 : at + 8 + length]
        at += 8 + length


def _own_place(node: dict[str, Any]) -> Array:
    """Return a node's pose and scale (4, 4) in its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=float).reshape(4, 4).T
    X = np.eye(4)
    X[:3, :3] = Rotation.from_quat(node.get("rotation", (0, 0, 0, 1))).as_matrix() * node.get("scale", (1, 1, 1))
    X[:3, 3] = node.get("translation", (0, 0, 0))
    return X
