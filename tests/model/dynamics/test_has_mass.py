"""An arm of which a joint moves nothing is refused in words, before anything divides by its inertia."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin_diagram.errors import ModelError
from twin_diagram.model import Model
from twin_diagram.model.dynamics import has_mass
from twin_diagram.runs.first_scenario import look_at

LINK = """<link name="{0}">{1}</link><joint name="{0}_joint" type="revolute"><parent link="{2}"/><child link="{0}"/>
  <origin xyz="0.1 0 0"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="1"/></joint>"""
MASS = """<inertial><origin xyz="0.1 0 0"/><mass value="{}"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>"""


def arm(folder: Path, one: str, two: str) -> Path:
    path = folder / "arm.urdf"
    links = LINK.format("one", one, "base") + LINK.format("two", two, "one")
    path.write_text(f'<robot name="a"><link name="base"/>{links}</robot>')
    return path


def test_a_joint_that_moves_nothing_is_named(tmp_path: Path) -> None:
    last = arm(tmp_path, MASS.format(1), "")
    with pytest.raises(ModelError, match="'two_joint' moves no mass"):
        Model.load(last)
    with pytest.raises(ModelError, match="'two_joint' moves no mass"):
        look_at(last)
    assert Model.load(arm(tmp_path, "", MASS.format(1))).joints == ("one_joint", "two_joint")


def test_a_matrix_that_is_not_positive_is_refused() -> None:
    with pytest.raises(ModelError, match="not positive"):
        has_mass.check("a.urdf", ("a", "b"), lambda q: np.array([[1.0, 1.0], [1.0, 1.0]]))
    with pytest.raises(ModelError, match="finite"):
        has_mass.check("a.urdf", ("a",), lambda q: np.array([[np.nan]]))
    has_mass.check("a.urdf", ("a", "b"), lambda q: np.diag([1e-6, 10.0]))
