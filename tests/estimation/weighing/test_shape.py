"""Moments of surfaces against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.estimation.weighing import Shape, WeighingError
from twin_diagram.model.rigid_body.mass_properties import about_centre

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
     [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)  # fmt: skip


def test_a_box_of_triangles_is_the_box() -> None:
    edges, at = np.array([0.06, 0.09, 0.175]), np.array([0.1, -0.2, 0.3])
    mesh, box = Shape.of_mesh((CORNERS - 0.5) * edges + at, FACES), Shape.box(edges)
    np.testing.assert_allclose(mesh.centre, at, atol=1e-12)
    np.testing.assert_allclose(mesh.shell_centre, at, atol=1e-12)
    np.testing.assert_allclose(mesh.second, box.second, atol=1e-12)
    np.testing.assert_allclose(mesh.shell_second, box.shell_second, atol=1e-12)
    np.testing.assert_allclose(np.diag(box.second), edges**2 / 12.0)
    np.testing.assert_allclose(mesh.middle, at, atol=1e-12)
    np.testing.assert_allclose(mesh.half, box.half, atol=1e-12)


def test_the_wall_of_a_cube_has_five_thirds_of_the_solid() -> None:
    # ∫ x² over a cube's surface of side a: (2 · a²/4 + 4 · a²/12) / 6 = 5 a²/36, against a²/12.
    cube = Shape.box(np.full(3, 0.3))
    np.testing.assert_allclose(np.diag(cube.shell_second), 5.0 * 0.09 / 36.0)


def test_an_open_surface_is_filled() -> None:
    whole, open_box = Shape.of_mesh(CORNERS, FACES), Shape.of_mesh(CORNERS, FACES[2:])
    np.testing.assert_allclose(np.diag(open_box.second), np.diag(whole.second), rtol=0.06)


def test_even_mass_has_the_textbook_inertia() -> None:
    mass, centre, inertia = about_centre(Shape.box(np.array([0.1, 0.2, 0.3])).even(1.2))
    assert mass == 1.2
    np.testing.assert_allclose(centre, 0.0)
    np.testing.assert_allclose(np.diag(inertia), 0.1 * np.array([0.13, 0.1, 0.05]))


@pytest.mark.parametrize("edges", [[0.1, 0.1], [0.1, 0.1, 0.0], [0.1, 0.1, np.nan]])
def test_what_is_no_box_is_refused(edges: list[float]) -> None:
    with pytest.raises(WeighingError, match="three positive edges"):
        Shape.box(np.array(edges))


def test_a_sheet_and_broken_vertices_are_refused() -> None:
    with pytest.raises(WeighingError, match="plane"):
        Shape.of_mesh(CORNERS * [1.0, 1.0, 0.0], FACES)
    spoilt = CORNERS.copy()
    spoilt[3, 1] = np.inf
    with pytest.raises(WeighingError, match="not finite"):
        Shape.of_mesh(spoilt, FACES)
