"""Convex pieces hold the whole object, and leave out what is hollow."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from tests.assets.building.made_meshes import box, corner, hollow_box, surface_of
from twin_diagram.assets.building import pieces
from twin_diagram.assets.building.inertia import hull_of, spread
from twin_diagram.assets.building.pieces import Pieces, holding, pieces_of, simplified
from twin_diagram.signals.arrays import Array


def depth(piece: Array, points: Array) -> Array:
    """How far points lie outside a piece's hull; negative inside."""
    equations = ConvexHull(piece).equations
    return np.asarray((points @ equations[:, :3].T + equations[:, 3]).max(axis=1))


def of(mesh: trimesh.Trimesh, volume: float) -> Pieces:
    surface = surface_of(mesh)
    return pieces_of(surface.vertices, surface.faces, volume)


def test_a_box_is_its_own_piece() -> None:
    (piece,) = of(box(0.1, 0.2, 0.05), 1e-3).vertices
    assert len(piece) == 8 and ConvexHull(piece).volume == pytest.approx(1e-3)


def test_a_closed_box_that_is_hollow_is_still_one_piece() -> None:
    (piece,) = of(hollow_box(), 0.9 * 0.1 * 0.08 * 0.06).vertices
    assert ConvexHull(piece).volume == pytest.approx(0.1 * 0.08 * 0.06)


def bowl(closed: bool) -> trimesh.Trimesh:
    """A thin-walled dish of revolution, with a lid or without."""
    outer = [[0.0, 0.0], [0.05, 0.0], [0.07, 0.06]]
    inner = [[0.067, 0.06], [0.048, 0.003], [0.0, 0.003]]
    lid = [[0.0, 0.06], [0.0, 0.057], [0.065, 0.057]] if closed else []
    return trimesh.creation.revolve(np.array([*outer, *(lid or []), *(inner[1:] if closed else inner)]), sections=48)


@pytest.mark.long
@pytest.mark.parametrize("closed", [True, False])
def test_a_thin_dish_is_hollow_and_a_closed_one_is_not(closed: bool) -> None:
    """Its walls lie within 3 mm of the hull all over."""
    surface = surface_of(bowl(closed))
    hull = hull_of(surface.vertices)
    points = spread(surface.vertices[surface.faces], 0.003)
    assert pieces.dent(hull, points) < 0.004
    assert (pieces.hollow(hull, surface.vertices[surface.faces]) < 0.02) == closed
    if not closed:
        found = pieces_of(surface.vertices, surface.faces, 1e-4)
        inside = np.array([[0.0, 0.0, 0.05], [0.03, 0.0, 0.04]])
        assert len(found.vertices) > 3 and min(depth(piece, inside).min() for piece in found.vertices) > 0.0
        assert (np.min([depth(piece, points) for piece in found.vertices], axis=0) < 1e-3).all()


def ring_of_long_thin_triangles() -> trimesh.Trimesh:
    return trimesh.creation.annulus(r_min=0.06, r_max=0.08, height=0.1, sections=100)


def test_one_point_a_place_is_left_of_long_thin_triangles() -> None:
    points = spread(np.asarray(ring_of_long_thin_triangles().triangles), 0.0032)
    few = pieces.thinned(points, 0.0016)
    assert len(few) < len(points) / 10 and not np.setdiff1d(few.view("f8,f8,f8"), points.view("f8,f8,f8")).size
    assert len(np.unique(np.floor((few - points.min(axis=0)) / 0.0016), axis=0)) == len(few)


@pytest.mark.long
def test_long_thin_triangles_are_held_as_others_are(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = ring_of_long_thin_triangles()
    monkeypatch.setattr(pieces, "TUNING", replace(pieces.TUNING, many=1000))
    made = of(mesh, float(mesh.volume))
    points = spread(np.asarray(mesh.triangles), 0.0032)
    edge = pieces.TUNING.step * 0.16 / 4  # of the cubes with one point each: where pieces meet, half of it is left
    assert np.min([depth(piece, points) for piece in made.vertices], axis=0).max() < 0.5 * edge
    assert sum(ConvexHull(piece).volume for piece in made.vertices) < 1.3 * mesh.volume


def test_a_corner_is_taken_apart() -> None:
    mesh = corner()
    made = of(mesh, float(mesh.volume))
    assert 2 <= len(made.vertices) <= 12 and "V-HACD" in made.how
    points = spread(np.asarray(mesh.triangles), 0.004)
    outside = np.min([depth(piece, points) for piece in made.vertices], axis=0)
    assert outside.max() < 2e-4
    total = sum(ConvexHull(piece).volume for piece in made.vertices)
    assert mesh.volume * 0.95 < total < 1.25 * mesh.volume
    # In the notch nothing is held; the hull would.
    notch = np.array([[0.058, 0.02, 0.058], [0.08, 0.02, 0.06]])
    assert np.min([depth(piece, notch) for piece in made.vertices], axis=0).min() > 0.005
    assert depth(np.asarray(mesh.vertices), notch).max() < 0


def test_where_taking_apart_fails_the_hull_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "taken_apart", lambda vertices, faces: [])
    made = of(corner(), 3.2e-4)
    assert len(made.vertices) == 1 and "could not be taken apart" in made.how


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 always looks there")
def test_files_where_the_user_works_are_none_of_its_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A corner was held as its hull, and would have been no more than that in any planner's eyes."""
    (tmp_path / "vhacdx.py").write_text("raise SystemExit('the user's own')")
    monkeypatch.chdir(tmp_path)
    assert "V-HACD" in of(corner(), 3e-4).how


@pytest.mark.parametrize("thick", [0.0, 1e-17, 1e-12])
def test_slivers_of_a_taken_apart_thing_are_no_pieces(monkeypatch: pytest.MonkeyPatch, thick: float) -> None:
    """V-HACD made one of a mug, flat but for rounding: it passed for a piece, and then had no hull to be written."""
    rng = np.random.default_rng(42)
    flat = rng.uniform(-0.05, 0.05, (42, 3)) * [1.0, 1.0, 0.0] + rng.normal(0.0, 1.0, (42, 1)) * [0.0, 0.0, thick]
    whole = box(0.1, 0.2, 0.05).vertices

    def made(command: list[str], **how: object) -> subprocess.CompletedProcess[bytes]:
        np.savez(command[-1], a=flat, b=whole, c=np.full((5, 3), np.nan), d=whole[:3])
        return subprocess.CompletedProcess(command, 0, b"", b"")

    monkeypatch.setattr(subprocess, "run", made)
    (piece,) = pieces.taken_apart(whole, np.array([[0, 1, 2]]))
    np.testing.assert_allclose(piece, whole)


def test_what_takes_too_long_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "TUNING", replace(pieces.TUNING, patience=0.05))
    made = of(corner(), 3.2e-4)
    assert len(made.vertices) == 1 and "could not be taken apart" in made.how


def test_a_fine_hull_is_made_simple_and_holds_the_same() -> None:
    ball = trimesh.creation.icosphere(4, 0.05)
    simple = simplified(hull_of(np.asarray(ball.vertices)))
    assert len(simple) < 200 < len(ball.vertices)
    assert depth(simple, np.asarray(ball.vertices)).max() < 1e-6
    assert ConvexHull(simple).volume < 1.1 * ball.volume
    can = trimesh.creation.cylinder(radius=0.04, height=0.1, sections=200)
    simple = simplified(hull_of(np.asarray(can.vertices)))
    assert np.ptp(simple[:, 2]) == pytest.approx(0.1, abs=1e-6)  # it still stands as it did
    assert depth(simple, np.asarray(can.vertices)).max() < 1e-6 and len(simple) < 60


def test_pieces_grow_to_hold_what_lies_outside_of_all() -> None:
    one, two = np.array(box(1, 1, 1).vertices), np.array(box(1, 1, 1, at=(2, 0, 0)).vertices)
    points = np.array([[2.6, 0.0, 0.0], [0.0, 0.0, 0.3]])
    first, second = holding([one, two], points)
    assert depth(first, points[1:]).max() < 0 and ConvexHull(first).volume == pytest.approx(1.0)
    assert depth(second, points[:1]).max() < 1e-9 and ConvexHull(second).volume == pytest.approx(1 + 0.1 / 3)


def test_a_dent_is_as_deep_where_only_some_points_are_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    top = ball.vertices[:, 2] > 0.03
    dented = np.where(top[:, None], ball.vertices * [1.0, 1.0, -1.0] + [0.0, 0.0, 0.06], ball.vertices)
    hull = hull_of(dented)
    points = spread(dented[ball.faces], 0.001)
    whole = pieces.dent(hull, points)
    assert whole == pytest.approx(0.019, abs=0.002)
    monkeypatch.setattr(pieces, "TUNING", replace(pieces.TUNING, products=4_000 * len(hull.equations)))
    assert pieces.dent(hull, points) == pytest.approx(whole, abs=0.001)


def test_how_far_out_points_are_is_that_of_the_farthest_plane() -> None:
    rng = np.random.default_rng(2)
    hull, points = ConvexHull(rng.normal(size=(40, 3))), rng.normal(size=(300, 3))
    assert pieces.farthest_out(points, hull) == pytest.approx(depth(hull.points, points), abs=1e-12)
