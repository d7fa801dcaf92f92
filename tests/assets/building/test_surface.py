"""Welding, and normals that are smooth where the surface is and sharp at its edges."""

from __future__ import annotations

import numpy as np
import trimesh

from tests.assets.building.made_meshes import box, surface_of
from twin_diagram.assets.building.surface import edge_pairs, signed_volume, weld, with_normals


def test_normals_of_a_box_are_those_of_its_sides_and_carry_their_corners_texture() -> None:
    mesh = box(0.1, 0.2, 0.05, at=(3, 0, 0))
    surface = surface_of(mesh)
    uv = np.asarray(mesh.triangles)[:, :, :2] * 7.0
    made = with_normals(surface, surface.of_corners(uv))
    assert len(surface.vertices) == 8 and surface.closed and len(made.vertices) == 24
    out = made.vertices - [3, 0, 0]
    np.testing.assert_allclose(np.sort(np.abs(made.normals), axis=1), np.tile([0, 0, 1.0], (24, 1)), atol=1e-9)
    assert (np.einsum("vi,vi->v", out, made.normals) > 0.02).all()
    np.testing.assert_allclose(made.uv, made.vertices[:, :2] * 7.0, atol=1e-9)


def test_normals_of_a_ball_point_from_its_centre() -> None:
    made = with_normals(surface_of(ball := trimesh.creation.icosphere(3, 0.05)), np.zeros((len(ball.faces), 3, 2)))
    np.testing.assert_allclose(made.normals, made.vertices / 0.05, atol=0.01)


def test_edges_of_up_to_40_degrees_are_smooth() -> None:
    for sections, smooth in ((10, True), (8, False)):  # 36° and 45° from side to side
        tube = trimesh.creation.cylinder(radius=0.03, height=0.1, sections=sections)
        made = with_normals(surface_of(tube), np.zeros((len(tube.faces), 3, 2)))
        side = np.abs(made.normals[:, 2]) < 0.5
        radial = made.vertices[side, :2] / 0.03
        cosine = np.einsum("vi,vi->v", radial, made.normals[side, :2])
        assert (cosine > 0.999).all() == smooth


def test_near_vertices_are_one_and_slivers_go() -> None:
    triangles = np.array(box(0.1, 0.1, 0.1).triangles)
    shaken = triangles + np.random.default_rng(0).uniform(-1e-9, 1e-9, triangles.shape)
    sliver = np.array([[[0, 0, 0], [0.05, 0, 0], [0.1, 0, 0]], [[0.0, 0, 0]] * 3])
    surface = weld(np.concatenate([shaken, sliver + 0.05]))
    assert surface.closed and len(surface.vertices[np.unique(surface.faces)]) == 8
    np.testing.assert_array_equal(surface.kept, np.arange(12))


def test_volume_is_signed_wherever_the_mesh_is() -> None:
    mesh = box(0.1, 0.1, 0.1, at=(10, 10, 10))
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    assert np.isclose(signed_volume(vertices, faces), 1e-3)
    assert np.isclose(signed_volume(vertices, faces[:, ::-1]), -1e-3)


def test_a_body_beside_others_faces_outwards_and_a_cavity_inwards() -> None:
    """Of two boxes one may come inside out, or with triangles that face either way; a hollow stays one."""
    large, small = (
        np.asarray(box(*(3 * [edge]), at=at).triangles) for edge, at in ((0.1, (0, 0, 0)), (0.05, (0.2, 0, 0)))
    )
    hollow = np.asarray(box(0.06, 0.06, 0.06).triangles)[:, ::-1]
    volumes = []
    for second in (small[:, ::-1], small):
        surface = weld(np.concatenate([large, hollow, second]))
        assert surface.closed
        volumes.append(signed_volume(surface.vertices, surface.faces))
        np.testing.assert_array_equal(surface.turned[-12:], (second != small).any(axis=(1, 2)))
    rng = np.random.default_rng(1)
    for _ in range(4):
        mixed = np.concatenate([large, small])
        some = rng.random(len(mixed)) < 0.5
        mixed[some] = mixed[some, ::-1]
        surface = weld(mixed)
        volumes.append(signed_volume(surface.vertices, surface.faces) - 0.06**3)
    np.testing.assert_allclose(volumes, 0.1**3 + 0.05**3 - 0.06**3)


def test_edges_of_two_triangles_are_paired_and_those_of_more_are_not() -> None:
    faces = np.random.default_rng(4).integers(0, 40, (300, 3))
    owners: dict[tuple[int, int], list[int]] = {}
    for k in range(3):  # all first edges, then all second ones
        for face, corners in enumerate(faces):
            a, b = sorted((int(corners[k]), int(corners[(k + 1) % 3])))
            owners.setdefault((a, b), []).append(face)
    expected = [tuple(found) for _, found in sorted(owners.items()) if len(found) == 2]
    assert len(expected) > 50 and any(len(found) > 2 for found in owners.values())
    assert list(zip(*(array.tolist() for array in edge_pairs(faces)), strict=True)) == expected


def test_a_vertex_is_there_once_for_each_normal_and_texture_coordinate() -> None:
    rng = np.random.default_rng(5)
    surface = surface_of(trimesh.creation.cylinder(0.03, 0.1, sections=20))
    uv = np.round(rng.random((len(surface.faces), 3, 2)), 1)
    made = with_normals(surface, uv)
    rows = np.concatenate([made.vertices, made.normals, made.uv], axis=1)
    np.testing.assert_array_equal(np.unique(rows, axis=0), rows)
    np.testing.assert_array_equal(made.vertices[made.faces], surface.vertices[surface.faces])
    np.testing.assert_array_equal(made.uv[made.faces], uv)
    sides = np.cross(*np.diff(made.vertices[made.faces], axis=1).swapaxes(0, 1))
    assert (np.einsum("fki,fi->fk", made.normals[made.faces], sides) > 0).all()
