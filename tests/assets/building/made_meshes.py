"""Meshes with known volume and inertia, and files of them as people bring them along."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from twin_diagram.assets.building.surface import Surface, weld
from twin_diagram.signals.arrays import Array


def surface_of(mesh: trimesh.Trimesh) -> Surface:
    return weld(np.asarray(mesh.triangles))


def box(*edges: float, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(extents=edges)
    mesh.apply_translation(at)
    return mesh


def hollow_box() -> trimesh.Trimesh:
    """A box of 10 × 8 × 6 cm with a closed cavity of 6 × 4 × 2 cm, off its middle by 1 cm along x."""
    cavity = box(0.06, 0.04, 0.02, at=(0.01, 0.0, 0.0))
    cavity.invert()
    return trimesh.util.concatenate([box(0.10, 0.08, 0.06), cavity])


def corner() -> trimesh.Trimesh:
    """Two bars of 12 × 4 × 4 cm that make an L in x and z, as one closed surface."""
    outline = np.array([[0, 0], [0.12, 0], [0.12, 0.04], [0.04, 0.04], [0.04, 0.12], [0, 0.12]])
    caps = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    n = len(outline)
    vertices = np.concatenate([np.insert(outline, 1, y, axis=1) for y in (0.0, 0.04)])
    sides = [[[k, (k + 1) % n + n, (k + 1) % n], [k, k + n, (k + 1) % n + n]] for k in range(n)]
    faces = np.concatenate([caps, caps[:, ::-1] + n, np.reshape(sides, (-1, 3))])
    return trimesh.Trimesh(vertices, faces, process=False)


def box_inertia(mass: float, x: float, y: float, z: float) -> Array:
    return np.diag([y * y + z * z, x * x + z * z, x * x + y * y]) * mass / 12


def write_coloured(folder: Path, name: str = "box", size: tuple[float, float, float] = (0.1, 0.06, 0.04)) -> Path:
    """Write a box as OBJ whose top (+z) shows a picture, red left of green, and whose other sides are blue."""
    folder.mkdir(parents=True, exist_ok=True)
    picture = np.zeros((32, 64, 3), np.uint8)
    picture[:, :32, 0] = 255
    picture[:, 32:, 1] = 255
    Image.fromarray(picture).save(folder / "top.png")
    (folder / f"{name}.mtl").write_text("newmtl side\nKd 0 0 1\nnewmtl top\nmap_Kd -s 1 1 1 top.png\n")
    x, y, z = np.array(size) / 2
    corners = [(a * x, b * y, c * z) for c in (-1, 1) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    lines = [f"mtllib {name}.mtl", *("v {} {} {}".format(*c) for c in corners)]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "usemtl side"]
    lines += ["f 4 3 2 1", "f 1 2 6 5", "f 2 3 7 6", "f 3 4 8 7", "f 4 1 5 8"]
    lines += ["usemtl top", "f 5/1 6/2 7/3 8/4"]
    (folder / f"{name}.obj").write_text("\n".join(lines) + "\n")
    return folder / f"{name}.obj"
