"""What stands still stands in the same place for scene, planner, stop monitor and simulated station."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder

from twin_diagram import scenario
from twin_diagram.errors import ModelError
from twin_diagram.model.description.fixtures import add_fixture, weld_roots
from twin_diagram.planning.braking.drake_distances import DrakeDistances, Shapes
from twin_diagram.planning.collision.collision_scene import Forecast, load_scene
from twin_diagram.planning.collision.geometry_to_solids import fixture_solids
from twin_diagram.scenario.poses import pose
from twin_diagram.scene.twin_scene import add_twin_scene
from twin_diagram.signals.arrays import Array
from twin_diagram.station.add_models import add_model

BOX = '<collision name="c"><geometry><box><size>0.2 0.2 0.02</size></box></geometry></collision>'
INERTIA = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
LINK = (
    '<link name="{}"><inertial><mass value="1"/>'
    + INERTIA
    + "</inertial><collision><geometry>{}</geometry></collision></link>"
)
SLAB = '<box size="0.2 0.2 0.02"/>'
FIXED = '<joint name="j" type="fixed"><parent link="{}"/><child link="{}"/><origin xyz="0 0 0.5"/></joint>'
WHERE = scenario.Pose([1.0, 2.0, 3.0], [0.0, 0.0, 0.5])
KINDS = {
    "free.sdf": (f'<sdf version="1.9"><model name="m"><link name="a">{BOX}</link></model></sdf>', [0.0]),
    "static.sdf": (
        f'<sdf version="1.9"><model name="m"><static>true</static><link name="a">{BOX}</link></model></sdf>',
        [0.0],
    ),
    "on_world.urdf": (
        '<robot name="m"><link name="world"/>' + LINK.format("a", SLAB) + FIXED.format("world", "a") + "</robot>",
        [0.5],
    ),
    "child_first.urdf": (
        '<robot name="m">'
        + LINK.format("top", SLAB)
        + LINK.format("base", SLAB)
        + FIXED.format("base", "top")
        + "</robot>",
        [0.5, 0.0],
    ),
    "worlds.xml": ('<mujoco model="m"><worldbody><geom type="box" size="0.1 0.1 0.01"/></worldbody></mujoco>', [0.0]),
    "mesh.urdf": ('<robot name="m">' + LINK.format("a", '<mesh filename="slab.stl"/>') + "</robot>", [0.0]),
}
"""Descriptions of one or two slabs, and how high each is above the model's frame [m]."""


@pytest.fixture(params=KINDS)
def fixture(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[scenario.Fixture, Array]:
    text, heights = KINDS[request.param]
    trimesh.creation.box(extents=(0.2, 0.2, 0.02)).export(tmp_path / "slab.stl")
    (tmp_path / request.param).write_text(text)
    expected = np.array(WHERE.translation) + np.array([[0.0, 0.0, z] for z in heights])
    return scenario.Fixture(str(tmp_path / request.param), WHERE), expected


def places(plant: MultibodyPlant, first: int) -> Array:
    """Where the bodies from an index on are; each is turned as told."""
    context = plant.CreateDefaultContext()
    bodies = [plant.get_body(BodyIndex(k)) for k in range(first, plant.num_bodies())]
    poses = [plant.EvalBodyPoseInWorld(context, body) for body in bodies]
    for X_WB in poses:
        np.testing.assert_allclose(X_WB.rotation().matrix(), pose(WHERE).rotation().matrix(), atol=1e-12)
    return np.array([X_WB.translation() for X_WB in poses])


def test_all_have_a_fixture_where_it_is_told(fixture: tuple[scenario.Fixture, Array]) -> None:
    told, expected = fixture
    ((_, solids),) = fixture_solids([told])
    np.testing.assert_allclose([solid.ball[0] for solid in solids], expected, atol=1e-9)

    world, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    weld_roots(world, add_model(world, "fixture0", {}, told.model, still=True), pose(told.X_WB))
    world.Finalize()
    np.testing.assert_allclose(places(world, 1), expected, atol=1e-12)

    own, _ = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    bodies = add_fixture(own, told)
    own.Finalize()
    assert len(bodies) == len(expected)
    np.testing.assert_allclose(places(own, 1), expected, atol=1e-12)


def test_scene_and_stop_monitor_have_it_there_too(tmp_path: Path) -> None:
    (tmp_path / "static.sdf").write_text(KINDS["static.sdf"][0])
    arm = scenario.ArmModel(model="arms/ur5e.urdf", tool_frame="tool0")
    told = scenario.Fixture(str(tmp_path / "static.sdf"), WHERE)
    scene = add_twin_scene(DiagramBuilder(), scenario.Twin(arm=arm, fixtures=[told], camera=None))
    last = scene.plant.num_bodies() - 1
    np.testing.assert_allclose(places(scene.plant, last), [WHERE.translation], atol=1e-12)
    plant = DrakeDistances(arm, [told], {}, 0, 0)._plant
    np.testing.assert_allclose(places(plant, plant.num_bodies() - 1), [WHERE.translation], atol=1e-12)


def test_what_cannot_be_read_is_told_by_its_file(tmp_path: Path) -> None:
    (tmp_path / "bad.sdf").write_text("<sdf>")
    with pytest.raises(ModelError, match=r"bad\.sdf: cannot be read: "):
        add_fixture(MultibodyPlant(0.0), scenario.Fixture(str(tmp_path / "bad.sdf")))


WORLD = """<mujoco model="arm"><worldbody>
  <geom name="floor" type="plane" size="0 0 0.1"/>
  <geom name="pillar" type="cylinder" size="0.05 0.5" pos="0.7 0 0.5"/>
  <body name="base"><geom type="capsule" size="0.04" fromto="0 0 0.05 0 0 0.3"/>
    <body name="upper" pos="0 0 0.35"><joint name="lift" axis="0 1 0" range="-2 2" limited="true"/>
      <geom type="capsule" size="0.04" fromto="0.05 0 0 0.4 0 0"/>
    </body></body>
</worldbody><actuator><motor joint="lift"/></actuator></mujoco>"""
"""An arm as MuJoCo's collections of robots have them: it stands upon a floor of its own, here beside a pillar."""


def test_what_an_arms_description_puts_into_the_world_stands_in_its_way(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text(WORLD)
    arm = scenario.ArmModel(model=str(tmp_path / "scene.xml"), tool_frame="upper")
    nothing = np.zeros(0, dtype=bool)
    monitor = DrakeDistances(arm, [], {}, 0, 0)
    monitor.surround(Shapes(nothing, [], []))
    assert monitor.names == ("scene",) and monitor.fixture_count == 1
    scene = load_scene(arm, [], {})
    assert [body.name for body in scene.clearance.bodies] == ["scene"] and scene.fixture_count == 1
    # The capsule ends 0.21 m short of the pillar while it is level, and 0.02 m above the floor where it hangs at 0.8.
    for q, expected in ((0.0, 0.7 - 0.05 - 0.44), (0.8, 0.35 - 0.4 * np.sin(0.8) - 0.04)):
        found = monitor.near(np.array([q]), np.ones(1), None, nothing, np.zeros((0, 4, 4)), 0.5)
        assert set(found.body) == {0}
        np.testing.assert_allclose(found.distance.min(), expected, atol=2e-3)
        around = scene.around(Forecast.of_tracks(np.zeros(0)), np.zeros(1))
        planned = scene.clearance.distances(np.array([[q]]), around, 0.5)[0, 0]
        assert 0.0 < expected - planned < 0.03, "balls about the arm stand out a little"
