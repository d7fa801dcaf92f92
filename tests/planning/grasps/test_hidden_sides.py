"""What one camera saw of a thing is no sheet of paper: its hidden sides are guessed before grasps are."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from twin_diagram.native import import_open3d
from twin_diagram.planning.grasps import PANDA_HAND, Wanted, propose, rank, target_of
from twin_diagram.planning.grasps.hidden_sides import with_hidden_sides
from twin_diagram.planning.grasps.triangles import surface_cloud
from twin_diagram.signals.arrays import Array

EYE = np.array([0.6, 0.35, 0.6])
TABLE = np.array([0.0, 0.0, 1.0, 0.0])


def standing(mesh: trimesh.Trimesh) -> Array:
    """Return the triangles of a convex thing, set down on the table."""
    mesh.apply_translation([0.0, 0.0, -mesh.bounds[0, 2]])
    return np.asarray(mesh.triangles)


def box() -> Array:
    return standing(trimesh.creation.box(extents=(0.05, 0.08, 0.16)))


def can() -> Array:
    return standing(trimesh.creation.cylinder(radius=0.033, height=0.1, sections=64))


def shown(triangles: Array, eye: Array = EYE) -> tuple[Array, Array]:
    """Return what one camera sees of a convex thing: points with 0.7 mm of noise, and normals."""
    points, normals = surface_cloud(triangles, 3000, 0)
    seen = np.einsum("ni,ni->n", normals, eye - points) > 0.0
    points = points[seen] + np.random.default_rng(0).normal(0.0, 0.0007, (int(seen.sum()), 3))
    return points, normals[seen]


@pytest.mark.parametrize("thing", [box, can])
def test_grasps_of_what_one_camera_saw_hold_on_the_whole(thing: object) -> None:
    """Of the box none did, of the can some: both were pinched like the shell that a picture shows."""
    triangles = thing()  # type: ignore[operator]
    found = propose(*shown(triangles), PANDA_HAND, viewpoint=EYE, table=TABLE)
    whole = target_of(*surface_cloud(triangles, 3000, 1), table=TABLE)
    held = rank(found, whole, PANDA_HAND, Wanted(10, triangles=triangles))
    assert len(found) == 10 and len(held) >= 8, held.reasons
    assert found.width.min() > 0.04  # no side is a sheet


@pytest.mark.parametrize("thing", [box, can])
def test_hidden_sides_are_where_they_are(thing: object) -> None:
    triangles = thing()  # type: ignore[operator]
    points, normals = shown(triangles)
    target = with_hidden_sides(target_of(points, normals, viewpoint=EYE, table=TABLE), 0)
    assert target.viewpoint is None and target.guessed is not None and target.guessed.any()
    guess, outward = target.points[target.guessed], target.normals[target.guessed]
    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    faces = np.arange(3 * len(triangles), dtype=np.uint32).reshape(-1, 3)
    scene.add_triangles(o3d.core.Tensor(triangles.reshape(-1, 3).astype(np.float32)), o3d.core.Tensor(faces))
    found = scene.compute_closest_points(o3d.core.Tensor(guess.astype(np.float32)))
    nearest, true = found["points"].numpy(), found["primitive_normals"].numpy()
    assert np.percentile(np.linalg.norm(guess - nearest, axis=1), 95) < 0.006
    assert np.median(np.einsum("ni,ni->n", outward, true)) > 0.95
    kept = target.points[: target.own][~target.guessed[: target.own]]
    np.testing.assert_array_equal(np.sort(kept, axis=0), np.sort(points, axis=0))
    faces_camera = np.einsum("ni,ni->n", true, EYE - nearest) > 0.1
    assert faces_camera.mean() < 0.1  # next to none where the camera looked: over edges


def test_other_things_stay_where_they_are_in_the_cloud() -> None:
    points, normals = shown(box())
    others = np.array([[0.2, 0.2, 0.1], [0.2, 0.21, 0.1]])
    target = with_hidden_sides(target_of(points, normals, viewpoint=EYE, table=TABLE, surroundings=others), 0)
    assert target.guessed is not None
    np.testing.assert_array_equal(target.points[target.own :], others)
    assert not target.guessed[target.own :].any() and target.own == len(points) + target.guessed.sum()
    sparse = target.thinned(500)
    assert sparse.guessed is not None and len(sparse.guessed) == len(sparse.points)
    assert 0.2 < sparse.guessed[: sparse.own].mean() < 0.8  # of both, some are left


def test_without_a_table_the_hull_is_guessed_and_of_a_sheet_nothing() -> None:
    points, normals = shown(can())
    target = with_hidden_sides(target_of(points, normals, viewpoint=EYE), 0)
    assert target.guessed is not None and target.guessed.any()
    y, z = np.meshgrid(np.linspace(-0.05, 0.05, 20), np.linspace(0.0, 0.1, 20))
    sheet = np.stack([np.zeros(400), y.ravel(), z.ravel()], axis=1)
    flat = with_hidden_sides(target_of(sheet, np.tile([1.0, 0.0, 0.0], (400, 1)), viewpoint=EYE), 0)
    assert flat.guessed is not None and not flat.guessed.any() and flat.own == 400


def test_contacts_that_no_camera_saw_have_no_place() -> None:
    found = propose(*shown(box()), PANDA_HAND, viewpoint=EYE, table=TABLE, count=20)
    hidden = ~found.seen
    assert hidden.any() and (found.terms["unseen"] == pytest.approx(0.6 * hidden.sum(axis=1)))
