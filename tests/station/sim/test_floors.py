"""Floors without an end: things lie on them, and distances from them are told."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydrake.math import RigidTransform
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from twin_diagram.scenario import Scenario, WorldObject
from twin_diagram.station.sim.world_plant import build_world

ARM = """<mujoco model="it"><worldbody><geom name="floor" type="plane" size="1 1 0.1" pos="0 0 -0.2"/>
<body name="upper" pos="0 0 0.5"><joint name="shoulder" axis="0 1 0"/><inertial pos="0 0 0" mass="1"
diaginertia="1 1 1"/><geom type="capsule" size="0.05" fromto="0 0 0 0 0 0.4"/></body></worldbody></mujoco>"""


@pytest.fixture
def scenario(tmp_path: Path) -> Scenario:
    (tmp_path / "it.xml").write_text(ARM)
    scenario = Scenario()
    scenario.world.arm.model = str(tmp_path / "it.xml")
    scenario.world.arm.tool_frame = ""
    scenario.world.fixtures = []
    scenario.world.objects = {"mug": WorldObject(asset="objects/mug")}
    return scenario


def test_distances_from_a_floor_are_told_and_it_holds_what_lies_on_it(scenario: Scenario) -> None:
    builder = DiagramBuilder()
    world = build_world(builder, scenario)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = world.plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    mug = world.plant.get_body(BodyIndex(world.objects["mug"]))
    world.plant.SetFreeBodyPose(context, mug, RigidTransform([0.6, 0.3, -0.1]))
    scene = diagram.GetSubsystemByName(world.scene_graph.get_name())
    query = scene.GetOutputPort("query").Eval(scene.GetMyContextFromRoot(simulator.get_context()))
    distances = [pair.distance for pair in query.ComputeSignedDistancePairwiseClosestPoints(1.0)]
    assert min(abs(distance - 0.65) for distance in distances) < 1e-4  # the capsule's end, 0.45 above z = 0
    simulator.AdvanceTo(0.6)
    height = world.plant.EvalBodyPoseInWorld(context, mug).translation()[2] + 0.2
    assert 0.02 < height < 0.08
