"""The things of the benchmarks, each as the asset that a tracker is told and the mesh that the camera sees."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import trimesh
from scipy.spatial import ConvexHull

from twin_diagram.assets import Asset
from twin_diagram.assets.mesh import Image, Mesh, read_obj, read_png, sample
from twin_diagram.scenario import models_dir

Array = npt.NDArray[np.float64]

YCB = (
    "003_cracker_box",
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "009_gelatin_box",
    "010_potted_meat_can",
)
OWN = ("mug", "can", "bottle")
ROUND = ("005_tomato_soup_can", "can", "bottle")
"""Without texture, turning these about z cannot be told."""
GREY = 150
"""Of a thing without texture [of 255]."""
POINTS = 3000
"""Of an asset's cloud, as `assets.Asset` samples it."""


@dataclass(frozen=True)
class Thing:
    """A thing: what the tracker is told of it, and what the camera sees.

    Attributes:
        asset: what the tracker is told.
        mesh: in O, its origin the middle of its box.
        texture: (h, w, 3) RGB.
        symmetric: `z` where turning about it cannot be told, else None.
    """

    asset: Asset
    mesh: Mesh
    texture: Image
    symmetric: str | None


def _gltf(path: Path) -> tuple[Mesh, Image]:
    """Read a glTF whose y is up; the middle of its box becomes the origin."""
    scene: Any = trimesh.load(path, force="mesh", process=False)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    vertices = np.asarray(scene.vertices) @ turn.T
    vertices = vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    material = scene.visual.material
    image = getattr(material, "baseColorTexture", None) or material.image
    uv = np.asarray(scene.visual.uv, dtype=float)
    normals = np.asarray(scene.vertex_normals) @ turn.T
    return Mesh(vertices, normals, uv, np.asarray(scene.faces)), np.asarray(image.convert("RGB"))


def _asset(name: str, mesh: Mesh, texture: Image, symmetric: str | None) -> Asset:
    cloud = sample(mesh, texture, POINTS)
    hull = mesh.vertices[ConvexHull(mesh.vertices).vertices]
    size = mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0)
    axis = "z" if symmetric == "z" else None
    return Asset(name, Path(name), cloud.points, cloud.normals, cloud.colours, axis, (hull,), 0.5, size)


@cache
def thing(name: str, data: Path | None = None) -> Thing:
    """Return a thing by name; `grey_` before it takes its texture away.

    Args:
        name: of `YCB` or `OWN`.
        data: folder that holds `ycb/`.
    """
    grey = name.startswith("grey_")
    plain = name.removeprefix("grey_")
    if plain in OWN:
        folder = models_dir() / "objects" / plain
        mesh, texture = read_obj(folder / "visual.obj"), read_png(folder / "visual.png")
        symmetric = Asset.load(folder).symmetric_axis
    else:
        assert data is not None, "the YCB meshes are found by $TWIN_DIAGRAM_DATA"
        mesh, texture = _gltf(data / "ycb" / f"{plain}_textured.gltf")
        symmetric = None
    if grey:
        texture = np.full_like(texture, GREY)
        symmetric = "z" if plain in ROUND else None
    return Thing(_asset(name, mesh, texture, symmetric), mesh, texture, symmetric)
