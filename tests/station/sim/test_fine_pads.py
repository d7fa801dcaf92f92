"""Pads of more facets: they fill the box, are unmet by what the box was, and hold at longer steps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import Box, GeometryId, Mesh, Role
from pydrake.systems.framework import DiagramBuilder

from tests.station.sim.test_grip_contact import ENOUGH, GRIPPERS, hold, plan
from twin_diagram.model.description.followers import Followers
from twin_diagram.station.sim.fine_pads import tetrahedra
from twin_diagram.station.sim.grip_contact import COMPLIANCE
from twin_diagram.station.sim.world_plant import WorldPlant, build_world


def pads(folder: Path, arm: str, time_step: float) -> tuple[WorldPlant, list[GeometryId]]:
    world = build_world(DiagramBuilder(), plan(folder, arm, time_step, 0.06))
    inspector = world.scene_graph.model_inspector()
    shapes = [
        shape
        for finger in Followers.gripping(world.plant, world.arm.arm)
        for shape in world.plant.GetCollisionGeometriesForBody(finger.child_body())
        if inspector.GetProximityProperties(shape).HasProperty(*COMPLIANCE)
    ]
    return world, shapes


def test_tetrahedra_fill_a_box() -> None:
    size, cells = np.array([0.02, 0.006, 0.03]), np.array([4, 2, 3])
    corners, found = tetrahedra(size, cells)
    sides = corners[found[:, 1:]] - corners[found[:, :1]]
    volumes = np.linalg.det(sides) / 6.0
    np.testing.assert_allclose(volumes, np.prod(size / cells) / 6.0)
    assert len(found) == 6 * np.prod(cells)
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [-0.5 * size, 0.5 * size])
    # Each face within belongs to two of them: there is no gap and no overlap.
    faces = np.sort(found[:, [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]].reshape(-1, 3), axis=1)
    _, count = np.unique(faces, axis=0, return_counts=True)
    outside = 4 * sum(a * b for a, b in ((4, 2), (4, 3), (2, 3)))
    assert set(count) == {1, 2} and (count == 1).sum() == outside


@pytest.mark.parametrize("arm", GRIPPERS)
def test_pads_are_finer_at_longer_steps_alone(tmp_path: Path, arm: str) -> None:
    usual, same = pads(tmp_path, arm, 0.0025)
    longer, finer = pads(tmp_path, arm, 0.005)
    kinds = [
        [type(world.scene_graph.model_inspector().GetShape(shape)) for shape in shapes]
        for world, shapes in ((usual, same), (longer, finer))
    ]
    assert kinds == [[Box, Box], [Mesh, Mesh]]

    def unmet(world: WorldPlant, shapes: list[GeometryId]) -> list[list[bool]]:
        inspector = world.scene_graph.model_inspector()
        every = sorted(inspector.GetAllGeometryIds(Role.kProximity), key=lambda one: one.get_value())
        return [[bool(inspector.CollisionFiltered(shape, other)) for other in every] for shape in shapes]

    assert unmet(longer, finer) == unmet(usual, same)


@pytest.mark.long
def test_a_box_is_held_off_its_centre_at_a_longer_step(tmp_path: Path) -> None:
    """A fifth of what ten seconds may do: between plain pads it turns by 0.22° in that time."""
    held = hold(tmp_path, off=0.02, time_step=0.005)
    assert held.moved < 0.2 * 0.5e-3
    assert held.turned < 0.2 * np.radians(1.0)
    assert held.squeeze == pytest.approx(40.0, rel=0.01)
    assert held.contacts == 2


@pytest.mark.parametrize("share", [0.8, 1.25])
def test_friction_decides_what_is_carried_at_a_longer_step(tmp_path: Path, share: float) -> None:
    held = hold(tmp_path, force=share * ENOUGH, duration=1.0, time_step=0.005)
    assert held.dropped == (share < 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("off", [0.0, 0.02])
@pytest.mark.parametrize("arm", GRIPPERS)
def test_ten_seconds_at_a_longer_step(tmp_path: Path, arm: str, off: float) -> None:
    held = hold(tmp_path, arm, off=off, time_step=0.005, duration=10.0)
    print(arm, off, held)
    assert held.moved < 0.5e-3
    assert held.turned < np.radians(1.0)
