"""Walls whose both sides show are as thin below; what slopes from its foot on may be open; a tray keeps its floor."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from tests.assets.building.pictured import box, cameras, cup, shots
from twin_diagram.assets.building.fusion import DistanceField, FusionGrid
from twin_diagram.assets.building.inertia import enclosed, less
from twin_diagram.assets.building.reconstruct import Reconstruction, reconstruct
from twin_diagram.assets.building.shape_errors import ShapeErrors, shape_errors
from twin_diagram.assets.building.thin_walls import TUNING, sloping_share, wall_chance, wall_thickness

VOXEL = 0.001


def field(outside: np.ndarray, seen: np.ndarray) -> DistanceField:
    distance = np.where(outside, 0.003, np.where(seen, -0.0005, -0.004)).astype(np.float32)
    return DistanceField(FusionGrid(np.zeros(3), VOXEL, outside.shape), distance, seen.astype(np.float32), seen)


def seat(thick: int) -> tuple[DistanceField, np.ndarray]:
    """A round seat of which top and rim were seen; below it, down to a cone, all is full: nobody looked there."""
    x, y, z = np.indices((101, 101, 60)) - np.array([50, 50, 0])[:, None, None, None]
    radius = np.hypot(x, y)
    solid = (radius < 40) & (z < 50) & (z >= 50 - thick - 0.4 * (40 - radius))
    solid[..., 0] = False
    rim = (radius >= 39) & (z >= 50 - thick)
    return field(~solid, solid & ((z >= 49) | rim)), np.maximum(z, 0) * VOXEL


@pytest.mark.parametrize("thick", [3, 5])
def test_a_seats_thickness_shows_at_its_rim_and_holds_below(thick: int) -> None:
    fused, height = seat(thick)
    wall = wall_thickness(fused, height)
    assert abs(wall - thick * VOXEL) < 2.5 * VOXEL
    chance = wall_chance(fused, height, 0.0)
    middle = chance[50, 50]
    depth = (49 - np.arange(60)) * VOXEL
    below = (depth > 2.0 * wall) & (fused.distance[50, 50] < 0)
    assert below.any() and (middle[below] > 0.95 * TUNING.shell).all()
    assert middle[(depth > 0) & (depth < 0.4 * wall)].max() < 0.05
    assert not chance[fused.known].any() and not chance[fused.distance > 0].any()


def test_what_shows_no_thin_part_is_full_unless_it_slopes_from_its_foot() -> None:
    solid = np.zeros((60, 60, 60), bool)
    solid[10:50, 10:50, :40] = True
    seen = solid.copy()
    seen[11:49, 11:49, :39] = False
    fused, height = field(~solid, seen), np.broadcast_to(np.arange(60) * VOXEL, (60, 60, 60))
    assert wall_thickness(fused, height) > 0.9 * 40 * VOXEL
    assert not wall_chance(fused, height, 0.0).any()
    assert wall_chance(fused, height, 0.5).max() == pytest.approx(TUNING.moulded, rel=0.01)
    assert not wall_chance(fused, None, 0.5).any()


def test_a_cup_turned_over_slopes_and_a_can_does_not() -> None:
    plane = np.array([0.0, 0.0, 1.0, 0.0])
    shares = []
    for top in (0.029, 0.04):
        line = [[0, 0], [0.04, 0], *([0.04 + (top - 0.04) * k / 8, 0.09 * k / 8] for k in range(1, 9)), [0, 0.09]]
        mesh = trimesh.creation.revolve(np.array(line), sections=64)
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        shares.append(sloping_share(vertices, faces, np.ones(len(vertices), bool), plane))
        assert sloping_share(vertices, faces, np.zeros(len(vertices), bool), plane) == 0.0
    assert shares[0] > TUNING.slopes[1] > TUNING.slopes[0] > shares[1]


def numbers(found: Reconstruction) -> tuple[float, float, ShapeErrors, float]:
    """Volume, centre's height above the support, what is told of both, and the mesh's volume."""
    full, doubt = enclosed(found.vertices, found.faces, "surface"), found.doubt
    body = less(full, doubt.hollow())
    errors = shape_errors(found.vertices, found.faces, found.views, found.noise, doubt, body.centre, np.eye(3))
    assert found.plane is not None
    return body.volume, float(body.centre @ found.plane[:3] - found.plane[3]), errors, full.volume


def test_a_table_on_one_leg_is_as_thin_as_its_rim() -> None:
    line = [[0, 0], [0.008, 0], [0.008, 0.034], [0.05, 0.034], [0.05, 0.04], [0, 0.04]]
    body = trimesh.creation.revolve(np.array(line), sections=64)
    volume, height, errors, mesh = numbers(reconstruct(shots([body], cameras(16, 0.02, low=20.0))))
    true = abs(float(body.volume))
    assert abs(volume - true) < 2.0 * errors.volume_std and volume - true < 0.65 * (mesh - true)
    assert abs(height - body.center_mass[2]) < 2.0 * errors.centre_std(volume)[2]


def test_a_bowl_turned_over_may_be_open_below() -> None:
    outer, inner = cup(0.04, 0.003, 0.05), 0.5
    vertices = np.asarray(outer.vertices) * [1.0, 1.0, -1.0] + [0.0, 0.0, 0.05]
    vertices[:, :2] *= 1.0 - 0.3 * vertices[:, 2:] / 0.05 * inner
    body = trimesh.Trimesh(vertices, np.asarray(outer.faces)[:, ::-1])
    volume, height, errors, mesh = numbers(reconstruct(shots([body], cameras(16, 0.025))))
    true = abs(float(body.volume))
    assert mesh > 2.0 * true and abs(volume - true) < 2.0 * errors.volume_std
    assert abs(height - body.center_mass[2]) < 2.0 * errors.centre_std(volume)[2]


def test_a_trays_floor_does_not_draw_its_support_up() -> None:
    x, y, wall, high = 0.16, 0.12, 0.003, 0.02
    sides = [box((wall, y, high), (s * (x - wall) / 2, 0.0)) for s in (-1, 1)]
    sides += [box((x, wall, high), (0.0, s * (y - wall) / 2)) for s in (-1, 1)]
    tray = trimesh.util.concatenate([box((x, y, 0.0025)), *sides])
    found = reconstruct(shots([tray], cameras(16, 0.01, low=25.0, distance=0.4)))
    assert found.plane is not None and abs(found.plane[3]) < 0.0002
    true = x * y * 0.0025 + (x * y - (x - 2 * wall) * (y - 2 * wall)) * (high - 0.0025)
    assert abs(enclosed(found.vertices, found.faces, "surface").volume / true - 1) < 0.1
