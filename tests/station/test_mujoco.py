"""The arm in MuJoCo: which limits are whose."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

LINK = (
    '<link name="{}"><inertial><mass value="1"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
JOINT = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><axis xyz="0 0 1"/>{}</joint>'


@pytest.mark.parametrize("silent", ["", '<limit effort="0" velocity="0"/>'])
def test_limits_are_the_joints_own_however_the_file_lists_them(tmp_path: Path, silent: str) -> None:
    pytest.importorskip("mujoco", reason="needs the `demo` extra")
    from twin_diagram.station.mujoco import MujocoArm, Secret

    limit = '<limit lower="-1" upper="1" effort="{}" velocity="1"/>'.format
    joints = [
        JOINT.format("tip", "revolute", "b", "c", limit(7)),
        JOINT.format("middle", "continuous", "a", "b", silent),
        JOINT.format("first", "prismatic", "base", "a", limit(50)),
    ]
    file = tmp_path / "arm.urdf"
    file.write_text(f'<robot name="r">{"".join(map(LINK.format, ["base", "a", "b", "c"]))}{"".join(joints)}</robot>')
    arm = MujocoArm(file, Secret(), [0.0, 0.0, 0.0])
    assert arm.joints == ("first", "middle", "tip")
    np.testing.assert_array_equal(arm._limit, [50.0, np.inf, 7.0])
