"""A description without what is there for eyes alone: what touches, weighs and moves is the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex

from twin_diagram import scenario
from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.planning.collision.ball_cover import arm_plant
from twin_diagram.scenario.resources import models_dir

ARM = """<?xml version="1.0"?>
<robot name="arm">
  <!-- <visual> of the base comes later -->
  <link name="base"/>
  <link name="bar">
    <inertial><mass value="1.0"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual name="seen"><geometry><box size="0.1 0.1 0.3"/></geometry><material name="red"/></visual>
    <visual/>
    <collision><geometry><sphere radius="0.05"/></geometry></collision>
    <!-- </visual> -->
  </link>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="bar"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="10" velocity="1"/>
  </joint>
  <material name="red"><color rgba="1 0 0 1"/></material>
</robot>
"""


def shapes(arm: Path, looked_at: bool) -> tuple[list[tuple[object, ...]], list[object], int]:
    """What touches, by link; masses of all links; how many shapes are seen."""
    scene_graph, plant = SceneGraph(), MultibodyPlant(0.0)
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    add_arm(plant, arm, looked_at=looked_at)
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    bodies = [plant.get_body(BodyIndex(k)) for k in range(1, plant.num_bodies())]
    touching: list[tuple[object, ...]] = [
        (body.name(), str(inspector.GetShape(one)), inspector.GetPoseInFrame(one).GetAsMatrix4().tobytes())
        for body in bodies
        for one in plant.GetCollisionGeometriesForBody(body)
    ]
    masses: list[object] = [(body.name(), body.default_mass()) for body in bodies]
    return touching, masses, inspector.NumGeometriesWithRole(Role.kPerception)


@pytest.mark.parametrize("name", ["iiwa7_wsg.urdf", "panda_hand.urdf", "ur5e.urdf"])
def test_what_touches_and_weighs_is_the_same(name: str) -> None:
    touching, masses, seen = shapes(models_dir() / "arms" / name, True)
    assert shapes(models_dir() / "arms" / name, False) == (touching, masses, 0)
    assert seen > 40 and len(touching) > 10


def test_comments_end_and_begin_nothing(tmp_path: Path) -> None:
    """Between the words in two comments stands the arm's only shape that touches."""
    (tmp_path / "arm.urdf").write_text(ARM.replace("<visual/>", ""))
    touching, masses, seen = shapes(tmp_path / "arm.urdf", True)
    assert (len(touching), seen) == (1, 1)
    (tmp_path / "arm.urdf").write_text(ARM)
    assert shapes(tmp_path / "arm.urdf", False) == (touching, masses, 0)


def test_the_planner_reads_no_more_than_that() -> None:
    plant, scene_graph, _, keep = arm_plant(scenario.ArmModel(model=str(models_dir() / "arms" / "panda_hand.urdf")))
    inspector = scene_graph.model_inspector()
    assert inspector.NumGeometriesWithRole(Role.kPerception) == 0
    assert inspector.NumGeometriesWithRole(Role.kProximity) > 20
    del keep
    assert np.isfinite(plant.CalcTotalMass(plant.CreateDefaultContext()))
