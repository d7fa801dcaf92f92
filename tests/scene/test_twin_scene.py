"""What the twin's scene is made of: where fixtures stand, what counts as an object, where the unseen wait."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.framework import DiagramBuilder

from twin_diagram import scenario
from twin_diagram.errors import AssetError, ModelError
from twin_diagram.scenario.resources import models_dir
from twin_diagram.scene.twin_scene import TwinScene, add_twin_scene, parked_poses


def scene(**fields: object) -> TwinScene:
    return add_twin_scene(DiagramBuilder(), scenario.Twin(**fields))  # type: ignore[arg-type]


def asset(folder: Path, model: str) -> str:
    """A can whose description is replaced."""
    shutil.copytree(models_dir() / "objects" / "can", folder)
    (folder / "model.sdf").write_text(f'<sdf version="1.9">{model}</sdf>')
    return str(folder)


LINK = '<link name="{}"><inertial><mass>1</mass></inertial></link>'
HINGE = '<joint name="hinge" type="{}"><parent>{}</parent><child>{}</child>{}</joint>'
AXIS = "<axis><xyz>0 0 1</xyz></axis>"


def model(*parts: str, name: str = "thing") -> str:
    return f'<model name="{name}">{"".join(parts)}</model>'


def test_the_unseen_wait_upright_five_metres_down_a_metre_apart() -> None:
    expected = [[1.0, 0, 0, 0, k, 0, -5.0] for k in range(3)]
    np.testing.assert_array_equal(parked_poses(3), expected)
    made = scene(library={"one": "objects/can", "two": "objects/gelatin_box"})
    np.testing.assert_array_equal(made.default_positions[made.object_position_index], expected[:2])
    np.testing.assert_array_equal([kind.axis for kind in made.kinds], [[0, 0, 1.0], [0, 0, 0]])


def test_fixtures_stand_where_they_are_told() -> None:
    poses = [scenario.Pose([0.1, 0.2, 0.3], [0.0, 0.0, 0.5]), scenario.Pose([1.0, 0.0, 0.0], [0.1, 0.0, 0.0])]
    fixtures = [
        scenario.Fixture(f"scenes/{name}.sdf", X_WB=X) for name, X in zip(("bin_a", "bin_b"), poses, strict=True)
    ]
    made = scene(fixtures=fixtures)
    plant, context = made.plant, made.plant.CreateDefaultContext()
    for name, pose in zip(("bin_a", "bin_b"), poses, strict=True):
        body = plant.GetBodyByName("bin", plant.GetModelInstanceByName(name))
        expected = RigidTransform(RollPitchYaw(pose.rpy), pose.translation)
        assert plant.EvalBodyPoseInWorld(context, body).IsNearlyEqualTo(expected, 1e-12)
    assert made.object_position_index.shape == (0, 7)


def test_models_and_assets_are_found_in_packages(tmp_path: Path) -> None:
    asset(tmp_path / "thing", model(LINK.format("object")))
    (tmp_path / "post.sdf").write_text(f'<sdf version="1.9">{model(LINK.format("post"), name="post")}</sdf>')
    twin = scenario.Twin(
        fixtures=[scenario.Fixture("package://own/post.sdf")], library={"thing": "package://own/thing"}
    )
    made = add_twin_scene(DiagramBuilder(), twin, {"own": tmp_path})
    assert made.plant.HasBodyNamed("post") and made.object_names == ("thing",)
    with pytest.raises(ModelError):
        add_twin_scene(DiagramBuilder(), twin)


def test_a_fixtures_own_joints_stay() -> None:
    """What hangs on a joint of a fixture is not welded to the world, too."""
    made = scene(fixtures=[scenario.Fixture()])
    assert made.plant.num_positions() == len(made.arm_position_index) + len(made.gripper_position_index)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        (model(LINK.format("thing")), "must hold one model with the link `object`"),
        (model(LINK.format("object")) + model(LINK.format("object"), name="other"), "only contain one model"),
        (
            model(LINK.format("object"), LINK.format("lid"), HINGE.format("revolute", "object", "lid", AXIS)),
            "must be one free body; it has 2 joints",
        ),
        (model(LINK.format("object"), HINGE.format("fixed", "world", "object", "")), "it has 1 joints"),
        (model(LINK.format("object"), HINGE.format("revolute", "world", "object", AXIS)), "it has 1 joints"),
    ],
)
def test_an_object_is_one_free_body(tmp_path: Path, parts: str, message: str) -> None:
    with pytest.raises(AssetError, match=message):
        scene(library={"thing": asset(tmp_path / "asset", parts)})
