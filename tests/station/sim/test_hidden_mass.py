"""How heavy an object is stands in the world, and nobody need have told the twin."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import load_scenario
from twin_diagram.station.sim.world_plant import build_world

BLIND = ["twin.camera=null", "twin.library={}"]


@pytest.mark.long
def test_an_object_is_as_heavy_as_is_said() -> None:
    """With its middle where it was, and its gyration: both can boxes are like the asset's, but for the mass."""
    inertias = []
    for mass in (0.35, 1.4):
        scenario = load_scenario("tabletop", [*BLIND, f"world.objects.can.mass={mass}"])
        world = build_world(DiagramBuilder(), scenario)
        context = world.plant.CreateDefaultContext()
        can = world.plant.get_body(world.objects["can"])
        bodies = [can.index(), *(b.index() for b in world.plant.GetBodiesWeldedTo(can) if b.index() != can.index())]
        whole = world.plant.CalcSpatialInertia(context, can.body_frame(), bodies)
        assert whole.get_mass() == pytest.approx(mass)
        inertias.append(whole.CopyToFullMatrix6())
    np.testing.assert_allclose(inertias[1], 4.0 * inertias[0], atol=1e-12)


@pytest.mark.parametrize("mass", [0.1, -1.0])
def test_lighter_than_its_asset_is_refused(mass: float) -> None:
    scenario = load_scenario("tabletop", [*BLIND, f"world.objects.can.mass={mass}"])
    with pytest.raises(ScenarioError, match=r"world\.objects\.can\.mass: .*0\.35"):
        build_world(DiagramBuilder(), scenario)


def test_friction_is_that_of_all_of_its_surface_and_of_nothing_else() -> None:
    world = build_world(DiagramBuilder(), load_scenario("tabletop", [*BLIND, "world.objects.can.friction=0.45"]))
    inspector = world.scene_graph.model_inspector()
    for name, expected in (("can", 0.45), ("mug", 0.6)):
        shapes = world.plant.GetCollisionGeometriesForBody(world.plant.get_body(world.objects[name]))
        found = [inspector.GetProximityProperties(s).GetProperty("material", "coulomb_friction") for s in shapes]
        assert len(shapes) > 1
        assert {(f.static_friction(), f.dynamic_friction()) for f in found} == {(expected, expected)}


def test_negative_friction_is_refused() -> None:
    scenario = load_scenario("tabletop", [*BLIND, "world.objects.can.friction=-0.1"])
    with pytest.raises(ScenarioError, match=r"world\.objects\.can\.friction: -0\.1"):
        build_world(DiagramBuilder(), scenario)
