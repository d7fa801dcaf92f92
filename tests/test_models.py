"""The models that come along, against independent figures: MuJoCo, the makers' files, Drake's own models."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.tree import MultibodyForces

from tests.loaded_models import (
    IIWA_JOINTS,
    PANDA_FINGERS,
    PANDA_JOINTS,
    UR_JOINTS,
    UR_LINKS,
    WSG_FINGERS,
    Array,
    every_arm,
    load,
    load_arm,
)
from twin_diagram.scenario.resources import models_dir


def load_mujoco(path: Path) -> Any:
    mujoco = pytest.importorskip("mujoco")
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False  # keep every link, as Drake does
    return mujoco, spec.compile()


# --- what each file says --------------------------------------------------------------------------


@every_arm
def test_each_joint_has_limits_and_an_actuator(arm: str) -> None:
    plant = load_arm(arm).plant
    expected = {"pand": PANDA_JOINTS, "iiwa": IIWA_JOINTS, "ur5e": UR_JOINTS}[arm[:4]]
    fingers = {"panda_hand.urdf": PANDA_FINGERS, "iiwa7_wsg.urdf": WSG_FINGERS}.get(arm, ())
    assert tuple(joint.name() for joint in load_arm(arm).joints()) == (*expected, *fingers)
    assert plant.num_actuators() == len(expected) + len(fingers)
    for index in plant.GetJointActuatorIndices():
        assert 0 < plant.get_joint_actuator(index).effort_limit() < 1e3
    for limits in (plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits(), plant.GetVelocityUpperLimits()):
        assert np.all(np.isfinite(limits))
    assert np.all(plant.GetVelocityLowerLimits() == -plant.GetVelocityUpperLimits())


@every_arm
def test_files_need_no_other_file(arm: str) -> None:
    text = (models_dir() / "arms" / arm).read_text()
    assert not re.search(r"<mesh|filename=|package://|https?://(?!drake\.mit\.edu)", text)


@pytest.mark.parametrize(("alone", "mounted"), [("panda.urdf", "panda_hand.urdf"), ("iiwa7.urdf", "iiwa7_wsg.urdf")])
def test_an_arm_is_the_same_with_and_without_its_gripper(alone: str, mounted: str) -> None:
    def parts(name: str) -> dict[tuple[str, str], str]:
        elements = ET.parse(models_dir() / "arms" / name).getroot()
        return {(element.tag, element.get("name", "")): ET.tostring(element).decode().strip() for element in elements}

    arm, both = parts(alone), parts(mounted)
    assert arm.items() <= both.items()


# --- dynamics against MuJoCo, which reads the same file with its own parser -----------------------


@every_arm
def test_mujoco_agrees(arm: str) -> None:
    mujoco, model = load_mujoco(models_dir() / "arms" / arm)
    data = mujoco.MjData(model)
    robot = load_arm(arm)
    plant = robot.plant
    joints = robot.joints()
    assert model.njnt == len(joints)
    q_of = [model.joint(joint.name()).qposadr[0] for joint in joints]
    v_of = [model.joint(joint.name()).dofadr[0] for joint in joints]
    bodies = [model.body(k).name for k in range(1, model.nbody)]
    for name in bodies:
        mass = plant.GetBodyByName(name).default_mass()
        np.testing.assert_allclose(model.body(name).mass[0], mass, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(model.body_mass.sum(), plant.CalcTotalMass(robot.context), rtol=1e-12)
    ranges = [(joint.position_lower_limits()[0], joint.position_upper_limits()[0]) for joint in joints]
    np.testing.assert_allclose([model.joint(joint.name()).range for joint in joints], ranges, rtol=1e-12)
    np.testing.assert_allclose(
        [model.jnt_actfrcrange[model.joint(j.name()).id][1] for j in joints],
        [plant.get_joint_actuator(index).effort_limit() for index in plant.GetJointActuatorIndices()],
    )

    rng = np.random.default_rng(20)
    for _ in range(10):
        q, v = robot.draw(rng), rng.normal(size=len(joints))
        plant.SetPositions(robot.context, q)
        plant.SetVelocities(robot.context, v)
        data.qpos[q_of], data.qvel[v_of] = q, v
        mujoco.mj_forward(model, data)
        for name in bodies:
            X_WL = robot.pose(name)
            np.testing.assert_allclose(data.body(name).xpos, X_WL[:3, 3], atol=1e-9)
            np.testing.assert_allclose(data.body(name).xmat.reshape(3, 3), X_WL[:3, :3], atol=1e-9)
        mass = np.zeros((model.nv, model.nv))
        for column in range(model.nv):
            mujoco.mj_mulM(model, data, mass[column], np.eye(model.nv)[column])
        expected = plant.CalcMassMatrix(robot.context) - np.diag(robot.rotors())
        np.testing.assert_allclose(mass[np.ix_(v_of, v_of)], expected, atol=1e-8)
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(robot.context, forces)
        bias = plant.CalcInverseDynamics(robot.context, np.zeros(len(joints)), forces)
        np.testing.assert_allclose(data.qfrc_bias[v_of], bias, atol=1e-7)
        data.qvel[:] = 0
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qfrc_bias[v_of], robot.gravity_torque(), atol=1e-7)


# --- published figures ----------------------------------------------------------------------------


class Published(NamedTuple):
    """A serial arm as its maker's files give it. Tensors about the centre of mass, in the link's axes."""

    joints: tuple[str, ...]
    links: tuple[str, ...]
    X_PJ: list[Array]
    mass: list[float]
    com: list[Array]
    inertia: list[Array]
    limits: list[tuple[float, float, float, float]]  # lower, upper, velocity, effort


def _pose(values: dict[str, float]) -> Array:
    rotation = RollPitchYaw(values["roll"], values["pitch"], values["yaw"])
    return np.asarray(RigidTransform(rotation, [values[key] for key in "xyz"]).GetAsMatrix4())


def _symmetric(xx: float, xy: float, xz: float, yy: float, yz: float, zz: float) -> Array:
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def published_panda(data: Path) -> Published:
    def read(part: str) -> Any:
        return yaml.safe_load((data / "arm_parameters" / "franka" / f"fer_{part}.yaml").read_text())

    kinematics, inertials, limits = read("kinematics"), read("inertials"), read("joint_limits")
    bodies = [inertials[f"link{k}"] for k in range(1, 8)]
    return Published(
        PANDA_JOINTS,
        tuple(f"panda_link{k}" for k in range(1, 8)),
        [_pose(kinematics[f"joint{k}"]["kinematic"]) for k in range(1, 8)],
        [body["mass"] for body in bodies],
        [np.array(body["origin"]["xyz"].split(), float) for body in bodies],
        [_symmetric(*(body["inertia"][key] for key in ("xx", "xy", "xz", "yy", "yz", "zz"))) for body in bodies],
        [
            (limit["lower"], limit["upper"], limit["velocity"], limit["effort"])
            for limit in (limits[f"joint{k}"]["limit"] for k in range(1, 8))
        ],
    )


def published_ur5e(data: Path) -> Published:
    class Degrees(yaml.SafeLoader):
        """Reads the maker's own tag for angles."""

    Degrees.add_constructor("!degrees", lambda _, node: np.deg2rad(float(node.value)))

    def read(part: str) -> Any:
        return yaml.load((data / "arm_parameters" / "ur5e" / f"{part}.yaml").read_text(), Degrees)

    kinematics = read("default_kinematics")["kinematics"]
    physical = read("physical_parameters")["inertia_parameters"]
    limits = read("joint_limits")["joint_limits"]
    number = r"\s+(-?[\d.]+)"
    source = (data / "arm_parameters" / "SOURCE.md").read_text()
    quarter = {"shoulder": np.pi / 2, "wrist_1": np.pi / 2, "wrist_2": -np.pi / 2}
    inertia = []
    for link in UR_LINKS:
        row = re.search(rf"^{link}{number * 6}", source, re.MULTILINE)
        assert row is not None
        R = RollPitchYaw(quarter.get(link, 0.0), 0, 0).ToRotationMatrix().matrix()
        inertia.append(R @ _symmetric(*map(float, row.groups())) @ R.T)
    return Published(
        UR_JOINTS,
        tuple(f"{link}_link" for link in UR_LINKS),
        [_pose(kinematics[link]) for link in UR_LINKS],
        [physical[f"{link}_mass"] for link in UR_LINKS],
        [np.array([physical["center_of_mass"][f"{link}_cog"][key] for key in "xyz"]) for link in UR_LINKS],
        inertia,
        [
            (limit["min_position"], limit["max_position"], limit["max_velocity"], limit["max_effort"])
            for limit in (limits[joint] for joint in UR_JOINTS)
        ],
    )


def serial_arm(arm: Published, q: Array) -> tuple[list[Array], Array, Array]:
    """Link poses in the base, mass matrix and gravity torque from sums over the links, with no library."""
    n = len(q)
    X = np.eye(4)
    poses, axes, origins = [], [], []
    mass_matrix, gravity = np.zeros((n, n)), np.zeros(n)
    for k in range(n):
        c, s = np.cos(q[k]), np.sin(q[k])
        X = X @ arm.X_PJ[k] @ np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        poses.append(X)
        axes.append(X[:3, 2])
        origins.append(X[:3, 3])
        R, p_com = X[:3, :3], X[:3, :3] @ arm.com[k] + X[:3, 3]
        Jw, Jv = np.zeros((3, n)), np.zeros((3, n))
        for i in range(k + 1):
            Jw[:, i], Jv[:, i] = axes[i], np.cross(axes[i], p_com - origins[i])
        mass_matrix += arm.mass[k] * Jv.T @ Jv + Jw.T @ R @ arm.inertia[k] @ R.T @ Jw
        gravity += arm.mass[k] * 9.81 * Jv[2]
    return poses, mass_matrix, gravity


MAKERS: list[tuple[str, str, Callable[[Path], Published]]] = [
    ("panda.urdf", "panda_link0", published_panda),
    ("ur5e.urdf", "base_link_inertia", published_ur5e),
]
every_maker = pytest.mark.parametrize(("arm", "base", "read"), MAKERS, ids=[maker[0] for maker in MAKERS])


@every_maker
def test_links_and_limits_are_the_published_ones(
    arm: str, base: str, read: Callable[[Path], Published], data_dir: Path
) -> None:
    expected, plant = read(data_dir), load_arm(arm).plant
    joints = [plant.GetJointByName(name) for name in expected.joints]
    limits = [
        (joint.position_lower_limit(), joint.position_upper_limit(), joint.velocity_upper_limit())
        for joint in joints
    ]  # fmt: skip
    np.testing.assert_allclose(np.ravel(limits), np.ravel([limit[:3] for limit in expected.limits]), rtol=1e-11)
    effort = {
        plant.get_joint_actuator(index).joint().name(): plant.get_joint_actuator(index).effort_limit()
        for index in plant.GetJointActuatorIndices()
    }
    assert [effort[name] for name in expected.joints] == [limit[3] for limit in expected.limits]
    for k, link in enumerate(expected.links):
        body = plant.GetBodyByName(link)
        inertia = body.default_spatial_inertia()
        np.testing.assert_allclose(inertia.get_mass(), expected.mass[k], rtol=1e-12)
        np.testing.assert_allclose(inertia.get_com(), expected.com[k], atol=1e-12)
        about_com = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
        if link == "panda_link4":  # the one figure that was corrected; see the next test
            about_com[0, 1] = about_com[1, 0] = -about_com[0, 1]
        np.testing.assert_allclose(about_com, expected.inertia[k], atol=1e-12)


def test_the_corrected_product_of_inertia_is_the_only_way_out(data_dir: Path) -> None:
    """Link 4 of the Panda is published with a tensor of no body; turning the sign of Ixy, and no more, makes it one.

    Its mass lies towards -x and +y of the link's frame, so that -sum(m x y) is positive.
    """
    published = published_panda(data_dir)
    assert not _is_physical(published.inertia[3])
    assert published.com[3][0] < 0 < published.com[3][1] and published.inertia[3][0, 1] < 0
    corrected = published.inertia[3].copy()
    corrected[0, 1] = corrected[1, 0] = -corrected[0, 1]
    assert _is_physical(corrected)


def _is_physical(inertia: Array) -> bool:
    moments = np.linalg.eigvalsh(inertia)
    return bool(moments[0] > 0 and moments[0] + moments[1] >= moments[2])


@every_maker
def test_published_figures_alone_give_the_same_arm(
    arm: str, base: str, read: Callable[[Path], Published], data_dir: Path
) -> None:
    expected, robot = read(data_dir), load_arm(arm)
    if arm == "panda.urdf":
        expected.inertia[3][0, 1] = expected.inertia[3][1, 0] = -expected.inertia[3][0, 1]
    rng = np.random.default_rng(5)
    for _ in range(10):
        q = robot.draw(rng)
        robot.plant.SetPositions(robot.context, q)
        poses, mass_matrix, gravity = serial_arm(expected, q)
        for link, X_BL in zip(expected.links, poses, strict=True):
            np.testing.assert_allclose(robot.pose(link, base), X_BL, atol=2e-9)
        np.testing.assert_allclose(robot.plant.CalcMassMatrix(robot.context), mass_matrix, atol=1e-8)
        np.testing.assert_allclose(robot.gravity_torque(), gravity, atol=1e-7)


# --- Drake's own models ---------------------------------------------------------------------------


def test_iiwa_matches_drakes_model(data_dir: Path) -> None:
    """Same figures; Drake's file rounds right angles to 1.5708, which bounds what can agree."""
    folder = data_dir / "drake_models"
    other = load(folder / "iiwa_description" / "sdf" / "iiwa7_no_collision.sdf", packages=folder)
    robot = load_arm("iiwa7.urdf")
    rng = np.random.default_rng(7)
    for k in range(8):
        name = f"iiwa_link_{k}"
        assert robot.plant.GetBodyByName(name).default_mass() == other.plant.GetBodyByName(name).default_mass()
    for attribute in ("GetPositionLowerLimits", "GetPositionUpperLimits", "GetVelocityUpperLimits"):
        np.testing.assert_allclose(getattr(robot.plant, attribute)(), getattr(other.plant, attribute)(), rtol=1e-10)
    np.testing.assert_allclose(robot.plant.GetEffortUpperLimits(), other.plant.GetEffortUpperLimits())
    np.testing.assert_allclose(robot.rotors(), other.rotors(), rtol=1e-12)
    for _ in range(10):
        q = robot.draw(rng)
        for each in (robot, other):
            each.plant.SetPositions(each.context, q)
        for k in range(8):
            np.testing.assert_allclose(robot.pose(f"iiwa_link_{k}"), other.pose(f"iiwa_link_{k}"), atol=3e-5)
        M = [each.plant.CalcMassMatrix(each.context) for each in (robot, other)]
        np.testing.assert_allclose(M[0], M[1], atol=1e-4)
        np.testing.assert_allclose(robot.gravity_torque(), other.gravity_torque(), atol=2e-3)


def test_panda_moves_as_drakes_model(data_dir: Path) -> None:
    """Kinematics and limits only: Drake's file carries older estimates of the masses."""
    folder = data_dir / "drake_models"
    other = load(folder / "franka_description" / "urdf" / "panda_arm_hand.urdf", packages=folder)
    robot = load_arm("panda_hand.urdf")
    links = [f"panda_link{k}" for k in range(9)] + ["panda_hand", "panda_leftfinger", "panda_rightfinger"]
    for attribute in ("GetPositionLowerLimits", "GetPositionUpperLimits", "GetVelocityUpperLimits"):
        np.testing.assert_allclose(getattr(robot.plant, attribute)(), getattr(other.plant, attribute)())
    np.testing.assert_allclose(robot.plant.GetEffortUpperLimits()[:7], other.plant.GetEffortUpperLimits()[:7])
    rng = np.random.default_rng(8)
    for _ in range(10):
        q = robot.draw(rng)
        for each in (robot, other):
            each.plant.SetPositions(each.context, q)
        for link in links:
            np.testing.assert_allclose(robot.pose(link), other.pose(link), atol=1e-9)


def test_hand_matches_the_published_figures(data_dir: Path) -> None:
    figures = yaml.safe_load((data_dir / "arm_parameters" / "franka" / "hand_inertials.yaml").read_text())
    plant = load_arm("panda_hand.urdf").plant
    for name in ("hand", "leftfinger", "rightfinger"):
        inertia = plant.GetBodyByName(f"panda_{name}").default_spatial_inertia()
        com = np.array(figures[name]["origin"]["xyz"].split(), float)
        values = figures[name]["inertia"]
        tensor = _symmetric(*(values[key] for key in ("xx", "xy", "xz", "yy", "yz", "zz")))
        turn = np.diag([-1.0, -1.0, 1.0]) if name == "rightfinger" else np.eye(3)  # the same part, half a turn about z
        assert inertia.get_mass() == figures[name]["mass"]
        np.testing.assert_allclose(inertia.get_com(), turn @ com, atol=1e-12)
        about_com = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
        np.testing.assert_allclose(about_com, turn @ tensor @ turn, atol=1e-12)


def test_wsg_moves_and_weighs_as_drakes_model(data_dir: Path) -> None:
    """Not its inertias: those of Drake's file are place-holders of metre-sized bodies."""
    folder = data_dir / "drake_models"
    path = folder / "wsg_50_description" / "sdf" / "schunk_wsg_50_with_tip.sdf"
    other, robot = load(path, root="body", packages=folder), load_arm("iiwa7_wsg.urdf")
    for joint in WSG_FINGERS:
        ours, theirs = robot.plant.GetJointByName(joint), other.plant.GetJointByName(joint)
        np.testing.assert_allclose(ours.position_lower_limits(), theirs.position_lower_limits())
        np.testing.assert_allclose(ours.position_upper_limits(), theirs.position_upper_limits())
    rng = np.random.default_rng(9)
    for _ in range(5):
        q = robot.draw(rng)
        robot.plant.SetPositions(robot.context, q)
        for joint, value in zip(WSG_FINGERS, q[-2:], strict=True):
            other.plant.GetJointByName(joint).set_translation(other.context, value)
        for ours_name, theirs_name in (("wsg_left_finger", "left_finger"), ("wsg_right_finger", "right_finger")):
            assert robot.plant.GetBodyByName(ours_name).default_mass() == 0.05
            # Drake's left finger frame is turned over: positions alone.
            ours, theirs = robot.pose(ours_name, "wsg_body"), other.pose(theirs_name, "body")
            np.testing.assert_allclose(ours[:3, 3], theirs[:3, 3], atol=1e-6)
    assert robot.plant.GetBodyByName("wsg_body").default_mass() == other.plant.GetBodyByName("body").default_mass()


# --- physics ---------------------------------------------------------------------------


@every_arm
def test_inertias_are_those_of_bodies(arm: str) -> None:
    plant = load_arm(arm).plant
    bodies = [plant.get_body(index) for index in plant.GetBodyIndices(plant.GetModelInstanceByName(Path(arm).stem))]
    heavy = [body.default_spatial_inertia() for body in bodies if body.default_mass() > 0]
    assert len(heavy) >= 7
    for inertia in heavy:
        assert inertia.IsPhysicallyValid()
        assert _is_physical(inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3())


@every_arm
@given(share=st.lists(st.floats(0, 1), min_size=9, max_size=9), seed=st.integers(0, 2**16))
def test_mass_matrix_is_positive_and_gravity_has_a_potential(arm: str, share: list[float], seed: int) -> None:
    robot = load_arm(arm)
    plant, n = robot.plant, robot.plant.num_positions()
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    q = lower + np.array(share[:n]) * (upper - lower)
    plant.SetPositions(robot.context, q)
    M = plant.CalcMassMatrix(robot.context)
    np.testing.assert_allclose(M, M.T, atol=1e-12)
    assert np.linalg.eigvalsh(M)[0] > 0
    torque = robot.gravity_torque()
    direction = np.random.default_rng(seed).normal(size=n)
    energies = []
    for step in (-1e-5, 1e-5):
        plant.SetPositions(robot.context, q + step * direction)
        energies.append(plant.CalcPotentialEnergy(robot.context))
    np.testing.assert_allclose((energies[1] - energies[0]) / 2e-5, torque @ direction, atol=1e-4)
