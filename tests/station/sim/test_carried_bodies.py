"""What rests in a hand that turns stays where it is in the hand; what slips still slips."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from pydrake.geometry import Box, ProximityProperties, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import RevoluteJoint, SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial.transform import Rotation

from twin_diagram.signals.arrays import Array
from twin_diagram.station.sim.carried_bodies import CarriedBodies, left_behind

RADIUS, RATE, STEP = 0.5, 1.2, 0.0025


def pose(rotation: Rotation, place: Array) -> Array:
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = rotation.as_matrix(), place
    return X


def test_a_body_goes_along_the_arc() -> None:
    """About any axis: a step along the tangent, and what is put back, end where the hand takes it."""
    rng = np.random.default_rng(2)
    axis, through = rng.normal(size=3), rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    turn = Rotation.from_rotvec(0.01 * axis)
    before = pose(Rotation.random(random_state=3), rng.normal(size=3))
    after = pose(turn, through - turn.apply(through)) @ before
    twist = np.concatenate([0.01 * axis, np.cross(0.01 * axis, before[:3, 3] - through)])
    place, held = rng.normal(size=3), Rotation.random(random_state=4)
    along = place + twist[3:] + np.cross(twist[:3], place - before[:3, 3])
    R, shift = left_behind(before, after, twist, place)
    np.testing.assert_allclose(along + shift, turn.apply(place - through) + through, atol=1e-12)
    np.testing.assert_allclose(R @ (turn * held).as_matrix(), (turn * held).as_matrix(), atol=1e-12)
    sagitta = 0.5 * 0.01**2 * np.linalg.norm(np.cross(axis, place - through))
    assert np.linalg.norm(shift) == pytest.approx(sagitta, rel=0.01)


def rough(friction: float) -> ProximityProperties:
    properties = ProximityProperties()
    properties.AddProperty("material", "coulomb_friction", CoulombFriction(friction, friction))
    return properties


def carried(friction: float, mended: bool) -> float:
    """How far outwards a block slides in a second on a tray that turns about the vertical [m]."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, STEP)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    plant.set_stiction_tolerance(1e-5)
    tray = plant.AddRigidBody("tray", SpatialInertia.SolidBoxWithMass(50.0, 1.4, 0.4, 0.02))
    joint = plant.AddJoint(RevoluteJoint("turn", plant.world_frame(), tray.body_frame(), np.array([0.0, 0.0, 1.0])))
    plant.RegisterCollisionGeometry(tray, RigidTransform(), Box(1.4, 0.4, 0.02), "tray", rough(friction))
    block = plant.AddRigidBody("block", SpatialInertia.SolidBoxWithMass(0.5, 0.06, 0.06, 0.04))
    for x, y in ((0.03, 0.03), (0.03, -0.03), (-0.03, 0.03), (-0.03, -0.03)):
        foot = RigidTransform(np.array([x, y, -0.015]))
        plant.RegisterCollisionGeometry(block, foot, Sphere(0.005), f"foot {x} {y}", rough(friction))
    plant.Finalize()
    diagram = builder.Build()
    simulator = Simulator(diagram)
    root = simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    plant.SetFloatingBaseBodyPoseInWorldFrame(context, block, RigidTransform(np.array([RADIUS, 0.0, 0.03])))
    joint.set_angular_rate(context, RATE)
    plant.SetVelocities(context, block_velocity(plant))
    simulator.Initialize()
    bodies = CarriedBodies(plant, tray.body_frame(), [joint], {"block": block.index()}, near=1.0)
    for k in range(1, 401):
        step = partial(simulator.AdvanceTo, k * STEP + 1e-7)
        bodies.stepped(context, step) if mended else step()
    p_TB = tray.EvalPoseInWorld(context).inverse() @ block.EvalPoseInWorld(context).translation()
    return float(p_TB[0]) - RADIUS


def block_velocity(plant: MultibodyPlant) -> Array:
    """All velocities at the start: tray and block turn as one."""
    v = np.zeros(plant.num_velocities())
    v[plant.GetJointByName("turn").velocity_start()] = RATE
    start = plant.GetBodyByName("block").floating_velocities_start_in_v()
    v[start : start + 6] = [0.0, 0.0, RATE, 0.0, RADIUS * RATE, 0.0]
    return v


def test_what_rests_on_a_turning_tray_stays_there() -> None:
    creep = 0.5 * RATE**2 * RADIUS * STEP
    assert carried(0.8, mended=False) == pytest.approx(creep, rel=0.2), "the integrator's, whatever the friction"
    assert abs(carried(0.8, mended=True)) < 0.03 * creep


def test_what_friction_does_not_hold_slides_as_before() -> None:
    free, mended = (carried(0.03, mended=one) for one in (False, True))
    assert free > 0.02 and mended == pytest.approx(free, rel=0.03)
