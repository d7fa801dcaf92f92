"""Loads that are hidden in objects, the friction that they are told, and cameras through which somebody looks."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder

from twin_diagram.errors import ScenarioError, StationError
from twin_diagram.scenario import Camera, Pose, Scenario, WayPoint, WorldObject
from twin_diagram.station.sim.cameras_on_demand import CamerasOnDemand
from twin_diagram.station.sim.world_plant import WorldPlant, build_world


def world(**told: object) -> WorldPlant:
    scenario = Scenario()
    scenario.world.objects = {"box": WorldObject(asset="objects/sugar_box", **told)}  # type: ignore[arg-type]
    return build_world(DiagramBuilder(), scenario)


def whole(found: WorldPlant) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre and moments about O of an object with what is welded to it."""
    plant = found.plant
    body = plant.get_body(found.objects["box"])
    context = plant.CreateDefaultContext()
    inertia = plant.CalcSpatialInertia(context, body.body_frame(), plant.GetBodyIndices(body.model_instance()))
    return inertia.get_mass(), inertia.get_com(), inertia.CalcRotationalInertia().CopyToFullMatrix3()


def test_a_load_sits_where_it_is_told() -> None:
    at = np.array([0.02, -0.01, 0.05])
    own, _, about = whole(world())
    mass, centre, moments = whole(world(mass=own + 0.3, load_at=at.tolist()))
    assert mass == pytest.approx(own + 0.3)
    assert centre == pytest.approx(0.3 / mass * at)
    # A point's moments about O, and those of a ball of a centimetre about its own middle.
    point = 0.3 * (at @ at * np.eye(3) - np.outer(at, at)) + 0.3 * 0.4 * 0.01**2 * np.eye(3)
    assert moments - about == pytest.approx(point, abs=1e-9)


def test_a_load_without_a_place_is_spread_as_the_rest() -> None:
    own, centre, about = whole(world())
    mass, there, moments = whole(world(mass=2 * own))
    assert mass == pytest.approx(2 * own) and there == pytest.approx(centre) and moments == pytest.approx(2 * about)


@pytest.mark.parametrize(
    ("told", "said"),
    [
        ({"mass": 1.0, "load_at": [0.0, 0.1]}, r"load_at: .* is not three numbers"),
        ({"mass": 1.0, "load_at": [float("nan"), 0.0, 0.0]}, r"load_at: .* is not three numbers"),
        ({"mass": 1.0, "load_at": [0.0, 0.0, float("-inf")]}, r"load_at: .* is not three numbers"),
        ({"load_at": [0.0, 0.0, 0.1]}, r"load_at: .* without a mass"),
        ({"push": 5.0}, r"push: 5.0 N push nothing without a path"),
        ({"push": -5.0}, r"push: -5.0 N is not positive"),
        ({"push": 0.0, "path": [WayPoint(0.0), WayPoint(1.0)]}, r"push: 0.0 N is not positive"),
        ({"push": float("inf"), "path": [WayPoint(0.0), WayPoint(1.0)]}, r"push: inf N is not positive"),
        ({"push": float("nan"), "path": [WayPoint(0.0), WayPoint(1.0)]}, r"push: nan N is not positive"),
    ],
)
def test_what_cannot_be_or_would_have_no_effect_is_refused_by_its_field(told: dict[str, object], said: str) -> None:
    with pytest.raises(ScenarioError, match=r"world\.objects\.box\." + said) as error:
        world(**told)
    assert "\n" not in str(error.value)


def test_friction_is_as_told() -> None:
    found = world(friction=0.77)
    inspector = found.scene_graph.model_inspector()
    shapes = found.plant.GetCollisionGeometriesForBody(found.plant.get_body(found.objects["box"]))
    for shape in shapes:
        friction = inspector.GetProximityProperties(shape).GetProperty("material", "coulomb_friction")
        assert friction.static_friction() == friction.dynamic_friction() == 0.77


def test_a_camera_renders_where_somebody_looks(egl: None) -> None:
    scenario = Scenario()
    told = {"width": 80, "height": 60, "focal": 70.0}
    down = Pose([0.5, 0.0, 1.0], [np.pi, 0.0, 0.0])
    scenario.world.fixtures = scenario.twin.fixtures = []
    scenario.world.objects = {"box": WorldObject(asset="objects/sugar_box", X_WO=Pose([0.5, 0.0, 0.2]))}
    scenario.twin.cameras = {"over": Camera(name="over", X_WC=down, **told)}  # type: ignore[arg-type]
    scenario.twin.camera = None
    plant = build_world(DiagramBuilder(), scenario).plant
    eyes, q = CamerasOnDemand(scenario), plant.GetPositions(plant.CreateDefaultContext())
    colour, depth = eyes.look("over", q, 1)
    assert colour.shape == (60, 80, 4) and depth.shape == (60, 80)
    # The box's top is half of its height above its middle.
    assert float(depth[30, 40]) == pytest.approx(1.0 - 0.2 - 0.175 / 2, abs=0.005)
    again = eyes.look("over", q, 1)
    assert (again[0] == colour).all() and (again[1] == depth).all()
    assert (eyes.look("over", q, 2)[1] != depth).any()
    with pytest.raises(StationError, match="these are: over"):
        eyes.look("under", q, 1)
    # Covered from 2 to 3 s, and off from 5 s on.
    scenario.world.camera_defects.covered, scenario.world.camera_defects.stops = [[2.0, 3.0]], 5.0
    eyes = CamerasOnDemand(scenario)
    shows = [all(image.any() for image in eyes.look("over", q, 1, time)) for time in (0.0, 2.5, 4.0, 5.5)]
    assert shows == [True, False, True, False]
    assert not any(image.any() for image in eyes.look("over", q, 1, 2.5))
