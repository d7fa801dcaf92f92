"""Puts right mesh files that Drake reads in part: OBJ without normals or with pictures other than PNG, and GLB."""

from __future__ import annotations

import base64
import bisect
import json
import re
import struct
from collections.abc import Mapping

import numpy as np

from twin_diagram.signals.arrays import Array

_NORMAL = re.compile(rb"^[ \t]*vn[ \t]", re.MULTILINE)
"""Of an OBJ: a normal."""
_VERTEX = re.compile(rb"^[ \t]*v[ \t]+(\S+)[ \t]+(\S+)[ \t]+(\S+)", re.MULTILINE)
"""Of an OBJ: a vertex, and its coordinates."""
_FACE = re.compile(rb"^[ \t]*f[ \t]+([^#\r\n]+)", re.MULTILINE)
"""Of an OBJ: a face, and its corners."""
_LIBRARY = re.compile(rb"^([ \t]*mtllib[ \t]+)([^\r\n]+?)[ \t]*$", re.MULTILINE)
"""Of an OBJ: what stands before a file of materials, and the file."""
_PICTURE = re.compile(rb"^([ \t]*map_\w+[ \t]+)([^-\s][^\r\n]*?)[ \t]*$", re.MULTILINE)
"""Of an OBJ's materials: what stands before a picture's file, and the file."""
_COLOURS = re.compile(rb"^([ \t]*map_Kd[ \t]+)([^-\s][^\r\n]*?)[ \t]*$", re.MULTILINE)
"""The same of the one picture that Drake draws."""


def lacks_normals(content: bytes) -> bool:
    """Return whether an OBJ has faces, and no normals."""
    return _NORMAL.search(content) is None and _FACE.search(content) is not None


def libraries(content: bytes) -> list[str]:
    """Return the files of materials that an OBJ names."""
    return [match[2].decode(errors="replace") for match in _LIBRARY.finditer(content)]


def moved(materials: bytes, way: str) -> bytes:
    """Return an OBJ's materials whose pictures are found from another folder; `way` leads from there to their own."""
    return _PICTURE.sub(lambda match: match[1] + f"{way}/{match[2].decode(errors='replace')}".encode(), materials)


def other_pictures(materials: bytes) -> list[str]:
    """Return the pictures that Drake draws of an OBJ's materials and that are no PNG, the one kind that it reads."""
    names = (match[2].decode(errors="replace") for match in _COLOURS.finditer(materials))
    return [name for name in dict.fromkeys(names) if not name.lower().endswith(".png")]


def with_pictures(materials: bytes, others: Mapping[str, str]) -> bytes:
    """Return an OBJ's materials with others in the place of some pictures, or without where the other has no name."""

    def put(match: re.Match[bytes]) -> bytes:
        other = others.get(match[2].decode(errors="replace"))
        return match[0] if other is None else match[1] + other.encode() if other else b""

    return _COLOURS.sub(put, materials)


def with_normals(content: bytes) -> bytes:
    """Return an OBJ's text with the normals of its faces' planes; `content` has none.

    Raises:
        ValueError: a face speaks of a vertex that is not there, or a number cannot be read.
    """
    vertices = np.array(_VERTEX.findall(content), dtype=float).reshape(-1, 3)
    starts = [match.start() for match in _VERTEX.finditer(content)]
    normals: list[str] = []

    def face(match: re.Match[bytes]) -> bytes:
        corners = [each.split(b"/") for each in match[1].split()]
        numbers = [int(corner[0]) for corner in corners]
        if any(not 0 < abs(number) <= len(vertices) for number in numbers):
            raise ValueError(f"the face {match[1].decode(errors='replace').strip()} lacks a vertex")
        before = bisect.bisect(starts, match.start())  # numbers below 0 count backwards from here
        points = vertices[[number - 1 if number > 0 else before + number for number in numbers]]
        normals.append("vn {:.6g} {:.6g} {:.6g}\n".format(*_across(points)))
        uses = (b"%s/%s/%d" % (corner[0], corner[1] if len(corner) > 1 else b"", len(normals)) for corner in corners)
        return b"f " + b" ".join(uses)

    text = _FACE.sub(face, content)
    return "".join(normals).encode() + text


def _across(points: Array) -> Array:
    """Return a face's normal; up where it has no area."""
    area = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    size = float(np.linalg.norm(area))
    return area / size if size > 0.0 else np.array([0.0, 0.0, 1.0])


def gltf_of(content: bytes) -> bytes:
    """Return the glTF of a GLB, all in one file.

    Raises:
        ValueError: it is no GLB of version 2, or is cut off.
    """
    if len(content) < 20 or content[:4] != b"glTF":
        raise ValueError("it is no GLB")
    version, length = struct.unpack_from("<II", content, 4)
    if version != 2 or length > len(content):
        raise ValueError(f"it is a GLB of version {version} with {len(content)} of {length} bytes")
    chunks: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack_from("<I4s", content, at)
        chunks.setdefault(kind, content[at + 8 : at + 8 + size])
        at += 8 + size
    tree = json.loads(chunks.get(b"JSON", b"null"))
    if not isinstance(tree, dict):
        raise ValueError("its first part is no glTF")
    buffers = tree.get("buffers", [])
    if b"BIN\0" in chunks and buffers:
        buffers[0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(chunks[b"BIN\0"]).decode()
    return json.dumps(tree).encode()
