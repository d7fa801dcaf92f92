"""What rests and has nothing near to it is held still; it is free before anything that moves comes to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from pydrake.geometry import AddContactMaterial, Box, ProximityProperties
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, DiscreteContactApproximation
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from twin_diagram.station.sim.resting_bodies import RestingBodies, ball_about

EDGE, STEP = 0.06, 0.0025


@dataclass
class World:
    """Cubes on a floor, and a paddle that comes along x when it is told to."""

    plant: Any
    simulator: Any
    context: Any
    paddle: Any
    cubes: list[Any]
    resting: RestingBodies

    def run(self, seconds: float, look: bool = True) -> None:
        end = self.simulator.get_context().get_time() + seconds
        while (now := self.simulator.get_context().get_time()) < end - 1e-6:
            if look:
                self.resting.looked_at(self.context)
            self.simulator.AdvanceTo(now + 0.01)

    def place(self, number: int) -> Any:
        return np.array(self.cubes[number].EvalPoseInWorld(self.context).translation())


def world(places: list[list[float]], on_world: bool = False) -> World:
    builder = DiagramBuilder()
    plant, scene = AddMultibodyPlantSceneGraph(builder, STEP)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    rough = ProximityProperties()
    AddContactMaterial(1.0, 1e5, CoulombFriction(0.5, 0.5), rough)
    floor = RigidTransform(np.array([0.0, 0.0, -0.5]))
    ground = plant.world_body()
    if not on_world:
        ground = plant.AddRigidBody("ground", SpatialInertia.SolidBoxWithMass(1.0, 1.0, 1.0, 1.0))
        plant.WeldFrames(plant.world_frame(), ground.body_frame())
    plant.RegisterCollisionGeometry(ground, floor, Box(4.0, 4.0, 1.0), "floor", rough)
    cubes = []
    for k in range(len(places)):
        cube = plant.AddRigidBody(f"cube {k}", SpatialInertia.SolidBoxWithMass(0.3, EDGE, EDGE, EDGE))
        plant.RegisterCollisionGeometry(cube, RigidTransform(), Box(EDGE, EDGE, EDGE), "cube", rough)
        cubes.append(cube)
    paddle = plant.AddRigidBody("paddle", SpatialInertia.SolidBoxWithMass(20.0, 0.02, 0.1, 0.02))
    along = plant.AddJoint(PrismaticJoint("x", plant.world_frame(), paddle.body_frame(), np.array([1.0, 0.0, 0.0])))
    raised = RigidTransform(np.array([0.0, 0.0, 0.02]))
    plant.RegisterCollisionGeometry(paddle, raised, Box(0.02, 0.1, 0.02), "paddle", rough)
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    along.set_translation(context, -1.5)
    for cube, place in zip(cubes, places, strict=True):
        plant.SetFloatingBaseBodyPoseInWorldFrame(context, cube, RigidTransform(np.array(place)))
    bodies = {cube.name(): cube.index() for cube in cubes}
    resting = RestingBodies(plant, scene.model_inspector(), bodies, [paddle.index()])
    simulator.Initialize()
    return World(plant, simulator, context, along, cubes, resting)


def test_what_falls_is_free_until_it_has_rested() -> None:
    """It falls as without; a second later it is locked where it lies, and stays there."""
    one, other = (world([[0.0, 0.0, 0.1]]) for _ in range(2))
    one.run(0.3)
    other.run(0.3, look=False)
    assert not one.resting.asleep
    np.testing.assert_array_equal(one.place(0), other.place(0))
    one.run(1.0)
    assert one.resting.asleep == {0}
    there = one.place(0)
    one.run(1.0)
    np.testing.assert_array_equal(one.place(0), there)
    assert there[2] == pytest.approx(0.5 * EDGE, abs=1e-3)


def test_it_is_free_before_it_is_met() -> None:
    """A paddle shoves it and what stands beside it as it shoves what never was locked, which turns as chance has it."""
    places = [[0.0, 0.0, 0.5 * EDGE], [0.08, 0.0, 0.5 * EDGE], [0.6, 0.8, 0.5 * EDGE]]
    one, other = (world(places) for _ in range(2))
    for each, look in ((one, True), (other, False)):
        each.run(1.0, look)
        if look:
            assert each.resting.asleep == {0, 1, 2}
        each.paddle.set_translation_rate(each.context, 1.0)
        each.run(1.55, look)
    assert one.resting.asleep == {2}  # it is not in the way
    assert one.place(0)[0] > 0.5 * EDGE
    for number in (0, 1):
        assert one.place(number)[0] == pytest.approx(other.place(number)[0], abs=0.01)


def test_what_others_locked_stays_locked() -> None:
    """To wake all, as one does who puts things elsewhere, frees what was locked here alone."""
    one = world([[0.0, 0.0, 0.5 * EDGE], [0.5, 0.0, -3.0]])
    one.cubes[1].Lock(one.context)
    one.run(1.0)
    assert one.resting.asleep == {0}
    one.resting.wake(one.context)
    assert not one.cubes[0].is_locked(one.context) and one.cubes[1].is_locked(one.context)


def test_on_the_world_itself_nothing_is_locked() -> None:
    """What is locked there ends the process."""
    one = world([[0.0, 0.0, 0.5 * EDGE]], on_world=True)
    one.run(1.0)
    assert not one.resting.asleep


def test_a_ball_holds_the_whole_body() -> None:
    """Its corners lie on it; what has no end has no ball."""
    one = world([[0.0, 0.0, 0.1]])
    scene = one.simulator.get_system().GetSubsystemByName("scene_graph")
    ball = ball_about(one.plant, scene.model_inspector(), one.cubes[0])
    assert ball is not None and ball.radius == pytest.approx(0.5 * np.sqrt(3.0) * EDGE)
