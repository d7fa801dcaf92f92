"""What no arm can have is refused in one line, by name."""

from __future__ import annotations

from pathlib import Path

import pytest

from twin_diagram.errors import ModelError
from twin_diagram.model import Model

URDF = """<robot name="it"><link name="base"/><link name="upper">
<inertial><mass value="{mass}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="{lower}" upper="1" effort="9" velocity="2"/></joint></robot>"""

SDF = """<sdf version="1.7"><model name="it"><link name="base"/><link name="upper"><inertial><mass>{mass}</mass>
<inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia></inertial></link><joint name="shoulder" type="revolute">
<parent>base</parent><child>upper</child><axis><xyz>0 1 0</xyz><limit><lower>{lower}</lower><upper>1</upper></limit>
</axis></joint></model></sdf>"""

MJCF = """<mujoco model="it"><compiler angle="radian"/><worldbody><body name="upper">
<joint name="shoulder" axis="0 1 0" limited="true" range="{lower} 1"/>
<inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/></body></worldbody></mujoco>"""

KINDS = [("it.urdf", URDF), ("it.sdf", SDF), ("it.xml", MJCF)]


@pytest.mark.parametrize(("name", "text"), KINDS)
@pytest.mark.parametrize(
    ("mass", "lower", "words"),
    [
        ("-1", "-1", ["'upper'", "-1 kg"]),
        ("1", "2.5", ["'shoulder'", "2.5", "upper one 1"]),
        # Of decimal commas Drake reads the whole number alone.
        ("1,5", "-1", ["'upper'", "1.5", "write a point"]),
        ("1", "-,7", ["'shoulder'", "-.7", "write a point"]),
    ],
)
def test_masses_and_limits_that_cannot_be(
    tmp_path: Path, name: str, text: str, mass: str, lower: str, words: list[str]
) -> None:
    path = tmp_path / name
    path.write_text(text.format(mass=mass, lower=lower))
    with pytest.raises(ModelError) as refused:
        Model.load(path)
    assert all(word in str(refused.value) for word in [name, *words]), refused.value


@pytest.mark.parametrize(
    ("axis", "words"),
    [("0, 1 0", "xyz is '0, 1 0'; it is three numbers"), ("$(arg axis)", "a xacro, which must be expanded")],
)
def test_what_is_no_vector_is_told_by_the_joint(tmp_path: Path, axis: str, words: str) -> None:
    path = tmp_path / "it.urdf"
    path.write_text(URDF.format(mass="1", lower="-1").replace('xyz="0 1 0"', f'xyz="{axis}"'))
    with pytest.raises(ModelError) as refused:
        Model.load(path)
    assert "joint 'shoulder'" in str(refused.value) and words in str(refused.value)


@pytest.mark.parametrize(("name", "text", "moment"), [("it.urdf", URDF, 'ixx="'), ("it.sdf", SDF, "<ixx>")])
def test_negative_moments_of_inertia(tmp_path: Path, name: str, text: str, moment: str) -> None:
    """Such as programs round zeros to are left alone."""
    path = tmp_path / name
    for value in ("-0.1", "-5e-8"):
        path.write_text(text.format(mass="1", lower="-1").replace(f"{moment}1", f"{moment}{value}"))
        if value == "-5e-8":
            assert Model.load(path).joints == ("shoulder",)
            continue
        with pytest.raises(ModelError, match=r"'upper': a moment of -0\.1 kg"):
            Model.load(path)


def test_negative_moments_of_an_mjcf_are_refused_where_it_is_parsed(tmp_path: Path) -> None:
    path = tmp_path / "it.xml"
    path.write_text(MJCF.format(mass="1", lower="-1").replace('diaginertia="1', 'diaginertia="-1'))
    with pytest.raises(ModelError, match=r"it\.xml"):
        Model.load(path)


def test_what_drake_says_of_mjcf_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "it.xml"
    path.write_text(MJCF.format(mass="1", lower="-1 -1"))
    with pytest.raises(ModelError, match="range"):
        Model.load(path)


@pytest.mark.parametrize(("name", "text"), KINDS)
def test_what_can_be_is_left_alone(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_text(text.format(mass="1", lower="-1"))
    assert Model.load(path).joints == ("shoulder",)


FOUR_BARS = """<sdf version="1.9"><model name="bars">
  {links}
  <joint name="a" type="revolute"><parent>base</parent><child>left</child><axis><xyz>0 1 0</xyz></axis></joint>
  <joint name="b" type="revolute"><parent>{b[0]}</parent><child>{b[1]}</child><axis><xyz>0 1 0</xyz></axis></joint>
  <joint name="c" type="revolute"><parent>{c[0]}</parent><child>{c[1]}</child><axis><xyz>0 1 0</xyz></axis></joint>
  <joint name="d" type="revolute"><parent>{d[0]}</parent><child>{d[1]}</child><axis><xyz>0 1 0</xyz></axis></joint>
</model></sdf>"""


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        ("left-top base-right right-top", "'b' and 'd' both move link 'top'"),
        ("tip-top right-tip top-right", "link 'top' carries itself"),
    ],
)
def test_closed_loops_are_refused(tmp_path: Path, joints: str, said: str) -> None:
    """Whoever walked along them to the base never came to an end."""
    mass = "<inertial><mass>1</mass></inertial>"
    links = "".join(f'<link name="{name}">{mass}</link>' for name in ("base", "left", "right", "top", "tip"))
    path = tmp_path / "bars.sdf"
    ends = dict(zip("bcd", (joint.split("-") for joint in joints.split()), strict=True))
    path.write_text(FOUR_BARS.format(links=links, **ends))
    with pytest.raises(ModelError, match=f"closed loop: .*{said}"):
        Model.load(path)


def test_moments_that_no_body_has_are_told_by_the_body(tmp_path: Path) -> None:
    path = tmp_path / "it.xml"
    path.write_text(MJCF.format(mass="1", lower="-1").replace('"1 1 1"', '".1 .1 .5"'))
    with pytest.raises(ModelError, match=r"it\.xml: body 'upper': moments of inertia 0\.1 0\.1 0\.5 "):
        Model.load(path)
    path.write_text(MJCF.format(mass="1", lower="-1").replace('"1 1 1"', '".1 .1 .2"'))  # a flat plate
    assert Model.load(path).joints == ("shoulder",)
