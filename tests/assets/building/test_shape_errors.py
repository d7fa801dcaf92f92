"""How far volume, centre and moments may be off: against what is known of a box, and against a cup's truth."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tests.assets.building.pictured import box, cameras, cup, shots
from twin_diagram.assets.building.depth_view import make_view
from twin_diagram.assets.building.inertia import enclosed, less
from twin_diagram.assets.building.reconstruct import reconstruct
from twin_diagram.assets.building.shape_errors import TUNING, Doubt, ShapeErrors, shape_errors
from twin_diagram.assets.building.unseen_places import Unseen
from twin_diagram.logs.frames.view_camera import ViewCamera

SIZE = (0.06, 0.04, 0.03)
VOLUME = 0.06 * 0.04 * 0.03


def from_above(
    covariance: np.ndarray, places: np.ndarray, chance: np.ndarray, cell: float, expected: float = 1.0
) -> ShapeErrors:
    """Errors of a box of which a camera straight above shows the top."""
    R = np.diag([1.0, -1.0, -1.0])
    camera = ViewCamera(200, 160, 300.0, 300.0, 99.5, 79.5, R, np.array([0.0, 0.0, 0.38]))
    frame = shots([box(SIZE)], [camera]).frames[0]
    mesh = box(SIZE)
    for _ in range(5):
        mesh = mesh.subdivide()
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    centre = np.array([0.0, 0.0, 0.015])
    unseen = Unseen(places, chance, chance >= 0, expected * chance)
    doubt = Doubt(covariance[None], covariance, centre, False, (unseen,), cell)
    return shape_errors(vertices, faces, [make_view(camera, frame.depth)], 1e-9, doubt, centre, np.eye(3))


def test_a_pose_that_is_not_known_moves_what_its_view_shows() -> None:
    found = from_above(np.diag([0, 0, 0, 0, 0, 0.001**2]), np.zeros((0, 3)), np.zeros(0), 0.0)
    assert found.volume_std == pytest.approx(0.06 * 0.04 * 0.001, rel=0.05)
    assert found.centre_std(VOLUME)[2] == pytest.approx(0.001 / 2, rel=0.05)  # half of the height that is gained
    solid = enclosed(*(np.asarray(part) for part in (box(SIZE).vertices, box(SIZE).faces)), "surface")
    # About y (x² and z²), of a slab that grew on top; of a told mass, all of it grows lighter.
    gained = 1.0 / VOLUME * SIZE[0] * SIZE[1] * 0.001 * (SIZE[0] ** 2 / 12 + (SIZE[2] / 2) ** 2)
    by_density, told = (found.inertia_std(solid, 1.0, told)[1] for told in (False, True))
    assert by_density == pytest.approx(gained, rel=0.06)
    assert told == pytest.approx(abs(gained - solid.inertia(1.0)[1, 1] * 0.001 / SIZE[2]), rel=0.06)


def test_what_no_view_told_of_may_be_empty() -> None:
    places = np.array([[0.0, 0.0, 0.02]] * 100)
    # As likely each share of it; or, where all of it has one chance, all of it or nothing.
    for chance, std in ((np.linspace(0.0, 1.0, 100), np.sqrt(1 / 12)), (np.full(100, 0.3), np.sqrt(0.3 * 0.7))):
        found = from_above(np.zeros((6, 6)), places, chance, 1e-9)
        assert found.volume_std == pytest.approx(1e-7 * std, rel=2e-2)
        assert found.centre_std(VOLUME)[2] == pytest.approx(0.005 * 1e-7 * std / VOLUME, rel=2e-2)
    # What is full, more likely than not, is off by all of it where it is not.
    found = from_above(np.zeros((6, 6)), places, np.full(100, 0.3), 1e-9, expected=0.0)
    assert found.volume_std == pytest.approx(1e-7 * np.sqrt(0.3), rel=2e-2)


def test_what_no_view_told_of_on_either_side_tells_of_the_centre() -> None:
    places = np.array([[x, 0.0, 0.02] for x in (-0.02, 0.02) for _ in range(50)])
    found = from_above(np.zeros((6, 6)), places, np.full(100, 0.3), 1e-9)
    std = 1e-7 * np.sqrt(0.3 * 0.7 * TUNING.elsewhere)
    assert found.centre_std(VOLUME)[0] == pytest.approx(0.02 * std / VOLUME, rel=2e-2)


@pytest.mark.slow
def test_a_cups_volume_lies_within_what_is_told() -> None:
    taken = shots([cup()], cameras(8, 0.025))
    rng = np.random.default_rng(0)
    wrong = taken.told(
        [np.append(rng.normal(0, 0.002, 3), rng.normal(0, 0.0012, 3)) for _ in taken.frames], np.zeros(3)
    )
    found = reconstruct(wrong)
    full, doubt = enclosed(found.vertices, found.faces, "surface"), found.doubt
    body = less(full, doubt.hollow())
    errors = shape_errors(found.vertices, found.faces, found.views, found.noise, doubt, body.centre, np.eye(3))
    true = trimesh.Trimesh(cup().vertices, cup().faces).volume
    assert abs(body.volume - true) < 2 * errors.volume_std < 0.5 * true
    assert abs(body.volume - true) < abs(full.volume - true)
