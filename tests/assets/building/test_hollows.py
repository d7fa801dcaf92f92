"""Hollows whose floor no view looks into, and what is no hollow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy import ndimage

from tests.assets.building.pictured import box, cup, rings, shots
from twin_diagram.assets.building.decimation import enclosed_volume
from twin_diagram.assets.building.fusion import DistanceField, FusionGrid
from twin_diagram.assets.building.hollows import held_water, least_area, spread_into, with_floors
from twin_diagram.assets.building.inertia import enclosed, less
from twin_diagram.assets.building.reconstruct import Reconstruction, reconstruct
from twin_diagram.assets.building.shape_errors import shape_errors

GROUND = np.array([0.0, 0.0, 1.0, 0.0])


def told_volume(found: Reconstruction) -> tuple[float, float]:
    """Volume and what is told of its error [m³]."""
    body = less(enclosed(found.vertices, found.faces, "surface"), found.doubt.hollow())
    errors = shape_errors(found.vertices, found.faces, found.views, found.noise, found.doubt, body.centre, np.eye(3))
    return body.volume, errors.volume_std


def cup_field(depth_seen: float, unseen: bool = True) -> DistanceField:
    """A cup of 60 mm, walls of 4 mm; in its hollow a cone that no view looks into reaches up from `depth_seen` [m]."""
    grid = FusionGrid(np.array([-0.04, -0.04, -0.01]), 0.001, (81, 81, 81))
    x, y, z = np.moveaxis(grid.points(), -1, 0)
    r = np.hypot(x, y)
    outer = np.maximum.reduce([r - 0.03, z - 0.06, -z])
    cone = depth_seen + 0.026 - r
    hollow = np.maximum(r - 0.026, (cone if unseen else depth_seen) - z)
    distance = np.clip(np.maximum(outer, -hollow), -0.004, 0.004).astype(np.float32)
    seen = (r > 0.026) & (np.abs(outer) < 0.002) | (np.abs(r - 0.026) < 0.002) & (z > depth_seen)
    known = (distance >= 0) & (z > 0) | seen
    return DistanceField(grid, distance, known.astype(np.float32), known)


def inside(field: DistanceField) -> float:
    """Volume [m³]."""
    return float(np.count_nonzero(field.distance < 0)) * field.grid.voxel**3


def test_a_hollow_gets_a_flat_floor_where_its_walls_are_no_longer_seen() -> None:
    given = cup_field(0.02)
    opened = with_floors(given, GROUND)
    flat = cup_field(0.02, unseen=False)
    assert inside(opened.field) == pytest.approx(inside(flat), abs=np.pi * 0.026**2 * 0.0015)
    middle = opened.field.distance[30:51, 30:51]
    floor = (middle < 0).sum(axis=2) * 0.001 - 0.001
    assert np.ptp(floor) <= 0.003 and floor.mean() == pytest.approx(0.02, abs=0.003)
    gone = (opened.field.distance >= 0) & (given.distance < 0)
    assert (opened.chance[gone] > 0.8).all() and (opened.chance[given.known] == 0).all()
    under = opened.chance[40, 40, :]  # less and less sure further down, to the ground
    under = under[(under > 0) & (opened.field.distance[40, 40] < 0)]
    assert len(under) > 10 and (np.diff(under) >= 0).all()


def test_a_wall_that_no_view_told_of_keeps_the_water() -> None:
    """A third of a cup's wall was hidden by what stands beside it, from within, too."""
    given = cup_field(0.02)
    x, _, z = np.moveaxis(given.grid.points(), -1, 0)
    told = given.known & ~((x > 0.01) & (given.distance < 0) & (z < 0.045))
    opened = with_floors(replace(given, known=told), GROUND)
    gone = (opened.field.distance >= 0) & (given.distance < 0)
    air = (given.distance >= 0) & (np.hypot(x, given.grid.points()[..., 1]) > 0.028)
    assert gone.any() and not (ndimage.binary_dilation(gone, iterations=2) & air & (z > 0)).any()


def test_without_a_support_nothing_is_opened_nor_where_all_was_seen() -> None:
    for field, plane in ((cup_field(0.02), None), (cup_field(0.02, unseen=False), GROUND)):
        opened = with_floors(field, plane)
        np.testing.assert_array_equal(opened.field.distance, field.distance)
        assert not opened.chance.any()


def test_water_stays_in_what_is_closed_around_and_nowhere_else() -> None:
    full = np.zeros((20, 20, 20), bool)
    full[4:16, 4:16, 2:12] = True
    full[6:14, 6:14, 4:] = False  # a hollow
    full[4:16, 4:16, 14:16] = True  # a lid above, which water runs off
    height = np.broadcast_to(np.arange(20) * 0.001, full.shape)
    held = held_water(~full, height, 0.001)
    assert held[6:14, 6:14, 4:11].all() and held.sum() <= 8 * 8 * 8
    full[4:6, 9:11, 7:] = False  # a spout
    assert held_water(~full, height, 0.001)[..., 9:].sum() == 0


def test_the_least_area_in_a_tube_is_a_disc_at_its_upper_end() -> None:
    full, empty, free = (np.zeros((24, 24, 30), bool) for _ in range(3))
    x, y, z = np.indices(full.shape)
    tube = np.hypot(x - 11.5, y - 11.5) < 9
    full[~tube | (z < 2)] = True
    empty[tube & (z > 12 + 8 - np.hypot(x - 11.5, y - 11.5))] = True
    free = ~full & ~empty
    share = least_area(full, empty, free)
    at = (share > 0.5) & tube
    assert abs(at[8:16, 8:16].sum(axis=2) - 13).max() <= 2
    assert (np.minimum(share, 1 - share)[free] < 0.1).mean() > 0.8


def test_what_is_spread_is_linear_between_plates() -> None:
    free, one, zero = (np.zeros((6, 6, 12), bool) for _ in range(3))
    one[..., 11], zero[..., 0] = True, True
    free[..., 1:11] = True
    none = np.zeros_like(free)
    found = spread_into(free, one, zero, none)
    np.testing.assert_allclose(found[3, 3, 1:11], np.arange(1, 11) / 11, atol=5e-3)
    walled = spread_into(free[1:-1], one[1:-1], zero[1:-1], none[1:-1])
    np.testing.assert_allclose(walled[2, 3], found[3, 3], atol=5e-3)
    wall = free.copy()
    wall[2:4, 2:4] = False
    less = spread_into(free & ~wall, one, zero, wall & free)
    assert (less[2, 2, 1:11] < found[2, 2, 1:11]).all() and less[2, 2, 10] > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("elevations", [(15.0, 35.0), (20.0, 45.0)])
def test_a_cups_hollow_that_no_view_looks_to_the_bottom_of(elevations: tuple[float, float]) -> None:
    body = cup(height=0.07)
    found = reconstruct(shots([body], rings(10, elevations, 0.035)))
    volume, std = told_volume(found)
    assert abs(volume - body.volume) < 2 * std and std < 0.6 * body.volume
    # Looked over the rim, opposite walls are seen down to here; the least area is no more than level with it.
    lowest = 0.07 - 2 * 0.026 * np.tan(np.radians(elevations[1]))
    most = body.volume + np.pi * 0.026**2 * max(lowest + 0.006 - 0.004, 0.0)
    assert enclosed_volume(found.vertices, found.faces) < most


@pytest.mark.slow
@pytest.mark.parametrize(
    "body",
    [box((0.06, 0.04, 0.05)), trimesh.creation.cylinder(0.03, 0.06).apply_translation([0.0, 0.0, 0.03])],
    ids=["box", "can"],
)
def test_what_is_full_stays_full(body: trimesh.Trimesh) -> None:
    found = reconstruct(shots([body], rings(8, (15.0, 35.0), 0.03)))
    assert enclosed_volume(found.vertices, found.faces) == pytest.approx(body.volume, rel=0.04)
    volume, std = told_volume(found)
    assert abs(volume - body.volume) < 0.04 * body.volume and std < 0.04 * body.volume
