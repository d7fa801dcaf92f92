"""The vectorised tree of an arm that turns, slides, branches and has springs, against the plant it was read from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    LinearBushingRollPitchYaw,
    PrismaticSpring,
    RevoluteSpring,
    SpatialInertia,
    UnitInertia,
)

from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.model.model import Model
from twin_diagram.model.rigid_body.from_plant import is_whole
from twin_diagram.model.rigid_body.rigid_tree import inertia_vector, transform_inertia
from twin_diagram.scenario import ArmModel, EffectSpec, Pose

LINK = """<link name="{0}"><inertial><origin xyz="0.1 0.02 -0.05" rpy="0.2 0 0.4"/><mass value="{1}"/>
  <inertia ixx="0.03" iyy="0.04" izz="0.05" ixy="0.001" ixz="-0.002" iyz="0.003"/></inertial></link>"""
ARM = """<robot name="arm"><link name="base"/>{links}
  <joint name="turn" type="revolute"><parent link="base"/><child link="a"/><origin xyz="0 0.1 0.2" rpy="0.1 0 0"/>
    <axis xyz="0 0.6 0.8"/><limit lower="-2" upper="2" effort="9" velocity="1"/><dynamics damping="0.7"/></joint>
  <joint name="rail" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="0.1 0 0.3" rpy="0.4 0.2 -0.3"/>
    <axis xyz="0.6 0 0.8"/><limit lower="-1" upper="1" effort="9" velocity="1"/></joint>
  <joint name="bend" type="revolute"><parent link="b"/><child link="c"/><origin xyz="0 0.1 0.2" rpy="0 -0.5 0.7"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="1"/></joint>
  <joint name="tip" type="fixed"><parent link="c"/><child link="d"/><origin xyz="0.1 -0.05 0.2" rpy="0.3 0 1"/></joint>
</robot>"""
Q, V, A = np.random.default_rng(0).uniform(-0.9, 0.9, (3, 30, 3))


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = Path(tmp_path_factory.mktemp("arm")) / "arm.urdf"
    file.write_text(ARM.format(links="".join(LINK.format(name, k + 1.5) for k, name in enumerate("abcd"))))
    return file


def spec(path: Path) -> ArmModel:
    pose = Pose([0.1, -0.2, 0.3], [0.2, 0.1, 0.5])
    return ArmModel(model=str(path), tool_frame="d", X_WB=pose, joints=["turn", "rail", "bend"])


@pytest.fixture(scope="module")
def model(path: Path) -> Model:
    """With two springs on one joint and one on the rail."""
    plant = MultibodyPlant(0.0)
    arm = add_arm(plant, spec(path))
    turn, rail, _ = (plant.get_joint(index) for index in arm.joint_indices)
    plant.AddForceElement(RevoluteSpring(turn, 0.3, 20.0))
    plant.AddForceElement(RevoluteSpring(turn, -0.2, 5.0))
    plant.AddForceElement(PrismaticSpring(rail, 0.15, 40.0))
    plant.Finalize()
    return Model(plant, arm, [])


def test_torques_and_masses_are_the_plants(model: Model) -> None:
    plant, tree = model.plant, model.tree
    np.testing.assert_allclose(tree.stiffness, [25.0, 40.0, 0.0])
    np.testing.assert_allclose(tree.rest, [(20 * 0.3 - 5 * 0.2) / 25, 0.15, 0.0])
    np.testing.assert_array_equal(tree.revolute, [True, False, True])
    assert is_whole(plant)
    once = np.array([model.calls.inverse_dynamics(*sample) for sample in zip(Q, V, A, strict=True)])
    np.testing.assert_allclose(tree.inverse_dynamics(Q, V, A), once, atol=1e-10)
    mass, bias = tree.mass_and_bias(Q, V)
    np.testing.assert_allclose(mass, [model.calls.mass(q) for q in Q], atol=1e-11)
    np.testing.assert_allclose(bias, tree.inverse_dynamics(Q, V, 0 * A), atol=1e-10)
    np.testing.assert_allclose(tree.mass_matrix(Q), mass, atol=1e-12)
    total = sum(tree.regressor(Q, V, A, body) @ tree.inertia[body] for body in range(3))
    rest = tree.rotor * A + tree.damping * V + tree.stiffness * (Q - tree.rest)
    np.testing.assert_allclose(total + rest, once, atol=1e-10)
    for body in range(3):
        told = tree.carried(Q, V, A, body)
        np.testing.assert_array_equal(told.torque, tree.inverse_dynamics(Q, V, A))
        np.testing.assert_array_equal(told.regressor, tree.regressor(Q, V, A, body))
    bare = tree.bare(tree.inertia)
    np.testing.assert_allclose(bare.inverse_dynamics(Q, V, A), once - rest, atol=1e-10)
    tool = model.calls.tool_jacobian(Q[0])
    for k in range(3):
        ahead, behind = (model.calls.tool_pose(Q[0] + s * 1e-6 * np.eye(3)[k]) for s in (1, -1))
        np.testing.assert_allclose(tool[3:, k], (ahead.translation() - behind.translation()) / 2e-6, atol=1e-8)


def test_a_push_gives_what_its_work_says(model: Model) -> None:
    """J^T F, by differences of where the point is."""
    plant, context = model.plant, model.make_context()
    force, moment = np.array([3.0, -2.0, 5.0]), np.array([0.4, 0.7, -0.3])
    for name in "abcd":
        body, X_ML = model.bodies.body_of(name)
        p = X_ML.translation() + X_ML.rotation().matrix() @ np.array([0.1, 0.2, -0.1])
        found = model.tree.pushed(Q[:4], body, np.asarray(p), force, moment)
        for row in range(4):
            for k in range(3):
                poses = []
                for sign in (1, -1):
                    plant.SetPositions(context, Q[row] + sign * 1e-6 * np.eye(3)[k])
                    poses.append(plant.EvalBodyPoseInWorld(context, plant.GetBodyByName(name)))
                moved = (
                    poses[0].multiply(np.array([0.1, 0.2, -0.1])) - poses[1].multiply(np.array([0.1, 0.2, -0.1]))
                ) / 2e-6
                turn = poses[0].rotation().multiply(poses[1].rotation().inverse()).ToAngleAxis()
                expected = force @ moved + moment @ (turn.axis() * turn.angle() / 2e-6)
                assert found[row, k] == pytest.approx(expected, abs=1e-6)
    body, _ = model.bodies.body_of("base")
    assert body == -1 and not model.tree.pushed(Q, -1, np.zeros(3), force, moment).any()


def test_inertia_moves_with_its_frame() -> None:
    inertia = SpatialInertia(2.5, np.array([0.1, -0.2, 0.3]), UnitInertia(0.5, 0.6, 0.7, 0.01, -0.02, 0.03), True)
    X_ML, X_LB = (RigidTransform(RollPitchYaw(*rpy), p) for rpy, p in (
        ([0.4, -0.3, 0.9], [0.3, 0.1, -0.6]), ([-0.2, 0.5, 0.1], [0.0, 0.4, 0.2])))  # fmt: skip
    there = inertia_vector(inertia, X_LB)
    np.testing.assert_allclose(transform_inertia(X_ML) @ there, inertia_vector(inertia, X_ML @ X_LB), atol=1e-12)
    # By Drake: expressed in L and shifted to its origin.
    M = inertia.ReExpress(X_LB.rotation()).Shift(-X_LB.translation())
    tensor = M.CalcRotationalInertia().CopyToFullMatrix3()
    np.testing.assert_allclose(there[:4], [2.5, *(2.5 * np.asarray(M.get_com()))], atol=1e-12)
    np.testing.assert_allclose(there[4:7], np.diag(tensor), atol=1e-12)
    np.testing.assert_allclose(there[7:], [tensor[0, 1], tensor[0, 2], tensor[1, 2]], atol=1e-12)
    assert not inertia_vector(SpatialInertia.Zero(), X_ML).any()


def test_a_plant_with_other_forces_is_not_whole(path: Path) -> None:
    plant = MultibodyPlant(0.0)
    add_arm(plant, spec(path))
    frames = plant.world_frame(), plant.GetFrameByName("d")
    plant.AddForceElement(LinearBushingRollPitchYaw(*frames, *[np.ones(3)] * 4))
    plant.Finalize()
    assert not is_whole(plant)


def test_effects_of_links_and_base_are_the_changed_plants(model: Model, path: Path) -> None:
    tilt = EffectSpec("gravity_tilt", [], [], {"roll": [0.3], "pitch": [-0.2]})
    link = EffectSpec(
        "inertial_parameters", [], ["b"], {"mass": [0.7], "com": [0.01, 0.02, -0.03], "inertia": [0.01] * 6}
    )
    load = EffectSpec("payload", [], ["d"], {"mass": [0.9], "com": [0.1, 0.2, 0.3]})
    plain = Model.load(spec(path))
    loaded = Model.load(replace(spec(path), effects=[tilt, link, load]))
    once = np.array([loaded.inverse_dynamics(*sample) for sample in zip(Q, V, A, strict=True)])
    np.testing.assert_allclose(loaded.inverse_dynamics(Q, V, A), once, atol=1e-10)
    # Gravity turned the other way, about the base's tilt.
    R = RollPitchYaw(0.3, -0.2, 0.0).ToRotationMatrix().matrix()
    turned = replace(loaded.tree, gravity=R.T @ loaded.tree.gravity)
    # What the folded parts weigh is tilted with the arm.
    np.testing.assert_allclose(once, turned.inverse_dynamics(Q, V, A), atol=1e-9)
    assert np.abs(once - plain.inverse_dynamics(Q, V, A)).max() > 1.0
    np.testing.assert_allclose(loaded.mass_matrix(Q[0]) - plain.mass_matrix(Q[0]), (
        loaded.tree.mass_matrix(Q[:1]) - plain.tree.mass_matrix(Q[:1]))[0], atol=1e-11)  # fmt: skip
