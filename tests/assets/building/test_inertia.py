"""Volume, centre and inertia against closed forms: boxes, cylinders, balls, cavities, surfaces with holes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tests.assets.building.made_meshes import box, box_inertia, corner, hollow_box, surface_of
from twin_diagram.assets.building.inertia import Hollow, hull_of, less, outward, solid_of, spread
from twin_diagram.assets.building.overlap import _stretches, overlap
from twin_diagram.assets.building.surface import weld
from twin_diagram.errors import AssetError


def test_a_box_anywhere_is_exact() -> None:
    solid = solid_of(surface_of(box(0.1, 0.2, 0.05, at=(1.0, -2.0, 0.5))))
    assert solid.by == "surface"
    assert solid.volume == pytest.approx(1e-3, rel=1e-9)
    np.testing.assert_allclose(solid.centre, [1.0, -2.0, 0.5], atol=1e-9)
    np.testing.assert_allclose(solid.inertia(2.0), box_inertia(2.0, 0.1, 0.2, 0.05), rtol=1e-6, atol=1e-12)


def test_what_is_empty_in_the_mean_is_missing_from_volume_centre_and_moments() -> None:
    at = np.array([1.0, -2.0, 0.5])
    full = solid_of(surface_of(box(0.1, 0.2, 0.05, at=tuple(at))))
    cells = np.stack(np.meshgrid(*[(np.arange(n) + 0.5) * 1e-3 for n in (40, 80, 20)], indexing="ij"), axis=-1)
    places = cells.reshape(-1, 3) - [0.045, 0.095, 0.02] + at
    found = less(full, Hollow(places, np.full(len(places), 1e-9)))
    parts = [box(0.1, 0.2, 0.05, at=tuple(at)), box(0.04, 0.08, 0.02, at=tuple(at - [0.025, 0.055, 0.01]))]
    parts[1].invert()
    true = solid_of(surface_of(trimesh.util.concatenate(parts)))
    assert found.volume == pytest.approx(1e-3 - 64e-6, rel=1e-9) and true.volume == pytest.approx(found.volume)
    np.testing.assert_allclose(found.centre, true.centre, atol=1e-8)
    np.testing.assert_allclose(found.inertia(2.0), true.inertia(2.0), rtol=2e-4, atol=1e-9)


def test_a_prism_is_the_cylinder_that_it_stands_for() -> None:
    n, r, h, m = 256, 0.03, 0.1, 0.4
    solid = solid_of(surface_of(trimesh.creation.cylinder(radius=r, height=h, sections=n)))
    share = np.sin(2 * np.pi / n) / (2 * np.pi / n)  # of the prism's area in the circle's
    assert solid.volume == pytest.approx(np.pi * r * r * h * share, rel=1e-9)
    across, along = m * (3 * r * r + h * h) / 12, m * r * r / 2
    np.testing.assert_allclose(solid.inertia(m), np.diag([across, across, along]), rtol=1e-3, atol=1e-9)


def test_products_of_inertia_have_their_sign() -> None:
    """Of an L in the plane of x and z, as two boxes with Steiner's terms."""
    solid = solid_of(surface_of(corner()))
    parts = [(np.array([0.12, 0.04, 0.04]), np.array([0.06, 0.02, 0.02]))]
    parts += [(np.array([0.04, 0.04, 0.08]), np.array([0.02, 0.02, 0.08]))]
    volumes = [edges.prod() for edges, _ in parts]
    centre = sum(v * c for v, (_, c) in zip(volumes, parts, strict=True)) / sum(volumes)
    inertia = np.zeros((3, 3))
    for v, (edges, c) in zip(volumes, parts, strict=True):
        d = c - centre
        inertia += box_inertia(1000 * v, *edges) + 1000 * v * (d @ d * np.eye(3) - np.outer(d, d))
    assert solid.volume == pytest.approx(sum(volumes), rel=1e-9)
    np.testing.assert_allclose(solid.centre, centre, atol=1e-9)
    np.testing.assert_allclose(solid.inertia(1000 * sum(volumes)), inertia, rtol=1e-6, atol=1e-12)
    assert solid.inertia(1.0)[0, 2] > 1e-5  # mass where x and z differ in sign


def test_a_cavity_is_empty() -> None:
    solid = solid_of(surface_of(hollow_box()))
    outer, inner = 0.1 * 0.08 * 0.06, 0.06 * 0.04 * 0.02
    assert solid.by == "surface" and solid.volume == pytest.approx(outer - inner, rel=1e-9)
    x = -inner * 0.01 / (outer - inner)
    np.testing.assert_allclose(solid.centre, [x, 0, 0], atol=1e-9)
    far = np.diag([0.0, 1.0, 1.0])
    expected = box_inertia(1000 * outer, 0.1, 0.08, 0.06) + 1000 * outer * x * x * far
    expected -= box_inertia(1000 * inner, 0.06, 0.04, 0.02) + 1000 * inner * (0.01 - x) ** 2 * far
    np.testing.assert_allclose(solid.inertia(1000 * (outer - inner)), expected, rtol=1e-6, atol=1e-12)


def test_what_bodies_share_counts_once() -> None:
    """A cube of 6 cm and one of 4 cm, a quarter of which sticks out of it; a bar across another."""
    cubes = trimesh.util.concatenate([box(0.06, 0.06, 0.06), box(0.04, 0.04, 0.04, at=(0.03, 0.0, 0.0))])
    solid = solid_of(surface_of(cubes))
    assert solid.by == "filling"
    assert solid.volume == pytest.approx(0.06**3 + 0.04**3 / 2, rel=0.01)
    assert solid.centre[0] == pytest.approx(0.04**3 / 2 * 0.04 / (0.06**3 + 0.04**3 / 2), rel=0.05)
    bars = trimesh.util.concatenate([box(0.1, 0.02, 0.02), box(0.02, 0.1, 0.02), box(0.01, 0.01, 0.01)])
    assert overlap(surface_of(bars)) == pytest.approx(0.02**3 / (2 * 0.1 * 0.02**2 - 0.02**3), rel=0.3)
    assert solid_of(surface_of(bars)).volume == pytest.approx(2 * 0.1 * 0.02**2 - 0.02**3, rel=0.02)


def test_bodies_that_overlap_or_touch_are_one_along_rays() -> None:
    """Two boxes that make a longer one, beside each other, through each other, or twice the same; turned; two balls."""
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])
    for apart in (0.0, 0.05, 0.1):
        both = trimesh.util.concatenate([box(0.1, 0.06, 0.04), box(0.1, 0.06, 0.04, at=(apart, 0.0, 0.0))])
        long, due = 0.1 + apart, 1000 * (0.1 + apart) * 0.06 * 0.04
        solid = solid_of(surface_of(both))
        assert solid.by == "filling" and solid.volume == pytest.approx(due / 1000, rel=1e-6)
        np.testing.assert_allclose(solid.centre, [apart / 2, 0, 0], atol=1e-7)
        np.testing.assert_allclose(solid.inertia(due), box_inertia(due, long, 0.06, 0.04), rtol=1e-5, atol=1e-9)
        assert solid_of(surface_of(both.apply_transform(turn))).volume == pytest.approx(due / 1000, rel=1e-4)
    balls = [trimesh.creation.icosphere(subdivisions=5, radius=0.03) for _ in range(2)]
    balls[1].apply_translation([0.03, 0.0, 0.0])
    shared = np.pi * (4 * 0.03 + 0.03) * (2 * 0.03 - 0.03) ** 2 / 12
    solid = solid_of(surface_of(trimesh.util.concatenate(balls)))
    assert solid.volume == pytest.approx(8 / 3 * np.pi * 0.03**3 - shared, rel=1e-3)


def test_bodies_that_do_not_overlap_and_cavities_are_exact() -> None:
    apart = trimesh.util.concatenate([box(0.04, 0.04, 0.04), box(0.04, 0.04, 0.04, at=(0.1, 0.0, 0.0))])
    for mesh, volume in ((apart, 2 * 0.04**3), (hollow_box(), hollow_box().volume)):
        surface = surface_of(mesh)
        assert overlap(surface) == 0.0
        assert solid_of(surface).by == "surface" and solid_of(surface).volume == pytest.approx(volume, rel=1e-9)


def test_a_mesh_inside_out_or_with_mixed_triangles_is_the_same() -> None:
    mesh = box(0.1, 0.2, 0.05)
    mesh.invert()
    assert solid_of(surface_of(mesh)).volume == pytest.approx(1e-3)
    triangles = np.array(box(0.1, 0.2, 0.05).triangles)
    triangles[::2] = triangles[::2, ::-1]
    mixed = weld(triangles)
    assert mixed.closed and solid_of(mixed).volume == pytest.approx(1e-3)
    assert 4 <= mixed.turned.sum() <= 8
    np.testing.assert_array_equal(mixed.of_corners(triangles), mixed.vertices[mixed.faces])


def test_a_surface_with_a_small_hole_is_filled() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    ball.apply_translation([0.3, 0.0, 0.0])
    surface = weld(np.asarray(ball.triangles)[3:])
    solid = solid_of(surface)
    assert not surface.closed and solid.by == "filling"
    volume = 4 / 3 * np.pi * 0.05**3
    assert solid.volume == pytest.approx(volume, rel=0.015)
    np.testing.assert_allclose(solid.centre, [0.3, 0, 0], atol=2e-4)
    np.testing.assert_allclose(solid.inertia(1.0), 0.4 * 0.05**2 * np.eye(3), rtol=0.02, atol=5e-6)


def test_an_open_vessel_of_thick_wall_keeps_its_hollow() -> None:
    """A cup whose rim has a slit: filled, not taken for its hull."""
    cup = trimesh.creation.annulus(r_min=0.03, r_max=0.04, height=0.1, sections=64)
    solid = solid_of(weld(np.asarray(cup.triangles)[1:]))
    assert solid.by == "filling"
    assert solid.volume == pytest.approx(np.pi * (0.04**2 - 0.03**2) * 0.1, rel=0.05)


def test_what_holds_nothing_is_taken_for_its_hull() -> None:
    triangles = np.array(box(0.1, 0.2, 0.05).triangles)
    upper = triangles[np.abs(triangles[:, :, 2] - 0.025).max(axis=1) > 1e-9]  # the lid is missing
    solid = solid_of(weld(upper))
    assert solid.by == "hull" and solid.volume == pytest.approx(1e-3)
    np.testing.assert_allclose(solid.centre, 0, atol=1e-9)


def test_a_thin_open_plate_holds_no_more_than_its_hull() -> None:
    """Thinner than the cells that fill it, in tiles whose gaps are closed with those."""
    tiles = [box(0.008, 0.008, 0.0002, at=(0.012 * x, 0.012 * y, 0.0)) for x in range(16) for y in range(12)]
    surface = weld(np.concatenate([np.array(tile.triangles)[1:] for tile in tiles]))
    assert not surface.closed
    assert solid_of(surface).volume <= 1.1 * hull_of(surface.vertices).volume


def test_a_sheet_has_no_volume() -> None:
    flat = np.array([[[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]]])
    with pytest.raises(AssetError, match="lie in a plane"):
        solid_of(weld(flat))


def test_hulls_face_outwards() -> None:
    points = np.random.default_rng(3).normal(size=(40, 3)) + [5.0, 0.0, 0.0]
    hull = hull_of(points)
    a, b, c = (points[outward(hull)[:, k]] for k in range(3))
    assert (np.einsum("fi,fi->f", np.cross(b - a, c - a), a - points.mean(axis=0)) > 0).all()


def test_points_are_spread_no_further_than_asked() -> None:
    triangle = np.array([[[0.0, 0, 0], [0.1, 0, 0], [0, 0.03, 0]], [[0.0, 0, 1], [1e-3, 0, 1], [0, 1e-3, 1]]])
    points = spread(triangle, 0.01)
    u = np.random.default_rng(0).dirichlet([1, 1, 1], 300) @ triangle[0]
    assert np.linalg.norm(u[:, None] - points[None], axis=2).min(axis=1).max() < 0.01
    for place in triangle.reshape(-1, 3):
        assert np.linalg.norm(points - place, axis=1).min() < 1e-12
    assert (
        len(points) < 1500 and points[:, 0].min() >= 0 and (points[:, 0] / 0.1 + points[:, 1] / 0.03).max() < 1 + 1e-9
    )


def test_a_ray_that_misses_a_triangle_spoils_no_other() -> None:
    cube = box(0.1, 0.1, 0.1)
    corners = np.array(cube.vertices)[np.array(cube.faces)]
    stray = np.array([[[-0.09, -0.05, 0.0], [-0.07, -0.05, 0.0], [-0.08, 0.05, 0.0]]])
    _, length, bodies, edge = _stretches(np.concatenate([corners, stray]))
    assert edge.prod() * length.sum() == pytest.approx(1e-3, rel=0.05) and (bodies == 1).all()
