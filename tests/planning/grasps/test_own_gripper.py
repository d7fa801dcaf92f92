"""Grippers by their shapes: beside the figures that were written down for those that come along, and for one's own."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from tests.planning.collision.test_between_fingers import hand
from tests.station.sim.linkage_hand import linkage_hand
from twin_diagram.assets import Asset
from twin_diagram.cli import main
from twin_diagram.planning.collision.ball_cover import arm_plant
from twin_diagram.planning.collision.hand_shape import HandHulls, Palm, hand_shape
from twin_diagram.planning.grasps.gripper import PANDA_HAND, WSG50, Gripper
from twin_diagram.planning.grasps.own_gripper import TUNING, gripper_of_description, gripper_of_shape
from twin_diagram.planning.tasks.task_system import shape_grasps
from twin_diagram.scenario import ArmModel, Pose
from twin_diagram.scenario.resources import models_dir, resolve
from twin_diagram.signals.pose_vectors import errors


def of_arm(spec: ArmModel) -> Gripper | None:
    plant, scene_graph, arm, _keep = arm_plant(spec)
    return gripper_of_shape(hand_shape(plant, scene_graph, arm), "mine", "tool")


@pytest.mark.parametrize(("told", "model"), [(PANDA_HAND, "panda_hand"), (WSG50, "iiwa7_wsg")])
def test_hands_that_come_along_are_as_was_written_down(told: Gripper, model: str) -> None:
    found = of_arm(ArmModel(model=f"arms/{model}.urdf", tool_frame=told.frame))
    assert found is not None
    alike = (
        *("opening_least", "opening_most", "finger_front", "finger_length", "finger_thickness", "finger_width"),
        *("pad_front", "pad_width", "palm_size"),
    )
    for name in alike:
        np.testing.assert_allclose(asdict(found)[name], asdict(told)[name], atol=2e-3, err_msg=name)
    # Roots stand out as far, and begin no nearer to the tips than a pad's length; what they keep inside is not told.
    assert found.root_thickness == pytest.approx(told.root_thickness, abs=2e-3)
    assert found.finger_front - TUNING.pad >= found.root_front >= told.root_front - 2e-3


def test_a_mug_is_taken_by_a_hand_of_ones_own_as_by_the_one_with_figures() -> None:
    """On the rim and at the handle: of the ten best none is 3 cm from one of the thirty of the other."""
    mug = Asset.load(resolve("objects/mug", {}))
    mine = of_arm(ArmModel(model="arms/panda_hand.urdf", tool_frame="panda_tcp"))
    assert mine is not None
    found, told = (shape_grasps(mug, gripper).poses for gripper in (mine, PANDA_HAND))
    assert len(found) >= 10
    assert max(min(errors(one, other)[0] for other in told) for one in found[:10]) < 0.03


def test_a_foreign_hand_is_told_by_its_boxes(tmp_path: Path) -> None:
    """Fingers of 20 × 15 mm, 4 cm long, before a palm of 6 × 10 × 4 cm."""
    model = hand(tmp_path, ("0 0 1", "0 0 -1"), ("0.1 0 0.0075", "0.1 0 -0.0075"), "0.04 0.02 0.015")
    palm = '<collision><origin xyz="0.06 0 0"/><geometry><box size="0.04 0.06 0.1"/></geometry></collision>'
    model.write_text(model.read_text().replace('<link name="palm">', f'<link name="palm">{palm}'))
    frame = Pose([0.11, 0.0, 0.0], [np.pi / 2, 0.0, np.pi / 2])
    found = of_arm(ArmModel(model=str(model), tool_frame="palm", X_FG=frame))
    assert found is not None
    assert (found.opening_least, found.opening_most) == (0.0, pytest.approx(0.08))
    assert (found.finger_front, found.finger_length) == (pytest.approx(0.01), pytest.approx(0.04))
    assert (found.finger_thickness, found.finger_width) == (pytest.approx(0.015), pytest.approx(0.02))
    np.testing.assert_allclose(found.palm_size, [0.06, 0.1, 0.04])
    assert found.root_thickness == 0.0 and found.force == 50.0


def test_what_makes_no_gripper_is_none() -> None:
    assert gripper_of_shape(HandHulls(), "mine", "tool") is None
    finger = np.array([[x, y, z] for x in (-0.01, 0.01) for y in (0.04, 0.05) for z in (-0.04, 0.01)])
    other = finger * [1.0, -1.0, 1.0]
    palm = Palm(0.05, np.array([[x, y, z] for x in (-0.03, 0.03) for y in (-0.1, 0.1) for z in (-0.1, -0.04)]))
    whole = HandHulls(palm, (finger, other), (finger - [0.0, 0.04, 0.0], other + [0.0, 0.04, 0.0]))
    gripper = gripper_of_shape(whole, "mine", "tool")
    assert gripper is not None and gripper.force == TUNING.force
    for lacking in ({"palm": Palm()}, {"opened": (finger,)}, {"closed": (other,)}, {"closed": whole.opened}):
        assert gripper_of_shape(replace(whole, **lacking), "mine", "tool") is None, lacking  # type: ignore[arg-type]


def test_the_hand_of_a_description_is_found_without_a_frame_that_names_it() -> None:
    found = gripper_of_description(models_dir() / "arms" / "panda_hand.urdf")
    assert found.name == "panda_hand_hand" and found.frame.startswith("panda_link7, X_FG: {translation: [0, 0, 0.2")
    for name in ("opening_most", "finger_front", "finger_length", "finger_thickness", "finger_width"):
        assert getattr(found, name) == pytest.approx(getattr(PANDA_HAND, name), abs=2e-3), name


def test_an_arm_without_a_hand_and_pads_that_turn_are_refused_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    turning = linkage_hand(tmp_path, parallel=False)
    for model, said in (
        (models_dir() / "arms" / "ur5e.urdf", "no two fingers with collision shapes move apart"),
        (turning, "left_bar_joint turns its fingers' pads"),
    ):
        assert main(["grasps", "objects/mug", "--gripper", str(model)]) == 2
        error = capsys.readouterr().err.strip()
        assert said in error and error.count("\n") == 0
