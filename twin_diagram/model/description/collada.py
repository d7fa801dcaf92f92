"""Reads the triangles of a COLLADA file (.dae).

As robot descriptions mean them: lengths in the file's unit become metres, and its up axis is left as it is.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array

_NAMESPACE = re.compile(rb"""\sxmlns\s*=\s*("[^"]*"|'[^']*')""")
"""Of all elements: without it their names are as they stand."""


def corners(content: bytes) -> Array:
    """Return the corners (T, 3, 3) of all triangles of the scene [m].

    Args:
        content: of the file.

    Raises:
        ElementTree.ParseError: no XML.
        ValueError, IndexError, KeyError: a number, a count or a name that is wrong.
    """
    root = ElementTree.fromstring(_NAMESPACE.sub(b"", content, count=1))
    unit = root.find("asset/unit")
    scale = float(unit.get("meter", "1")) if unit is not None else 1.0
    shapes = {
        geometry.get("id", ""): _triangles(mesh)
        for geometry in root.findall("library_geometries/geometry")
        for mesh in geometry.findall("mesh")
    }
    nodes = {node.get("id", ""): node for node in root.iter("node")}
    scenes = root.findall("library_visual_scenes/visual_scene")
    placed = [part for scene in scenes for part in _placed(scene, np.eye(4), shapes, nodes)]
    parts = placed or list(shapes.values())
    return scale * np.concatenate(parts) if parts else np.zeros((0, 3, 3))


def _placed(element: Element, X: Array, shapes: dict[str, Array], nodes: dict[str, Element]) -> Iterator[Array]:
    for use in element.findall("instance_geometry"):
        shape = shapes.get(_named(use), np.zeros((0, 3, 3)))
        there = shape @ X[:3, :3].T + X[:3, 3]
        yield there if np.linalg.det(X[:3, :3]) > 0.0 else there[:, ::-1]
    inner = [*element.findall("node"), *(nodes[_named(use)] for use in element.findall("instance_node"))]
    for node in inner:
        yield from _placed(node, X @ _pose(node), shapes, nodes)


def _named(use: Element) -> str:
    return use.get("url", "").lstrip("#")


def _pose(node: Element) -> Array:
    """Return what a node's steps do (4, 4), the first of them outermost."""
    X = np.eye(4)
    for step in node:
        if step.tag not in ("matrix", "translate", "rotate", "scale"):
            continue
        numbers = _numbers(step)
        one = np.eye(4)
        if step.tag == "matrix":
            one = numbers.reshape(4, 4)
        elif step.tag == "translate":
            one[:3, 3] = numbers
        elif step.tag == "scale":
            one[:3, :3] = np.diag(numbers)
        else:
            axis = numbers[:3] / np.linalg.norm(numbers[:3])
            one[:3, :3] = rotations.matrix(rotations.exp(np.radians(numbers[3]) * axis))
        X = X @ one
    return X


def _triangles(mesh: Element) -> Array:
    """Return the corners (T, 3, 3) of a mesh, in its own frame; polygons are fans."""
    sources = {source.get("id", ""): source for source in mesh.findall("source")}
    positions = {
        vertices.get("id", ""): _points(sources[part.get("source", "").lstrip("#")])
        for vertices in mesh.findall("vertices")
        for part in vertices.findall("input")
        if part.get("semantic") == "POSITION"
    }
    parts = [np.zeros((0, 3, 3))]
    for kind in ("triangles", "polylist", "polygons"):
        for group in mesh.findall(kind):
            inputs = {part.get("semantic"): part for part in group.findall("input")}
            width = 1 + max(int(part.get("offset", "0")) for part in inputs.values())
            vertex = inputs["VERTEX"]
            column = int(vertex.get("offset", "0"))
            rows = [_integers(each).reshape(-1, width)[:, column] for each in group.findall("p")]
            if rows:
                points = positions[vertex.get("source", "").lstrip("#")]
                parts.append(points[_fans(kind, group, rows)])
    return np.concatenate(parts)


def _fans(kind: str, group: Element, rows: list[npt.NDArray[np.int64]]) -> npt.NDArray[np.int64]:
    """Return the corners' numbers (T, 3)."""
    if kind == "triangles":
        return np.concatenate(rows).reshape(-1, 3)
    counts = group.find("vcount")
    many = _integers(counts) if kind == "polylist" and counts is not None else np.array([len(row) for row in rows])
    every = np.concatenate(rows)
    if many.sum() != len(every):
        raise ValueError(f"{many.sum()} corners are counted, {len(every)} are there")
    triangles = np.maximum(many - 2, 0)
    fan = np.repeat(np.arange(len(many)), triangles)
    step = np.arange(len(fan)) - (np.cumsum(triangles) - triangles)[fan]
    start = (np.cumsum(many) - many)[fan]
    return every[np.stack([start, start + 1 + step, start + 2 + step], axis=1)]


def _points(source: Element) -> Array:
    accessor = source.find("technique_common/accessor")
    stride = int(accessor.get("stride", "3")) if accessor is not None else 3
    values = source.find("float_array")
    return np.zeros((0, 3)) if values is None else _numbers(values).reshape(-1, stride)[:, :3]


def _numbers(element: Element) -> Array:
    return np.array((element.text or "").split(), dtype=float)


def _integers(element: Element) -> npt.NDArray[np.int64]:
    return np.array((element.text or "").split(), dtype=np.int64)
