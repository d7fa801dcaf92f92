"""Meshes of simple shapes: closed, of the right volume, and their texels where the mesh says."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from twin_diagram.assets import shapes
from twin_diagram.assets.shapes import Patchwork
from twin_diagram.signals.arrays import Array

R, H = 0.04, 0.12
MADE: dict[str, Callable[[], Patchwork]] = {
    "box": lambda: shapes.box((0.08, 0.06, 0.1)),
    "can": lambda: shapes.can(R, H),
    "bottle": lambda: shapes.bottle(R, H),
    "mug": lambda: shapes.mug(R, H),
}
POLYGON = 40 / (2 * np.pi) * np.sin(2 * np.pi / 40)
"""Area of a regular polygon of 40 corners over that of its circle."""


def corners(made: Patchwork) -> Array:
    return made.mesh.vertices[made.mesh.faces]


def volume(made: Patchwork) -> float:
    a, b, c = np.moveaxis(corners(made), 1, 0)
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


@pytest.mark.parametrize("name", MADE)
def test_normals_are_unit_and_on_the_side_of_the_triangles(name: str) -> None:
    mesh = MADE[name]().mesh
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-12)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    flat = np.cross(b - a, c - a)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    along = np.einsum("fi,fki->fk", flat, mesh.normals[mesh.faces])
    assert along.min() > (0.85 if name in ("bottle", "mug") else 0.99)


def test_volumes() -> None:
    assert volume(MADE["box"]()) == pytest.approx(0.08 * 0.06 * 0.1)
    assert volume(MADE["can"]()) == pytest.approx(POLYGON * np.pi * R**2 * H)
    # The bottle: a cylinder to 0.12 of the height above the middle, a quarter of an ellipse, a neck from 0.32 up.
    t = np.linspace(0, np.pi / 2, 7)
    r, z = 0.36 * R + 0.64 * R * np.cos(t), 0.12 * H + 0.2 * H * np.sin(t)
    cones = np.sum(np.diff(z) * (r[1:] ** 2 + r[1:] * r[:-1] + r[:-1] ** 2) / 3)
    expected = np.pi * POLYGON * (R**2 * 0.62 * H + cones + (0.36 * R) ** 2 * 0.18 * H)
    assert volume(MADE["bottle"]()) == pytest.approx(expected)
    # The mug: its wall and floor of 4 mm, and half an ellipse of tube, 12 mm thick.
    wall = np.pi * POLYGON * (R**2 * H - (R - 0.004) ** 2 * (H - 0.004))
    arc = np.linspace(-np.pi / 2, np.pi / 2, 2001)
    length = np.sum(np.hypot(np.diff(0.62 * R * np.cos(arc)), np.diff(0.3 * H * np.sin(arc))))
    assert volume(MADE["mug"]()) == pytest.approx(wall + np.pi * 0.006**2 * length, rel=0.02)


def test_a_mugs_handle_starts_in_its_wall_and_reaches_out() -> None:
    mesh = MADE["mug"]().mesh
    handle = mesh.vertices[mesh.vertices[:, 0] > R + 1e-6]
    assert handle[:, 0].max() == pytest.approx(R - 0.002 + 0.62 * R + 0.006)
    assert np.abs(handle[:, 1]).max() == pytest.approx(0.006)
    assert np.abs(handle[:, 2]).max() == pytest.approx(0.3 * H + 0.006, rel=0.03)
    assert shapes.handle_reach(R, H) == (pytest.approx(0.62 * R), pytest.approx(0.3 * H))
    assert mesh.vertices[:, 2].max() == pytest.approx(H / 2)
    inside = mesh.vertices[(np.hypot(*mesh.vertices.T[:2]) < R - 0.003) & (mesh.vertices[:, 0] < 0)]
    assert inside[:, 2].max() == pytest.approx(H / 2)  # the inner side of the wall goes up to the rim
    assert inside[:, 2].min() == pytest.approx(0.004 - H / 2)  # and down to the floor


@pytest.mark.parametrize("name", MADE)
def test_texels_hold_the_points_that_the_mesh_shows_there(name: str) -> None:
    made = MADE[name]()
    mesh, (height, width) = made.mesh, made.texels.shape[:2]
    column, row = mesh.uv[:, 0] * width - 0.5, (1 - mesh.uv[:, 1]) * height - 0.5
    assert column.min() >= -1e-9 and row.min() >= -1e-9
    assert column.max() <= width - 1 + 1e-9 and row.max() <= height - 1 + 1e-9
    near = made.texels[row.round().astype(int), column.round().astype(int)]
    assert np.linalg.norm(near - mesh.vertices, axis=1).max() < 0.004


def test_a_sharp_edge_has_the_normals_of_both_sides() -> None:
    mesh = MADE["can"]().mesh
    top_rim = np.isclose(mesh.vertices[:, 2], H / 2) & np.isclose(np.hypot(*mesh.vertices.T[:2]), R)
    normals = mesh.normals[top_rim]
    up = normals[:, 2] > 0.5
    np.testing.assert_allclose(normals[up], np.tile([0, 0, 1.0], (up.sum(), 1)), atol=1e-9)
    outward = mesh.vertices[top_rim][~up] / R * [1, 1, 0]
    np.testing.assert_allclose(normals[~up], outward, atol=1e-9)
    assert up.sum() == (~up).sum() == 41
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 1e-9  # no triangle without area
