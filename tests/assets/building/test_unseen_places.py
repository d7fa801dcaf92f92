"""What may be empty though no view told so: behind gaps, below overhangs, and where a body stands."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tests.assets.building.pictured import box, cameras, shots
from twin_diagram.assets.building.fusion import DistanceField, FusionGrid
from twin_diagram.assets.building.inertia import enclosed, less
from twin_diagram.assets.building.reconstruct import reconstruct
from twin_diagram.assets.building.shape_errors import shape_errors
from twin_diagram.assets.building.unseen_places import TUNING, unseen_places

VOXEL = 0.001


def seen_cube(edge: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """Distance and what is known of a cube of which all sides were seen, two cells deep, with five cells around."""
    size = edge + 10
    distance, known = np.full((size,) * 3, 0.004, np.float32), np.ones((size,) * 3, bool)
    distance[5:-5, 5:-5, 5:-5] = -0.001
    distance[7:-7, 7:-7, 7:-7], known[7:-7, 7:-7, 7:-7] = -0.004, False
    return distance, known


def field_of(distance: np.ndarray, known: np.ndarray) -> DistanceField:
    return DistanceField(FusionGrid(np.zeros(3), VOXEL, distance.shape), distance, known.astype(np.float32), known)


def none(distance: np.ndarray) -> np.ndarray:
    return np.zeros(distance.shape, np.float32)


def test_nothing_is_empty_behind_what_was_seen_and_little_behind_a_gap() -> None:
    distance, known = seen_cube()
    (sure,) = unseen_places(field_of(distance, known), none(distance), None)
    assert not len(sure.places)
    known[11:19, 11:19, 5:7] = False  # a hole into which no view looked
    (found,) = unseen_places(field_of(distance, known), none(distance), None)
    assert found.inside.all() and (0 < found.expected).all() and (found.expected <= found.chance).all()
    assert (found.chance > 0).all() and (found.chance <= 1).all()
    outermost = found.places[:, 2] < 0.0065
    assert found.chance[outermost].max() > 0.1 and found.chance[~outermost].max() < found.chance[outermost].max()
    assert found.places[found.chance > 0.1, 2].max() < 0.008 and found.chance.sum() < 8**3


def test_behind_a_wide_end_emptiness_falls_off_by_a_share_of_the_size() -> None:
    distance, known = seen_cube(40)
    distance[5:-5, 5:-5, 5:7], known[5:-5, 5:-5, 5:7] = -0.004, False  # nobody looked at its underside, in the air
    (found,) = unseen_places(field_of(distance, known), none(distance), None)
    middle = (np.abs(found.places[:, :2] - 0.0245) < 0.003).all(axis=1)
    depth, chance = found.places[middle, 2] - 0.005, found.chance[middle]
    length = TUNING.behind * 40 * VOXEL / TUNING.shells
    fall = -np.polyfit(depth[chance > 0.02], np.log(chance[chance > 0.02]), 1)[0]
    assert fall == pytest.approx(1.0 / length, rel=0.3)


def test_what_stands_may_have_a_recess_and_is_full_more_likely_than_not() -> None:
    distance, known = seen_cube(40)
    distance[:, :, :7] = np.where(np.arange(7) < 5, 0.004, -0.004)  # it stands on z = 5 mm
    known[7:-7, 7:-7, 5:7] = False
    past, below = unseen_places(field_of(distance, known), none(distance), np.array([0.0, 0.0, 1.0, 0.005]))
    assert past.chance.sum() < 100 and not below.expected.any()
    area = np.unique(below.places[:, :2], axis=0)
    assert below.chance.sum() / len(area) == pytest.approx(TUNING.recessed * TUNING.recess * 40, rel=0.5)


def mushroom() -> trimesh.Trimesh:
    profile = [[0, 0], [0.012, 0], [0.012, 0.02], [0.035, 0.02], [0.035, 0.03], [0, 0.03]]
    return trimesh.creation.revolve(np.array(profile), sections=64)


@pytest.mark.parametrize("body", [mushroom(), box((0.06, 0.04, 0.03))], ids=["mushroom", "box"])
def test_volume_and_centre_lie_within_what_is_told(body: trimesh.Trimesh) -> None:
    found = reconstruct(shots([body], cameras(16, 0.015)))
    full, doubt = enclosed(found.vertices, found.faces, "surface"), found.doubt
    solid = less(full, doubt.hollow())
    errors = shape_errors(found.vertices, found.faces, found.views, found.noise, doubt, solid.centre, np.eye(3))
    true = abs(float(body.volume))
    assert abs(solid.volume - true) < 2 * errors.volume_std
    assert abs(solid.centre[2] - body.center_mass[2]) < 2.5 * errors.centre_std(solid.volume)[2]
    if full.volume > 1.1 * true:  # below its cap no view looks
        assert solid.volume - true < 0.9 * (full.volume - true)
    else:
        assert errors.volume_std < 0.08 * true
