"""`twin-diagram init`: a first scenario for arms that do not come along, which runs as it is."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from twin_diagram import cli
from twin_diagram.errors import TwinError
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.runs.first_scenario import look_at, write_first_scenario
from twin_diagram.scenario import Fixture, load_scenario
from twin_diagram.scenario.poses import pose
from twin_diagram.twin import make_closed_loop

PLACEHOLDER = """<robot name="two"><link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="1"/>
<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0 0 0.2"/><mass value="1"/>
<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="tip"/>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3"/>
<axis xyz="0 1 0"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.4"/>
<axis xyz="0 1 0"/></joint>
<joint name="tip_weld" type="fixed"><parent link="fore"/><child link="tip"/><origin xyz="0 0 0.3"/></joint></robot>"""
"""URDF, no limits, no shapes, inertia as a CAD export leaves it."""

SCARA = """<sdf version="1.9"><model name="scara"><link name="base"><inertial><mass>5</mass></inertial></link>
<link name="first"><pose>0 0 0.4 0 0 0</pose><inertial><pose>0.15 0 0 0 0 0</pose><mass>3</mass>
<inertia><ixx>0.02</ixx><iyy>0.03</iyy><izz>0.03</izz></inertia></inertial>
<collision name="c"><pose>0.15 0 0 0 0 0</pose><geometry><box><size>0.35 0.1 0.1</size></box></geometry>
</collision></link>
<link name="second"><pose>0.3 0 0.4 0 0 0</pose><inertial><pose>0.12 0 0 0 0 0</pose><mass>2</mass>
<inertia><ixx>0.01</ixx><iyy>0.02</iyy><izz>0.02</izz></inertia></inertial>
<collision name="c"><pose>0.12 0 0 0 0 0</pose><geometry><box><size>0.28 0.09 0.09</size></box></geometry>
</collision></link>
<link name="quill"><pose>0.55 0 0.4 0 0 0</pose><inertial><mass>0.8</mass>
<inertia><ixx>0.004</ixx><iyy>0.004</iyy><izz>0.001</izz></inertia></inertial>
<collision name="c"><geometry><cylinder><radius>0.02</radius><length>0.3</length></cylinder></geometry>
</collision></link>
<joint name="j1" type="revolute"><parent>base</parent><child>first</child>
<axis><xyz>0 0 1</xyz><limit><lower>-2.4</lower><upper>2.4</upper><effort>60</effort></limit></axis></joint>
<joint name="j2" type="revolute"><parent>first</parent><child>second</child>
<axis><xyz>0 0 1</xyz><limit><lower>-2.6</lower><upper>2.6</upper><effort>30</effort></limit></axis></joint>
<joint name="lift" type="prismatic"><parent>second</parent><child>quill</child>
<axis><xyz>0 0 1</xyz><limit><lower>-0.1</lower><upper>0.15</upper><effort>80</effort></limit></axis></joint>
</model></sdf>"""
"""SDF, with a prismatic joint whose rest lies well above the table."""

MJCF = """<mujoco model="three"><worldbody><body name="turret" pos="0 0 0.1"><inertial pos="0 0 0.05" mass="3"
diaginertia="0.02 0.02 0.01"/><joint name="yaw" axis="0 0 1" range="-170 170"/>
<geom type="cylinder" size="0.06 0.08"/><body name="arm" pos="0 0 0.15"><inertial pos="0 0 0.2" mass="2"
diaginertia="0.03 0.03 0.003"/><joint name="pitch" axis="0 1 0" range="20 100"/>
<geom type="capsule" fromto="0 0 0.1 0 0 0.35" size="0.04"/><body name="wrist" pos="0 0 0.45"><inertial pos="0 0 0.05"
mass="0.5" diaginertia="0.001 0.001 0.0005"/><joint name="roll" axis="0 0 1"/>
<geom type="sphere" size="0.04"/></body></body></body></worldbody></mujoco>"""
"""MJCF, in degrees, one joint whose range leaves out zero."""

DATA = {
    "kr300": "kuka_kr300/kr300.urdf",
    "lwr4": "real_arms/lwr4/lwr4_as_published.urdf",
    "panda": "drake_models/franka_description/urdf/panda_arm_hand.urdf",
    "iiwa": "drake_models/iiwa_description/sdf/iiwa7_with_box_collision.sdf",
}


def brought(name: str, folder: Path, request: pytest.FixtureRequest) -> tuple[Path, dict[str, str | Path]]:
    if name in DATA:
        data = request.getfixturevalue("data_dir")
        return data / DATA[name], {"drake_models": data / "drake_models"}
    text, suffix = {"two": (PLACEHOLDER, "urdf"), "scara": (SCARA, "sdf"), "three": (MJCF, "xml")}[name]
    path = folder / f"{name}.{suffix}"
    path.write_text(text)
    return path, {}


@pytest.mark.parametrize("name", ["two", "scara", "three", *DATA])
def test_what_is_written_runs_as_it_is(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    arm, packages = brought(name, tmp_path, request)
    out = tmp_path / "first.yaml"
    found = write_first_scenario(arm, out, packages)
    plan = load_scenario(out)
    assert plan.twin.arm.tool_frame in found.frames and len(plan.twin.home) == len(found.joints)
    home = np.array(plan.twin.home)
    assert np.all(home > found.lower) and np.all(home < found.upper)
    assert (plan.twin.fixtures == [Fixture()]) == found.stands
    assert plan.twin.camera is not None
    plan = load_scenario(out, ["twin.camera=null"])
    loop = make_closed_loop(plan)
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(0.05)
    twin = loop.twin.diagram
    state = np.array(twin.GetOutputPort("arm_state").Eval(twin.GetMyContextFromRoot(simulator.get_context())))
    assert state[: len(home)] == pytest.approx(home, abs=0.02)
    text = out.read_text()
    assert all(f"#   {joint}: " in text for joint in found.joints)


def test_links_that_are_drawn_without_a_collision_shape_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A rail that was drawn alone stood in the twin's scene as an unknown thing."""
    drawn = '<link name="base"><visual><geometry><box size="2 0.1 0.1"/></geometry></visual></link>'
    (tmp_path / "two.urdf").write_text(PLACEHOLDER.replace('<link name="base"/>', drawn))
    assert look_at(tmp_path / "two.urdf").drawn_only == ("base",)
    assert cli.main(["init", "--arm", str(tmp_path / "two.urdf"), "--out", str(tmp_path / "two.yaml")]) == 0
    assert capsys.readouterr().err.startswith("note: base: drawn, but without a collision shape")
    (tmp_path / "scara.sdf").write_text(SCARA)
    assert look_at(tmp_path / "scara.sdf").drawn_only == ()


def test_the_camera_sees_the_table(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    out = tmp_path / "first.yaml"
    arm, packages = brought("scara", tmp_path, request)
    write_first_scenario(arm, out, packages)
    camera = load_scenario(out).twin.camera
    assert camera is not None
    x, y = np.meshgrid(np.linspace(0.1, 0.8, 15), np.linspace(-0.35, 0.35, 15))
    p_W = np.stack([x, y, 0.0 * x], axis=-1).reshape(-1, 3)
    p_C = pose(camera.X_WC).inverse().multiply(p_W.T).T
    pinhole = Pinhole.from_scenario(camera)
    u = pinhole.focal * p_C[:, 0] / p_C[:, 2] + 0.5 * camera.width
    v = pinhole.focal * p_C[:, 1] / p_C[:, 2] + 0.5 * camera.height
    seen = (p_C[:, 2] > 0.0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    assert seen.mean() > 0.95


def test_home_is_clear_of_the_table_where_it_can_be(tmp_path: Path) -> None:
    lying = tmp_path / "lying.urdf"
    lying.write_text(PLACEHOLDER.replace('xyz="0 0 0.3"/>\n<axis', 'xyz="0 0 0.3" rpy="0 2.5 0"/>\n<axis'))
    found = look_at(lying)
    assert found.stands and np.abs(found.home).max() > 0.1  # at zero its arm hangs through the table
    upright = tmp_path / "upright.urdf"
    upright.write_text(PLACEHOLDER)
    np.testing.assert_array_equal(look_at(upright).home, np.zeros(2))
    assert found.frames == ("fore", "tip")


@pytest.mark.parametrize(
    ("name", "first"),
    [("tool0", "tool0"), ("hand_tcp", "hand_tcp"), ("EE", "EE"), ("link_eef", "link_eef"), ("steel", "fore")],
)
def test_the_tool_is_told_by_its_name(tmp_path: Path, name: str, first: str) -> None:
    path = tmp_path / "named.urdf"
    path.write_text(PLACEHOLDER.replace('"tip"', f'"{name}"'))
    assert look_at(path).frames[0] == first


def test_nothing_that_exists_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "two.urdf").write_text(PLACEHOLDER)
    out = tmp_path / "mine.yaml"
    out.write_text("mine")
    command = ["init", "--arm", str(tmp_path / "two.urdf"), "--out"]
    assert cli.main([*command, str(out)]) == 2
    assert "exists already" in capsys.readouterr().err and out.read_text() == "mine"
    assert cli.main([*command, str(tmp_path / "new.yaml")]) == 0
    assert "2 joints (shoulder, elbow), tool frame fore" in capsys.readouterr().out


def test_how_it_is_run_is_told_as_a_shell_reads_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "two.urdf").write_text(PLACEHOLDER)
    out = str(tmp_path / "my arm's.yaml")
    assert cli.main(["init", "--arm", str(tmp_path / "two.urdf"), "--out", out]) == 0
    told = capsys.readouterr().out.splitlines()[-1].removeprefix("run it: ")
    assert shlex.split(told) == ["twin-diagram", "run", out, "--out", "out/first"]


@pytest.mark.parametrize(
    ("arm", "out", "said"),
    [
        ("none.urdf", "a.yaml", "none.urdf: no such file"),
        ("two.urdf", "a.txt", "is a .yaml file"),
        ("two.urdf", "b/a.yaml", "no folder"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_written(arm: str, out: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "two.urdf").write_text(PLACEHOLDER)
    with pytest.raises(TwinError, match=said):
        write_first_scenario(tmp_path / arm, tmp_path / out)
    assert [path.name for path in tmp_path.iterdir()] == ["two.urdf"]


def test_of_a_robot_with_two_arms_the_joints_to_name_are_told_before_its_meshes_are_read(tmp_path: Path) -> None:
    inertial = '<inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
    mesh = '<visual><geometry><mesh filename="nowhere.stl"/></geometry></visual>'
    text = f'<robot name="two"><link name="base">{mesh}</link>'
    for name, parent in (("waist", "base"), ("l0", "waist"), ("r0", "waist"), ("r1", "r0"), ("r2", "r1"), ("l1", "l0")):
        text += f'<link name="{name}">{inertial}</link><joint name="{name}_j" type="revolute"><parent link="{parent}"/>'
        text += f'<child link="{name}"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="2"/>'
        text += "</joint>"
    (tmp_path / "two.urdf").write_text(f"{text}</robot>")
    with pytest.raises(TwinError, match=r"\(--joints r0_j r1_j r2_j; .*; others are l0_j to l1_j$"):
        look_at(tmp_path / "two.urdf")
    with pytest.raises(TwinError, match=r"nowhere\.stl"):
        look_at(tmp_path / "two.urdf", joints=["r0_j", "r1_j", "r2_j"])


def test_joints_that_the_description_leaves_without_a_motor_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    inertial = '<inertial><origin xyz="0 0 0.2"/><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" '
    inertial += 'ixy="0" ixz="0" iyz="0"/></inertial>'
    text = '<robot name="it"><link name="base"/>'
    for name, parent, child in (("shoulder", "base", "upper"), ("elbow", "upper", "lower")):
        text += f'<link name="{child}">{inertial}</link><joint name="{name}" type="revolute"><parent link="{parent}"/>'
        text += f'<child link="{child}"/><origin xyz="0 0 0.4"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" '
        text += 'effort="50" velocity="2"/></joint>'
    motor = '<transmission name="t"><type>SimpleTransmission</type><joint name="shoulder"/><actuator name="m"/>'
    for name, driven in (("one.urdf", motor + "</transmission>"), ("all.urdf", "")):
        (tmp_path / name).write_text(f"{text}{driven}</robot>")
        assert cli.main(["init", "--arm", str(tmp_path / name), "--out", str(tmp_path / f"{name}.yaml")]) == 0
        said = capsys.readouterr().err
        assert ("elbow: without a motor" in said and "twin.arm.joints" in said) == (name == "one.urdf")


def test_fingers_that_are_always_close_to_the_wrist_leave_the_arm_its_table(tmp_path: Path) -> None:
    """To the planner 1 cm lies between them however the wrist turns: no pose passed for clear of the table."""
    inertial = (
        '<inertial><mass value="1"/><inertia ixx="1e-2" iyy="1e-2" izz="1e-2" ixy="0" ixz="0" iyz="0"/></inertial>'
    )

    def shaped(name: str, shape: str, z: float) -> str:
        origin = f'<origin xyz="0 0 {z}"/>'
        return f'<link name="{name}">{inertial}<collision>{origin}<geometry>{shape}</geometry></collision></link>'

    wrist, finger = '<cylinder radius="0.035" length="0.08"/>', '<box size="0.022 0.016 0.09"/>'
    links = '<link name="base"/>' + shaped("wrist", wrist, 0.04) + f'<link name="hand">{inertial}</link>'
    links += shaped("left", finger, 0.045) + shaped("right", finger, 0.045)
    joints = ""
    for name, kind, above, below, place, axis, low, high in (
        ("lift", "revolute", "base", "wrist", "0 0 0.5", "0 1 0", -2, 2),
        ("turn", "revolute", "wrist", "hand", "0 0 0.09", "0 0 1", -2, 2),
        ("one", "prismatic", "hand", "left", "0 0.008 0.03", "0 1 0", 0, 0.05),
        ("other", "prismatic", "hand", "right", "0 -0.008 0.03", "0 -1 0", 0, 0.05),
    ):
        joints += f'<joint name="{name}" type="{kind}"><parent link="{above}"/><child link="{below}"/>'
        joints += f'<origin xyz="{place}"/><axis xyz="{axis}"/>'
        joints += f'<limit lower="{low}" upper="{high}" velocity="2" effort="50"/></joint>'
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm">{links}{joints}</robot>')
    assert look_at(tmp_path / "arm.urdf").stands
