"""The model: loading, dynamics against MuJoCo and Drake, saving, hostile descriptions."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram import scenario
from twin_diagram.errors import ArgumentError, LogError, ModelError
from twin_diagram.logs import Log, check
from twin_diagram.model.description import add_arm as description
from twin_diagram.model.description import unparsed
from twin_diagram.model.effects import make, realisation, spec_of
from twin_diagram.model.effects.parameter_vector import with_values
from twin_diagram.model.model import Model
from twin_diagram.scenario import ArmModel, EffectSpec, Pose
from twin_diagram.scenario.resources import models_dir

mujoco = pytest.importorskip("mujoco")

PANDA = ArmModel(model="arms/panda_hand.urdf")
JOINTS = tuple(f"panda_joint{i + 1}" for i in range(7))
ROTORS = EffectSpec("reflected_inertia", list(JOINTS), [], {"inertia": [0.6, 0.6, 0.46, 0.46, 0.2, 0.2, 0.2]})
LOAD = EffectSpec("payload", [], [], {"mass": [1.3], "com": [0.02, -0.03, 0.12]})
DAMPERS = EffectSpec("viscous_friction", list(JOINTS[:3]), [], {"damping": [3.0, 2.0, 1.0]})


def motion(seed: int, count: int, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q, v, a = np.random.default_rng(seed).normal(size=(3, count, n))
    return q, v, a


class Mujoco:
    """The same description in another engine, without contacts, limits or its own friction."""

    def __init__(self, path: Path, joints: tuple[str, ...]) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(path))
        flags = mujoco.mjtDisableBit
        self.model.opt.disableflags |= flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT | flags.mjDSBL_FRICTIONLOSS
        self.model.opt.disableflags |= flags.mjDSBL_EQUALITY
        self.data = mujoco.MjData(self.model)
        ids = [mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_JOINT, joint) for joint in joints]
        self.q = self.model.jnt_qposadr[ids]
        self.v = self.model.jnt_dofadr[ids]

    def inverse_dynamics(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        result = np.empty_like(q)
        for k in range(len(q)):
            self.data.qpos[self.q], self.data.qvel[self.v], self.data.qacc[self.v] = q[k], v[k], a[k]
            mujoco.mj_inverse(self.model, self.data)
            result[k] = self.data.qfrc_inverse[self.v]
        return result

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        self.data.qpos[self.q] = q
        mujoco.mj_forward(self.model, self.data)
        full = np.zeros((self.model.nv, self.model.nv))
        try:
            mujoco.mj_fullM(self.model, full, self.data.qM)
        except (TypeError, AttributeError):  # newer MuJoCo takes the data itself
            mujoco.mj_fullM(self.model, self.data, full)
        return full[np.ix_(self.v, self.v)]


def test_dynamics_agree_with_mujoco_including_rotors() -> None:
    path = models_dir() / "arms" / "panda_hand.urdf"
    other = Mujoco(path, JOINTS)
    model = Model.load(dataclasses.replace(PANDA, effects=[ROTORS, DAMPERS]))
    other.model.dof_armature[other.v] += ROTORS.parameters["inertia"]
    other.model.dof_damping[other.v[:3]] += DAMPERS.parameters["damping"]
    q, v, a = motion(0, 60, 7)
    np.testing.assert_allclose(model.inverse_dynamics(q, v, a), other.inverse_dynamics(q, v, a), atol=2e-6)
    np.testing.assert_allclose(model.mass_matrix(q[0]), other.mass_matrix(q[0]), atol=1e-6)


def test_measured_arm_agrees_with_mujoco(data_dir: Path) -> None:
    path = data_dir / "kuka_kr300" / "kr300.urdf"
    joints = tuple(f"joint_{i + 1}" for i in range(6))
    model, other = Model.load(path), Mujoco(path, joints)
    assert model.joints == joints
    q, v, a = motion(1, 60, 6)
    expected = other.inverse_dynamics(q, v, a)
    np.testing.assert_allclose(model.inverse_dynamics(q, v, a), expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("effects", [[], [ROTORS, LOAD, DAMPERS]])
def test_many_samples_are_as_one(effects: list[EffectSpec]) -> None:
    """The vectorised tree and the plant are two implementations of the same dynamics."""
    model = Model.load(dataclasses.replace(PANDA, effects=effects))
    q, v, a = motion(2, 100, 7)
    many = model.inverse_dynamics(q, v, a)
    once = np.array([model.inverse_dynamics(*sample) for sample in zip(q, v, a, strict=True)])
    np.testing.assert_allclose(many, once, atol=1e-11)
    np.testing.assert_allclose(model.inverse_dynamics(q[:5], v[:5], a[:5]), many[:5], atol=1e-11)
    np.testing.assert_allclose(model.tree.mass_matrix(q), [model.mass_matrix(x) for x in q], atol=1e-12)
    back = model.forward_dynamics(q, v, many)
    np.testing.assert_allclose(back, a, atol=1e-8)
    np.testing.assert_allclose(model.forward_dynamics(q[3], v[3], many[3]), a[3], atol=1e-8)
    assert model.inverse_dynamics(q.reshape(4, 25, 7), v.reshape(4, 25, 7), a.reshape(4, 25, 7)).shape == (4, 25, 7)
    assert model.inverse_dynamics(q[:0], v[:0], a[:0]).shape == (0, 7)


def test_torque_is_linear_in_inertial_parameters() -> None:
    model = Model.load(PANDA)
    q, v, a = motion(3, 30, 7)
    tree = model.tree
    total = sum(tree.regressor(q, v, a, body) @ tree.inertia[body] for body in range(7))
    total = total + tree.rotor * a + tree.damping * v
    np.testing.assert_allclose(total, model.inverse_dynamics(q, v, a), atol=1e-10)


def test_payload_equals_a_welded_body() -> None:
    model = Model.load(dataclasses.replace(PANDA, effects=[LOAD]))
    plant = MultibodyPlant(0.0)
    arm = description.add_arm(plant, model.spec)
    realisation(model.effects[0]).before_finalize(plant, arm)
    plant.Finalize()
    q, v, a = motion(4, 20, 7)
    welded = Model(plant, arm, [])
    np.testing.assert_allclose(model.inverse_dynamics(q, v, a), welded.inverse_dynamics(q, v, a), atol=1e-11)
    np.testing.assert_allclose(model.mass_matrix(q[0]), welded.mass_matrix(q[0]), atol=1e-12)


@settings(max_examples=25)
@given(st.lists(st.floats(-3.0, 3.0), min_size=7, max_size=7))
def test_properties_of_the_mass_matrix(q: list[float]) -> None:
    mass = MODEL.mass_matrix(np.array(q))
    np.testing.assert_allclose(mass, mass.T, atol=1e-12)
    assert np.linalg.eigvalsh(mass)[0] > 0.0
    zero = np.zeros(7)
    unit = np.array([MODEL.inverse_dynamics(np.array(q), zero, e) for e in np.eye(7)])
    np.testing.assert_allclose(unit - MODEL.bias(np.array(q), zero), mass, atol=1e-10)


def test_tool_jacobian_is_the_derivative_of_its_pose() -> None:
    model = Model.load(dataclasses.replace(PANDA, X_WB=Pose([0.1, -0.2, 0.3], [0.2, 0.1, 0.5])))
    q, v, _ = motion(5, 1, 7)
    h = 1e-6
    before, after = model.tool_pose(q[0] - h * v[0]), model.tool_pose(q[0] + h * v[0])
    V = model.tool_jacobian(q[0]) @ v[0]
    np.testing.assert_allclose((after.translation() - before.translation()) / (2 * h), V[3:], atol=1e-8)
    turn = after.rotation().multiply(before.rotation().inverse()).ToAngleAxis()
    np.testing.assert_allclose(turn.axis() * turn.angle() / (2 * h), V[:3], atol=1e-7)


def test_base_pose_and_limits() -> None:
    tilted = Model.load(dataclasses.replace(PANDA, X_WB=Pose([0.0, 0.0, 0.5], [0.0, 0.0, np.pi / 2])))
    p = tilted.tool_pose(np.zeros(7)).translation()
    plain = Model.load(PANDA).tool_pose(np.zeros(7)).translation()
    np.testing.assert_allclose(p, [-plain[1], plain[0], plain[2] + 0.5], atol=1e-12)
    np.testing.assert_allclose(tilted.effort_limit, [87, 87, 87, 87, 12, 12, 12])
    assert np.all(tilted.lower < tilted.upper)
    assert np.all(tilted.velocity_limit > 2.0)
    assert tilted.last_link == "panda_link7"
    assert tilted.arm.gripper_joints == ("panda_finger_joint1", "panda_finger_joint2")


CHAIN = """<robot name="chain">
  {root}
  <link name="base"/>
  <link name="slider">{inertial}</link>
  <link name="upper">{inertial}</link>
  <link name="lower">{inertial}
    <visual><geometry><mesh filename="package://nowhere/missing.obj"/></geometry></visual>
    <collision><geometry><mesh filename="also_missing.stl"/></geometry></collision></link>
  <link name="empty"/>
  <joint name="rail" type="prismatic"><parent link="base"/><child link="slider"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="300" velocity="1"/></joint>
  <joint name="shoulder" type="revolute"><parent link="slider"/><child link="upper"/><origin xyz="0 0 0.2"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="50" velocity="3"/><dynamics damping="0.7"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0.3 0 0" rpy="0.3 0 0"/>
    <axis xyz="0 0.6 0.8"/></joint>
  <joint name="tip" type="fixed"><parent link="lower"/><child link="empty"/><origin xyz="0.3 0 0"/></joint>
</robot>"""
INERTIAL = (
    '<inertial><origin xyz="0.1 0.02 0"/><mass value="2"/>'
    '<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0.001" ixz="0" iyz="0"/></inertial>'
)


def chain(folder: Path, root: str = "") -> Path:
    path = folder / "chain.urdf"
    path.write_text(CHAIN.format(root=root, inertial=INERTIAL))
    return path


def test_description_without_motors_or_meshes(tmp_path: Path) -> None:
    """Most public URDFs have no transmissions, and meshes that are not at hand."""
    model = Model.load(chain(tmp_path))
    assert model.joints == ("rail", "shoulder", "elbow")  # a rail that carries an arm is no finger
    assert not model.arm.gripper_joints
    np.testing.assert_allclose(model.effort_limit[1:], [50.0, np.inf])
    named = Model.load(ArmModel(model=str(chain(tmp_path)), joints=["elbow", "rail", "shoulder"], tool_frame="empty"))
    assert named.joints == ("elbow", "rail", "shoulder")
    q, v, a = motion(6, 40, 3)
    once = np.array([named.inverse_dynamics(*sample) for sample in zip(q, v, a, strict=True)])
    np.testing.assert_allclose(named.inverse_dynamics(q, v, a), once, atol=1e-12)
    np.testing.assert_allclose(named.forward_dynamics(q, v, once), a, atol=1e-10)
    other = Mujoco(_without_geometry(chain(tmp_path)), named.joints)
    np.testing.assert_allclose(once, other.inverse_dynamics(q, v, a), atol=1e-9)


def test_a_rail_may_be_left_out(tmp_path: Path) -> None:
    """Then it is held where it is, and a log need not tell of it."""
    path = chain(tmp_path)
    held = Model.load(ArmModel(model=str(path), joints=["shoulder", "elbow"], tool_frame=""))
    assert held.arm.gripper_joints == ()
    assert held.plant.num_positions() == 2
    time = np.arange(400) * 0.01
    q = 0.3 * np.stack([np.sin(3.0 * time), np.cos(2.0 * time)], axis=1)
    log = Log(time, held.joints, q, torque=q)
    assert not [warning for warning in check(log, held.limits) if "rail" in warning.message]
    with pytest.raises(LogError, match=r"'rail' of the model is missing.*name those of the arm with --joints"):
        check(log, Model.load(path).limits)


def _without_geometry(path: Path) -> Path:
    text = path.read_text()
    start, end = text.index("<visual>"), text.index("</collision>") + len("</collision>")
    plain = path.with_name("plain.urdf")
    plain.write_text(text[:start] + text[end:])
    return plain


MJCF = """<mujoco model="arm"><option gravity="0 0 -9.81"/><worldbody>
  <body name="upper" pos="0 0 0.3"><joint name="shoulder" axis="0 1 0" damping="0.5" armature="0.1"/>
    <inertial pos="0.1 0 0" mass="2" diaginertia="0.01 0.02 0.02"/>
    <body name="lower" pos="0.3 0 0"><joint name="elbow" axis="0 1 0"/>
      <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.02 0.02"/></body></body>
</worldbody><actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator></mujoco>"""

SDF = """<sdf version="1.9"><model name="arm">
  <link name="base"><inertial><mass>1</mass></inertial></link>
  <link name="upper"><pose relative_to="turn"/><inertial><pose>0.1 0 0 0 0 0</pose><mass>2</mass></inertial></link>
  <joint name="turn" type="revolute"><parent>base</parent><child>upper</child>
    <pose relative_to="base">0 0 1 0 0 0</pose>
    <axis><xyz>0 1 0</xyz><limit><effort>9</effort></limit></axis></joint></model></sdf>"""


def test_mjcf_and_sdf(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(MJCF)
    model, other = Model.load(tmp_path / "arm.xml"), Mujoco(tmp_path / "arm.xml", ("shoulder", "elbow"))
    q, v, a = motion(7, 40, 2)
    expected = other.inverse_dynamics(q, v, a)
    np.testing.assert_allclose(model.inverse_dynamics(q, v, a), expected, atol=1e-9)
    np.testing.assert_allclose(model.inverse_dynamics(q[0], v[0], a[0]), expected[0], atol=1e-9)

    (tmp_path / "arm.sdf").write_text(SDF)
    model = Model.load(tmp_path / "arm.sdf")
    assert model.joints == ("turn",)
    np.testing.assert_allclose(model.bias(np.zeros(1), np.zeros(1)), [-2 * 9.81 * 0.1], atol=1e-9)
    np.testing.assert_allclose(model.effort_limit, [9.0])


def test_friction_that_the_description_states(tmp_path: Path) -> None:
    """Drake leaves it unread; it is the model's own all the same, in all three formats, and is not written twice."""
    mjcf = """<mujoco model="arm"><default><joint frictionloss="0.2"/>
      <default class="stiff"><joint stiffness="3" springref="30"/></default></default><worldbody>
      <body name="upper"><joint name="shoulder" axis="0 1 0" class="stiff"/>
        <inertial pos="0.1 0 0" mass="2" diaginertia="0.01 0.02 0.02"/>
        <body name="lower" pos="0.3 0 0"><joint name="elbow" axis="0 1 0" frictionloss="0.7"/>
          <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.02 0.02"/></body></body></worldbody></mujoco>"""
    (tmp_path / "arm.xml").write_text(mjcf)
    model, other = Model.load(tmp_path / "arm.xml"), Mujoco(tmp_path / "arm.xml", ("shoulder", "elbow"))
    friction = EffectSpec("coulomb_friction", ["shoulder", "elbow"], [], {"torque": [0.2, 0.7]})
    assert spec_of(model.effects[0]) == friction
    q, v, a = motion(10, 40, 2)
    v += np.sign(v)
    expected = other.inverse_dynamics(q, v, a) + np.sign(v) * [0.2, 0.7]  # the other engine leaves friction out here
    np.testing.assert_allclose(model.inverse_dynamics(q, v, a), expected, atol=1e-9)
    assert model.spec.effects == []
    model.save(tmp_path / "saved")
    again = Model.load(tmp_path / "saved")
    assert [spec_of(effect) for effect in again.effects] == [spec_of(effect) for effect in model.effects]
    assert spec_of(model.with_effects([]).effects[0]) == friction
    assert len(model.with_effects(model.effects).effects) == 2

    text = chain(tmp_path).read_text().replace('damping="0.7"', 'damping="0.7" friction="1.5"')
    (tmp_path / "chain.urdf").write_text(text)
    (stated,) = Model.load(tmp_path / "chain.urdf").effects
    assert spec_of(stated) == EffectSpec("coulomb_friction", ["shoulder"], [], {"torque": [1.5]})
    assert stated.given
    (tmp_path / "arm.sdf").write_text(SDF.replace("</xyz>", "</xyz><dynamics><friction>2.5</friction></dynamics>"))
    (stated,) = Model.load(tmp_path / "arm.sdf").effects
    assert spec_of(stated) == EffectSpec("coulomb_friction", ["turn"], [], {"torque": [2.5]})
    undeclared = text.replace('effort="50"', 'effort="50" drake:acceleration="15.0"')
    (tmp_path / "chain.urdf").write_text(
        undeclared.replace('<link name="empty"/>', '<link name="empty"/><drake:note a="b:c"/>')
    )
    assert spec_of(Model.load(tmp_path / "chain.urdf").effects[0]) == EffectSpec(
        "coulomb_friction", ["shoulder"], [], {"torque": [1.5]}
    )
    (tmp_path / "chain.urdf").write_text(text.replace('friction="1.5"', 'friction="much"'))
    with pytest.raises(ModelError, match=r"chain\.urdf"):
        Model.load(tmp_path / "chain.urdf")


def test_effects_may_be_given_as_they_are_specified_one_or_several() -> None:
    model, spec = Model.load(PANDA), LOAD
    expected = model.with_effects([make(spec)]).effects
    for some in (spec, [spec], make(spec)):
        assert [spec_of(one) for one in model.with_effects(some).effects] == [spec_of(one) for one in expected]


@pytest.mark.parametrize("actuators", [["motor"], ["general"], ["velocity"], [], ["motor", "motor"]])
def test_rotors_that_an_mjcf_states(tmp_path: Path, actuators: list[str]) -> None:
    """Drake keeps them where it makes the motor itself; most published arms have actuators that it does not know.

    Two motors on a joint move one rotor.
    """
    each = ((f"{kind}_{joint}_{k}", kind, joint) for k, kind in enumerate(actuators) for joint in ("shoulder", "elbow"))
    motors = "".join(f'<{kind} name="{name}" joint="{joint}"/>' for name, kind, joint in each)
    mjcf = f"""<mujoco model="arm"><default><joint armature="0.3"/></default><worldbody>
      <body name="upper"><joint name="shoulder" axis="0 1 0"/>
        <inertial pos="0.1 0 0" mass="2" diaginertia="0.01 0.02 0.02"/>
        <body name="lower" pos="0.3 0 0"><joint name="elbow" axis="0 1 0" armature="0.7"/>
          <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.02 0.02"/></body></body></worldbody>
      <actuator>{motors}</actuator></mujoco>"""
    (tmp_path / "arm.xml").write_text(mjcf)
    model, other = Model.load(tmp_path / "arm.xml"), Mujoco(tmp_path / "arm.xml", ("shoulder", "elbow"))
    q, v, a = motion(10, 40, 2)
    np.testing.assert_allclose(model.inverse_dynamics(q, v, a), other.inverse_dynamics(q, v, a), atol=1e-9)


SEVERAL = """<mujoco model="arm"><compiler angle="radian"/>
  <default><default class="stiff"><joint damping="0.7" frictionloss="0.4"/></default></default><worldbody>
  <frame pos="0.1 0 0.2" euler="0.1 0.2 0"><body name="car" pos="0 0 1" euler="0.3 0 0.2" childclass="stiff">
    <joint name="rail" type="slide" axis="1 0 0"/><joint name="mast" axis="0 0 1" pos="0.1 0 0"/>
    <joint name="shoulder" axis="0 1 0" damping="0.1"/><geom size="0.1" mass="2" pos="0.1 0 0.2"/>
    <frame name="side" pos="0 0.2 0" euler="0 0 1"><geom type="box" size="0.1 0.05 0.02" mass="0.5"/>
      <frame euler="0.4 0 0"><body name="lower" pos="0.3 0 0"><joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" size="0.05" fromto="0 0 0 0.2 0.1 0" mass="1"/></body></frame></frame>
  </body></frame></worldbody></mujoco>"""


@pytest.mark.parametrize("included", [False, True])
def test_bodies_of_several_joints_and_frames_of_an_mjcf(tmp_path: Path, included: bool) -> None:
    """Drake puts the last joint where the body stands, and passes over frames."""
    whole, joints = SEVERAL, ("rail", "mast", "shoulder", "elbow")
    if included:
        start, end = whole.index("<frame pos"), whole.index("</worldbody>")
        (tmp_path / "rest.xml").write_text(f"<mujocoinclude>{whole[start:end]}</mujocoinclude>")
        whole = whole[:start] + '<include file="rest.xml"/>' + whole[end:]
    (tmp_path / "arm.xml").write_text(whole)
    model, other = Model.load(tmp_path / "arm.xml"), Mujoco(tmp_path / "arm.xml", joints)
    assert model.joints == joints
    assert [effect.joints for effect in model.effects] == [joints]
    q, v, a = motion(10, 40, 4)
    smooth = model.with_effects([]).law.rigid(q, v, a)
    other.model.dof_frictionloss[:] = 0.0
    np.testing.assert_allclose(smooth, other.inverse_dynamics(q, v, a), atol=1e-9)


NESTED = """<mujoco model="arm"><compiler angle="radian"/><default><default class="robot">
  <joint axis="0 1 0" range="-3 3" armature="0.3"/><geom type="capsule" size="0.04 0.1" density="700"/>
  <general forcerange="-150 150"/>
  <default class="large"><general forcerange="-28 28"/><default class="short"><joint range="-1 1"/></default></default>
  <default class="shape"><default class="thick"><geom size="0.06 0.1"/></default></default>
</default></default><worldbody>
  <body name="upper" childclass="robot"><joint name="shoulder" class="large"/><geom class="shape"/>
    <body name="lower" pos="0.3 0 0"><joint name="elbow" class="short"/><geom class="thick" pos="0.1 0 0"/>
  </body></body></worldbody><actuator><general joint="shoulder" class="robot"/>
  <general joint="elbow" class="large" gear="2"/></actuator></mujoco>"""


def test_classes_of_an_mjcf_hold_what_those_around_them_say(tmp_path: Path) -> None:
    """Drake forgets it where a class has no element of its own: a UR5e's shoulder turned about z, without a limit."""
    (tmp_path / "arm.xml").write_text(NESTED)
    model, other = Model.load(tmp_path / "arm.xml"), Mujoco(tmp_path / "arm.xml", ("shoulder", "elbow"))
    np.testing.assert_array_equal(model.upper, [3.0, 1.0])
    np.testing.assert_array_equal(model.effort_limit, [150.0, 56.0])  # Drake passes over `general` motors
    q, v, a = motion(10, 40, 2)
    np.testing.assert_allclose(model.inverse_dynamics(q, v, a), other.inverse_dynamics(q, v, a), atol=1e-9)


def test_what_turns_and_has_no_motor_in_an_mjcf_is_no_joint_of_the_arm(tmp_path: Path) -> None:
    """A 2F-85 on an arm, both as MuJoCo Menagerie has them: knuckles that a tendon moves were taken for the arm's."""
    finger = (
        '<body name="{0}" pos="0 {1} 0.1"><joint name="{0}" axis="1 0 0"/><geom size="0.01" mass="0.01"/>{2}</body>'
    )
    pad = finger.format("pad", 0.01, "")
    (tmp_path / "arm.xml").write_text(
        f"""<mujoco model="arm"><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/>
        <geom size="0.1" mass="1"/>{finger.format("left", 0.02, "")}{finger.format("right", -0.02, pad)}</body>
        </worldbody>
        <tendon><fixed name="split"><joint joint="left" coef="0.5"/><joint joint="right" coef="0.5"/></fixed></tendon>
        <equality><joint joint1="right" joint2="left"/></equality>
        <actuator><general joint="shoulder"/><general tendon="split"/></actuator></mujoco>"""
    )
    model = Model.load(tmp_path / "arm.xml")
    assert model.joints == ("shoulder",) and model.arm.gripper_joints == ()
    (tmp_path / "hand.xml").write_text((tmp_path / "arm.xml").read_text().replace("shoulder", "thumb"))
    told = unparsed.of_all(unparsed.driven, [chain(tmp_path), tmp_path / "hand.xml"])
    assert told == {"thumb": True, "left": False, "right": False, "pad": False}, "of a URDF's joints nothing is said"


@pytest.mark.parametrize(
    ("motors", "limit"),
    [
        ('<motor joint="shoulder" ctrlrange="-20 20" gear="10"/>', 200.0),  # Drake: 20
        ('<motor joint="shoulder" ctrlrange="-20 20" ctrllimited="false"/>', np.inf),  # Drake: 20
        ('<position joint="shoulder" class="strong" kp="100"/>', 80.0),  # Drake: none
        ('<general joint="shoulder" gainprm="5" ctrlrange="-3 2" forcerange="-40 40"/>', 15.0),
        ('<general joint="shoulder" gainprm="5" biastype="affine" ctrlrange="-3 2" forcerange="-40 40"/>', 40.0),
        ('<velocity joint="shoulder" forcerange="0 0"/>', np.inf),
    ],
)
def test_effort_limits_of_an_mjcf(tmp_path: Path, motors: str, limit: float) -> None:
    (tmp_path / "arm.xml").write_text(
        f"""<mujoco model="arm"><default><default class="strong"><general forcerange="-80 80"/></default></default>
        <worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/><geom size="0.1" mass="1"/></body>
        </worldbody><actuator>{motors}</actuator></mujoco>"""
    )
    np.testing.assert_array_equal(Model.load(tmp_path / "arm.xml").effort_limit, [limit])


def test_what_frames_of_an_mjcf_may_not_hold(tmp_path: Path) -> None:
    spoilt = SEVERAL.replace('<geom type="box"', '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom type="box"')
    (tmp_path / "arm.xml").write_text(spoilt)
    with pytest.raises(ModelError, match="'side': a joint or a mass within a frame"):
        Model.load(tmp_path / "arm.xml")
    (tmp_path / "arm.xml").write_text(SEVERAL.replace("<compiler ", '<compiler settotalmass="5" '))
    with pytest.raises(ModelError, match="settotalmass 5"):
        Model.load(tmp_path / "arm.xml")


def test_free_bases_are_welded(tmp_path: Path) -> None:
    free = "<link name='world'/><joint name='free' type='floating'><parent link='world'/><child link='base'/></joint>"
    pose = Pose([0.0, 0.0, 1.0])
    model = Model.load(ArmModel(model=str(chain(tmp_path, free)), X_WB=pose, tool_frame=""))
    assert model.plant.num_velocities() == 3
    mjcf = MJCF.replace('<joint name="shoulder"', '<freejoint/></body><body name="other"><joint name="shoulder"')
    assert "freejoint" in mjcf
    base = '<body name="base"><freejoint/><inertial pos="0 0 0" mass="2" diaginertia="0.01 0.02 0.02"/>'
    mjcf = MJCF.replace("<worldbody>", f"<worldbody>{base}").replace("</worldbody>", "</body></worldbody>")
    (tmp_path / "free.xml").write_text(mjcf)
    model = Model.load(ArmModel(model=str(tmp_path / "free.xml"), X_WB=pose, tool_frame=""))
    assert model.plant.num_velocities() == 2
    np.testing.assert_allclose(model.tool_pose(np.zeros(2)).translation(), [0.3, 0.0, 1.3], atol=1e-12)


def test_mimicking_joints_have_no_motor(tmp_path: Path) -> None:
    text = (
        chain(tmp_path)
        .read_text()
        .replace('<axis xyz="0 0.6 0.8"/>', '<axis xyz="0 0.6 0.8"/><mimic joint="shoulder"/>')
    )
    (tmp_path / "chain.urdf").write_text(text)
    assert Model.load(tmp_path / "chain.urdf").joints == ("rail", "shoulder")


def test_a_joint_that_follows_another_may_not_carry_the_arm(tmp_path: Path) -> None:
    """Held where it is, all behind it would stand elsewhere; named as driven, it is one of the arm's."""
    text = chain(tmp_path).read_text()
    axis = '<axis xyz="0 1 0"/>'
    assert text.count(axis) == 1
    (tmp_path / "chain.urdf").write_text(text.replace(axis, f'{axis}<mimic joint="rail"/>'))
    with pytest.raises(
        ModelError,
        match=r"'shoulder' follows 'rail' and carries 'elbow'.*If these are a gripper's, name the arm's own joints",
    ):
        Model.load(tmp_path / "chain.urdf")
    named = ArmModel(model=str(tmp_path / "chain.urdf"), joints=["rail", "shoulder", "elbow"], tool_frame="")
    assert Model.load(named).joints == ("rail", "shoulder", "elbow")
    alone = dataclasses.replace(named, joints=["elbow"])  # the rail stands still, and so does what follows it
    assert Model.load(alone).joints == ("elbow",)


def test_save_and_load(tmp_path: Path) -> None:
    spec = dataclasses.replace(PANDA, X_WB=Pose([0.1, 0.0, 0.2], [0.0, 0.0, 0.3]), effects=[ROTORS, LOAD, DAMPERS])
    model = Model.load(spec)
    odd = model.with_effects([with_values(model.effects[1], {"mass": [1.0 / 3.0], "com": [1e-17, 0.1, 2.0 / 7.0]})])
    for each, folder in ((model, tmp_path / "corrected"), (odd, tmp_path / "deep" / "corrected")):
        each.save(folder)
        again = Model.load(folder)
        assert again.spec.effects == each.spec.effects, "written without loss"
        q, v, a = motion(8, 30, 7)
        np.testing.assert_array_equal(again.inverse_dynamics(q, v, a), each.inverse_dynamics(q, v, a))
        np.testing.assert_allclose(
            again.tool_pose(q[0]).GetAsMatrix4(), each.tool_pose(q[0]).GetAsMatrix4(), atol=1e-15
        )
        again.save(folder)
        assert Model.load(folder).spec.effects == each.spec.effects, "saved over itself"
        assert sorted(p.name for p in folder.parent.iterdir() if p.name.startswith(".")) == []
    added = Model.load(ArmModel(model=str(tmp_path / "corrected"), tool_frame="", effects=[LOAD]))
    assert [effect.name for effect in added.effects] == [e.name for e in (ROTORS, LOAD, DAMPERS, LOAD)]


def test_saved_description_still_finds_its_meshes(tmp_path: Path) -> None:
    path = chain(tmp_path)
    (tmp_path / "also_missing.stl").write_bytes(b"solid\n")
    Model.load(path).save(tmp_path / "elsewhere" / "saved")
    text = (tmp_path / "elsewhere" / "saved" / "chain.urdf").read_text()
    assert f'filename="{tmp_path / "also_missing.stl"}"' in text
    assert "package://nowhere/missing.obj" in text


def test_saved_mjcf_still_finds_its_folders(tmp_path: Path) -> None:
    """Published arms keep their meshes in one that the compiler element names."""
    corners = [(x, y, z) for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)]
    faces = [
        (1, 3, 4),
        (1, 4, 2),
        (5, 6, 8),
        (5, 8, 7),
        (1, 2, 6),
        (1, 6, 5),
        (3, 7, 8),
        (3, 8, 4),
        (1, 5, 7),
        (1, 7, 3),
    ]
    faces += [(2, 4, 8), (2, 8, 6)]
    lines = ["v {:g} {:g} {:g}".format(*p) for p in corners] + ["f {} {} {}".format(*f) for f in faces]
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "cube.obj").write_text("\n".join(lines) + "\n")
    (tmp_path / "arm.xml").write_text("""<mujoco model="arm"><compiler angle="radian" meshdir="assets"/>
      <asset><mesh name="cube" file="cube.obj"/></asset><worldbody><body name="link">
      <joint name="turn" axis="0 1 0"/><geom type="mesh" mesh="cube" density="1000"/></body></worldbody></mujoco>""")
    model = Model.load(tmp_path / "arm.xml")
    model.save(tmp_path / "elsewhere" / "saved")
    again = Model.load(tmp_path / "elsewhere" / "saved")
    np.testing.assert_allclose(again.mass_matrix(np.zeros(1)), model.mass_matrix(np.zeros(1)))


def test_two_models_of_one_plant_do_not_disturb_each_other() -> None:
    model = Model.load(PANDA)
    loaded = model.with_effects(Model.load(dataclasses.replace(PANDA, effects=[LOAD])).effects)
    q, v, a = motion(9, 30, 7)
    first = model.inverse_dynamics(q[0], v[0], a[0])
    heavy = loaded.inverse_dynamics(q[0], v[0], a[0])
    assert np.max(np.abs(heavy - first)) > 1.0
    loaded.mass_matrix(q[1])
    np.testing.assert_array_equal(model.inverse_dynamics(q[0], v[0], a[0]), first)
    np.testing.assert_array_equal(loaded.inverse_dynamics(q[0], v[0], a[0]), heavy)


def test_third_party_model_without_network(data_dir: Path) -> None:
    name = "package://drake_models/franka_description/urdf/panda_arm_hand.urdf"
    spec = ArmModel(model=name, tool_frame="panda_hand")
    model = Model.load(spec, packages={"drake_models": data_dir / "drake_models"})
    assert model.joints == JOINTS
    np.testing.assert_allclose(model.tree.rotor[:2], 0.605721456, rtol=1e-6)
    with pytest.raises(ModelError, match="no folder is given for package 'drake_models'"):
        Model.load(spec)


def bad(folder: Path, text: str, suffix: str = "urdf") -> Path:
    path = folder / f"bad.{suffix}"
    path.write_text(text)
    return path


def test_bad_descriptions_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="no such file"):
        Model.load(tmp_path / "none.urdf")
    with pytest.raises(ModelError, match=r"effects\.yaml"):
        Model.load(tmp_path)
    with pytest.raises(ModelError, match="cannot be read"):
        Model.load(bad(tmp_path, "<robot name='x'><link"))
    with pytest.raises(ModelError, match="cannot be read"):
        Model.load(bad(tmp_path, "hello", "txt"))
    with pytest.raises(ModelError, match=r"once it is expanded: xacro \w+\.xacro > arm\.urdf"):
        Model.load(bad(tmp_path, "<robot name='x'/>", "xacro"))
    with pytest.raises(ModelError, match="no revolute or prismatic joint"):
        Model.load(bad(tmp_path, "<robot name='x'><link name='a'/></robot>"))
    with pytest.raises(ModelError, match="joints: the model has no joint 'knee'; its joints are rail, shoulder, elbow"):
        Model.load(ArmModel(model=str(chain(tmp_path)), joints=["shoulder", "knee"], tool_frame=""))
    with pytest.raises(ModelError, match="gripper_joints: the model has no joint 'thumb'"):
        Model.load(ArmModel(model=str(chain(tmp_path)), gripper_joints=["thumb"], tool_frame=""))
    with pytest.raises(ModelError, match="tool_frame: the model has no frame 'panda_tcp'; '' takes the last"):
        Model.load(ArmModel(model=str(chain(tmp_path))))
    with pytest.raises(ModelError, match="more than one root link: base, spare; give the arm in a file of its own"):
        Model.load(chain(tmp_path, f"<link name='spare'>{INERTIAL}</link>"))
    anchored = "<link name='world'/><joint name='fix' type='fixed'><parent link='world'/><child link='base'/></joint>"
    Model.load(chain(tmp_path, anchored))
    with pytest.raises(ModelError, match="X_WB"):
        Model.load(ArmModel(model=str(chain(tmp_path, anchored)), X_WB=Pose([1.0, 0.0, 0.0]), tool_frame=""))
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "effects.yaml").write_text("model: gone.urdf\n")
    with pytest.raises(ModelError, match=r"gone\.urdf"):
        Model.load(tmp_path / "folder")
    (tmp_path / "folder" / "effects.yaml").write_text("modle: gone.urdf\n")
    with pytest.raises(ModelError, match="modle"):
        Model.load(tmp_path / "folder")


MODEL = Model.load(scenario.ArmModel(model="arms/panda_hand.urdf"))


def test_a_model_is_built_by_position_or_by_name() -> None:
    given = Model.load("arms/ur5e.urdf")
    for model in (Model(given.plant, given.arm, ()), Model(plant=given.plant, arm=given.arm, effects=())):
        assert model.joints == given.joints
    for wrong in (lambda: Model("arms/ur5e.urdf"), lambda: Model(plant="arms/ur5e.urdf")):  # type: ignore[arg-type,call-arg]
        with pytest.raises(ArgumentError, match=r"Model\.load\(PATH\)"):
            wrong()
