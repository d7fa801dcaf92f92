"""What a .dmd.yaml names is read as whole as a file that is named itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.errors import ModelError
from twin_diagram.model import Model
from twin_diagram.model.description.add_arm import Arm, add_arm
from twin_diagram.model.description.followers import Followers
from twin_diagram.model.description.named_files import parts_of

MASS = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
LINKS = "".join(f'<link name="{name}">{MASS}</link>' for name in ("base", "upper", "left", "right"))
JOINT = (
    '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><axis xyz="0 1 0"/>'
    '<limit lower="0" upper="1" effort="{4}" velocity="2"/>{5}</joint>'
)
ARM = (
    f'<robot name="arm">{LINKS}'
    + JOINT.format("turn", "revolute", "base", "upper", 9, '<dynamics friction="0.7"/>')
    + JOINT.format("slide", "prismatic", "upper", "left", 5, "")
    + JOINT.format("other", "prismatic", "upper", "right", 5, '<mimic joint="slide" multiplier="-2"/>')
    + "</robot>"
)


def told(folder: Path, text: str = ARM) -> Path:
    """Write an arm, and a .dmd.yaml that names one that names it; return its place."""
    (folder / "arm.urdf").write_text(text)
    (folder / "inner.dmd.yaml").write_text("directives:\n- add_model: {name: arm, file: package://lab/arm.urdf}\n")
    outer = folder / "outer.dmd.yaml"
    outer.write_text("directives:\n- add_directives: {file: package://lab/inner.dmd.yaml}\n")
    return outer


def added(path: Path) -> tuple[MultibodyPlant, Arm]:
    plant = MultibodyPlant(0.0)
    arm = add_arm(plant, path, {"lab": path.parent})
    plant.Finalize()
    return plant, arm


def test_friction_efforts_and_followers_are_those_of_the_file_itself(tmp_path: Path) -> None:
    outer = told(tmp_path)
    (bare, one), (plant, other) = added(tmp_path / "arm.urdf"), added(outer)
    assert one.joints == other.joints == ("turn",)
    assert one.stated == other.stated and other.stated.friction == {"turn": 0.7}
    limits = [
        [p.get_joint_actuator(index).effort_limit() for index in (*a.actuator_indices, *a.gripper_actuator_indices)]
        for p, a in ((bare, one), (plant, other))
    ]
    np.testing.assert_array_equal(limits[0], limits[1])
    assert limits[1] == [9.0, 5.0]
    first, second = Followers.of(bare, one), Followers.of(plant, other)
    assert [joint.name() for joint in first.joints] == [joint.name() for joint in second.joints] == ["other"]
    np.testing.assert_array_equal(second.multiplier, [-2.0])


def test_what_cannot_be_is_refused_with_the_name_of_the_file(tmp_path: Path) -> None:
    outer = told(tmp_path, ARM.replace('<mass value="1"/>', '<mass value="-1"/>', 1))
    with pytest.raises(ModelError, match=r"arm\.urdf: link 'base': a mass of -1 kg"):
        added(outer)


def test_a_copy_finds_what_it_names(tmp_path: Path) -> None:
    lab = tmp_path / "lab"
    lab.mkdir()
    outer = told(lab)
    outer.write_text('directives:\n- add_model: {name: arm, file: "package://lab/arm.urdf"}\n')
    Model.load(outer, {"lab": lab}).save(tmp_path / "saved")
    assert Model.load(tmp_path / "saved", {"lab": lab}).joints == ("turn",)
    assert Model.load(tmp_path / "saved").joints == ("turn",)


def test_files_that_name_each_other_are_read_once(tmp_path: Path) -> None:
    outer = told(tmp_path)
    inner = tmp_path / "inner.dmd.yaml"
    inner.write_text(inner.read_text() + "- add_directives: {file: package://lab/outer.dmd.yaml}\n")
    assert parts_of(outer, {"lab": tmp_path}) == (tmp_path / "arm.urdf",)
    assert parts_of(outer, {}) == (outer,)
    (tmp_path / "broken.dmd.yaml").write_text("directives: 3\n")
    assert parts_of(tmp_path / "broken.dmd.yaml", {}) == (tmp_path / "broken.dmd.yaml",)
