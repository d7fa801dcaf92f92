"""What is picked out of the world's plant: arm, motors and objects among bodies that float."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, PrismaticJoint, RevoluteJoint, SpatialInertia

from twin_diagram.station.sim.truth import TruePoses, TrueState


def test_motors_and_joints_are_found_behind_a_body_that_floats() -> None:
    """It has seven positions and six speeds, so that both stand at different places."""
    plant = MultibodyPlant(0.001)
    ball = SpatialInertia.SolidSphereWithMass(1.0, 0.1)
    plant.AddRigidBody("free", ball)
    parent, joints = plant.world_body(), []
    for name in ("one", "two"):
        body = plant.AddRigidBody(name, ball)
        joints.append(plant.AddJoint(RevoluteJoint(name, parent.body_frame(), body.body_frame(), [0, 0, 1])))
        parent = body
    finger = plant.AddRigidBody("finger", ball)
    slide = plant.AddJoint(PrismaticJoint("slide", parent.body_frame(), finger.body_frame(), [1, 0, 0]))
    plant.Finalize()
    offset = SimpleNamespace(measured_position=lambda names, q: q + np.array([0.5, 0.0]) * (list(names) == ["2", "1"]))
    # The arm's order is not the plant's.
    arm = SimpleNamespace(
        joints=joints[::-1], fingers=[slide], effects=(offset,), arm=SimpleNamespace(joints=("2", "1"))
    )
    system = TrueState(plant, arm)  # type: ignore[arg-type]
    context, scratch = system.CreateDefaultContext(), plant.CreateDefaultContext()
    for joint, angle, rate in ((joints[0], 0.1, 1.1), (joints[1], 0.2, 1.2)):
        joint.set_angle(scratch, angle)
        joint.set_angular_rate(scratch, rate)
    slide.set_translation(scratch, 0.3)
    slide.set_translation_rate(scratch, 1.3)
    state = plant.GetPositionsAndVelocities(scratch)
    system.get_input_port().FixValue(context, state)
    motors = system.GetOutputPort("motor_state").Eval(context)
    np.testing.assert_allclose(motors, [0.7, 0.1, 0.3, 1.2, 1.1, 1.3])
    np.testing.assert_allclose(system.GetOutputPort("arm_state").Eval(context), [0.2, 0.1, 1.2, 1.1])
    np.testing.assert_array_equal(plant.GetPositionsAndVelocities(scratch), state)


def test_poses_are_the_objects_own_in_their_order_with_a_positive_first_number() -> None:
    poses = [RigidTransform(RollPitchYaw(0.3 * k, 3.0, 2.0 - k), [k, 2.0 * k, -k]) for k in range(5)]
    bodies = [BodyIndex(3), BodyIndex(1), BodyIndex(4)]
    system = TruePoses(bodies)
    context = system.CreateDefaultContext()
    system.get_input_port().FixValue(context, Value(poses))
    found = system.get_output_port().Eval(context).reshape(3, 7)
    for row, body in zip(found, bodies, strict=True):
        X = poses[int(body)]
        assert row[0] >= 0.0
        np.testing.assert_allclose(row[4:], X.translation())
        np.testing.assert_allclose(np.abs(row[:4] @ X.rotation().ToQuaternion().wxyz()), 1.0)
