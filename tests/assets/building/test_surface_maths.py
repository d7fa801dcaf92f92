"""Marching tetrahedra, smoothing, decimation and the atlas against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from twin_diagram.assets.building.decimation import decimated, enclosed_volume, is_closed, unfolded
from twin_diagram.assets.building.iso_surface import zero_surface
from twin_diagram.assets.building.smoothing import edges_of, smoothed, vertex_normals
from twin_diagram.assets.building.texture_atlas import TUNING as ATLAS
from twin_diagram.assets.building.texture_atlas import lay_out

Field = np.ndarray


def around(n: int = 41, half: float = 1.0) -> np.ndarray:
    axis = np.linspace(-half, half, n)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)


@pytest.fixture(scope="module")
def ball() -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = zero_surface((np.linalg.norm(around(), axis=-1) - 0.7).astype(np.float32))
    return vertices * 0.05 - 1, faces


def test_sphere_is_closed_exact_and_outward(ball: tuple[np.ndarray, np.ndarray]) -> None:
    vertices, faces = ball
    assert is_closed(faces)
    assert len(vertices) - len(edges_of(faces)) + len(faces) == 2  # Euler: one piece without handles
    assert enclosed_volume(vertices, faces) == pytest.approx(4 / 3 * np.pi * 0.7**3, rel=0.004)
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 0.7, atol=0.002)
    outward = np.einsum("vi,vi->v", vertex_normals(vertices, faces), vertices) / 0.7
    assert outward.min() > 0.85 and np.quantile(outward, 0.01) > 0.97


def test_plane_comes_out_where_it_is() -> None:
    field = (around()[..., 2] - 0.123 + 0.3 * around()[..., 0]).astype(np.float32)
    vertices, _ = zero_surface(field)
    at = vertices * 0.05 - 1
    np.testing.assert_allclose(at[:, 2], 0.123 - 0.3 * at[:, 0], atol=1.2e-3)  # vertices keep 2 % off grid points


def test_wall_of_two_cells_and_cavity_survive() -> None:
    r = np.linalg.norm(around(), axis=-1)
    vertices, faces = zero_surface(np.maximum(r - 0.8, 0.7 - r).astype(np.float32))
    volume = enclosed_volume(vertices * 0.05 - 1, faces)
    assert is_closed(faces) and volume == pytest.approx(4 / 3 * np.pi * (0.8**3 - 0.7**3), rel=0.02)


def test_any_field_gives_a_closed_surface() -> None:
    field = np.random.default_rng(0).standard_normal((12, 13, 14)).astype(np.float32)
    for axis in range(3):
        np.moveaxis(field, axis, 0)[[0, -1]] = 1.0
    _, faces = zero_surface(field)
    assert is_closed(faces)
    assert len(zero_surface(np.ones((4, 4, 4), np.float32))[1]) == 0


def test_open_and_turned_faces_are_not_closed(ball: tuple[np.ndarray, np.ndarray]) -> None:
    _, faces = ball
    assert not is_closed(faces[1:])
    turned = faces.copy()
    turned[3] = turned[3, ::-1]
    assert not is_closed(turned)
    assert not is_closed(faces[:0])


def test_smoothing_takes_noise_and_neither_volume_nor_edges(ball: tuple[np.ndarray, np.ndarray]) -> None:
    vertices, faces = ball
    rough = vertices + np.random.default_rng(1).normal(0, 0.006, vertices.shape)
    smooth = smoothed(rough, faces, 10)
    spread = [np.std(np.linalg.norm(v, axis=1)) for v in (rough, smooth)]
    assert spread[1] < 0.6 * spread[0]
    assert enclosed_volume(smooth, faces) == pytest.approx(enclosed_volume(vertices, faces), rel=0.01)


def test_gate_keeps_edges_sharp() -> None:
    body = trimesh.creation.box((1, 1, 1)).subdivide_loop(0).subdivide().subdivide().subdivide()
    at, faces = np.array(body.vertices), np.array(body.faces, dtype=np.int64)
    gated, not_gated = (
        np.abs(np.abs(smoothed(at, faces, 10, gate)).max(axis=1) - 0.5) for gate in (np.radians(30), np.pi)
    )
    edge = np.sort(np.abs(at), axis=1)[:, 1] > 0.49
    assert gated[edge].mean() < 0.3 * not_gated[edge].mean()


def test_rough_mesh_keeps_more_triangles_where_few_would_ruin_it(
    ball: tuple[np.ndarray, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    import fast_simplification

    vertices, faces = ball
    honest = fast_simplification.simplify

    def ruining(points: np.ndarray, triangles: np.ndarray, target_count: int, agg: float) -> tuple[np.ndarray, ...]:
        found, kept = honest(points, triangles, target_count=target_count, agg=agg)
        return found * (0.8 if target_count < 800 else 1.0), kept

    monkeypatch.setattr(fast_simplification, "simplify", ruining)
    fewer, kept = decimated(vertices, faces, 400)
    assert 400 < len(kept) <= 1600 and is_closed(kept)
    assert enclosed_volume(fewer, kept) == pytest.approx(enclosed_volume(vertices, faces), rel=0.01)


def test_decimation_stays_closed_and_near(ball: tuple[np.ndarray, np.ndarray]) -> None:
    vertices, faces = ball
    fewer, kept = decimated(vertices, faces, 800)
    assert is_closed(kept) and 500 <= len(kept) <= 1600
    assert enclosed_volume(fewer, kept) == pytest.approx(enclosed_volume(vertices, faces), rel=0.01)
    np.testing.assert_allclose(np.linalg.norm(fewer, axis=1), 0.7, atol=0.01)
    same, all_faces = decimated(vertices, faces, len(faces))
    assert same is vertices and all_faces is faces


def test_flaps_and_pinches_are_taken_out() -> None:
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    flap = np.array([[0, 1, 4], [0, 4, 1], [2, 2, 3]])
    mended = unfolded(np.concatenate([tetrahedron, flap]))
    assert sorted(map(tuple, mended)) == sorted(map(tuple, tetrahedron))
    other = np.array([0, 1, 4, 5])[tetrahedron]  # a second one on the same edge
    pinched = unfolded(np.concatenate([tetrahedron, other]))
    assert not len(pinched) or is_closed(pinched)


def test_atlas_gives_each_texel_the_point_that_its_coordinates_name() -> None:
    atlas = lay_out(7)
    assert atlas.uv.shape == (7, 3, 2) and atlas.edge == 2 * ATLAS.cell
    assert len(set(zip(atlas.row.tolist(), atlas.column.tolist(), strict=True))) == len(atlas.row)
    centre = np.stack([(atlas.column + 0.5) / atlas.edge, 1 - (atlas.row + 0.5) / atlas.edge], axis=1)
    named = np.einsum("tk,tki->ti", atlas.share, atlas.uv[atlas.face])
    np.testing.assert_allclose(named, centre, atol=1e-12)
    assert atlas.share.sum(axis=1) == pytest.approx(1.0)
    for face in range(7):  # the texels around each corner are its own: a renderer that blends takes no other's
        pixels = np.stack([atlas.uv[face, :, 0] * atlas.edge, (1 - atlas.uv[face, :, 1]) * atlas.edge], axis=1)
        own = {(r, c) for r, c, f in zip(atlas.row, atlas.column, atlas.face, strict=True) if f == face}
        for x, y in pixels:
            assert {(int(y + dy), int(x + dx)) for dy in (-0.4, 0.4) for dx in (-0.4, 0.4)} <= own


def test_nothing_more_eager_is_tried_where_the_shape_was_ruined(
    ball: tuple[np.ndarray, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    import fast_simplification

    vertices, faces = ball
    honest, tried = fast_simplification.simplify, []

    def ruining(points: np.ndarray, triangles: np.ndarray, target_count: int, agg: float) -> object:
        tried.append(agg)
        fewer, kept = honest(points, triangles, target_count=target_count, agg=agg)
        return (fewer * 0.9 if agg > 3 else fewer), kept

    monkeypatch.setattr(fast_simplification, "simplify", ruining)
    fewer, kept = decimated(vertices, faces, 800)
    assert tried == [5, 3]
    assert enclosed_volume(fewer, kept) == pytest.approx(enclosed_volume(vertices, faces), rel=0.01)
