"""Arms whose equations fit on a line: a gantry of two slides, a crank in a level plane."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import FixedOffsetFrame, PrismaticJoint, RevoluteJoint, SpatialInertia, UnitInertia

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms, Laws
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.scenario import Filter

BRIDGE, CAR = 3.0, 2.0
"""Masses of the gantry's bodies: the bridge moves along x and carries the car, which moves along y [kg]."""
INERTIA, RADIUS = 0.5, 0.8
"""Of the crank about its pin [kg·m²], and of its hand [m]."""
EFFORT, SPEED = (40.0, 20.0), (2.0, 1.0)
"""Limits of the gantry's joints."""


def constant_friction(*forward: float, backward: tuple[float, ...] | None = None) -> Laws:
    """Return dry friction of these levels, whatever the arm does."""
    levels = np.array(forward), np.array(backward or forward)
    return Laws(dry=lambda q, v, tau: levels)


def gantry(laws: Laws | None = None, damping: tuple[float, float] = (0.0, 0.0), gravity: bool = False) -> ArmTerms:
    """Return two slides, x then y: masses of 5 and 2 kg, no coupling, and no torque from gravity."""
    plant = MultibodyPlant(0.0)
    if not gravity:
        plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    before = plant.world_frame()
    for k, (name, mass, axis) in enumerate((("bridge", BRIDGE, [1, 0, 0]), ("car", CAR, [0, 1, 0]))):
        body = plant.AddRigidBody(name, SpatialInertia(mass, np.zeros(3), UnitInertia.SolidSphere(0.1)))
        joint = plant.AddJoint(
            PrismaticJoint(f"{name}_slide", before, body.body_frame(), np.array(axis, dtype=float), damping=damping[k])
        )
        joint.set_velocity_limits([-SPEED[k]], [SPEED[k]])
        plant.AddJointActuator(f"{name}_motor", joint, effort_limit=EFFORT[k])
        before = body.body_frame()
    plant.Finalize()
    return ArmTerms(plant, ["bridge_slide", "car_slide"], laws=laws)


def crank(laws: Laws | None = None, damping: float = 0.0, effort: float = 30.0) -> ArmTerms:
    """Return a crank about z, without gravity's torque; its tool is the hand."""
    plant = MultibodyPlant(0.0)
    mass, centre = 1.0, 0.4
    about = SpatialInertia(mass, np.array([centre, 0.0, 0.0]), UnitInertia(0.01, INERTIA / mass, INERTIA / mass))
    body = plant.AddRigidBody("arm", about)
    joint = plant.AddJoint(
        RevoluteJoint("pin", plant.world_frame(), body.body_frame(), np.array([0.0, 0.0, 1.0]), damping=damping)
    )
    joint.set_velocity_limits([-10.0], [10.0])
    plant.AddJointActuator("motor", joint, effort_limit=effort)
    plant.AddFrame(FixedOffsetFrame("hand", body.body_frame(), RigidTransform([RADIUS, 0.0, 0.0])))
    plant.Finalize()
    return ArmTerms(plant, ["pin"], tool_frame="hand", laws=laws)


def begun(params: Filter, laws: Laws | None = None, v: tuple[float, float] = (0.5, -0.4), t: float = 1.0) -> Ekf:
    """Return a filter of the gantry, started while both slides move."""
    ekf = Ekf(gantry(laws), params)
    ekf.start(np.array([0.1, -0.2]), np.array(v), np.zeros(2), t)
    return ekf
