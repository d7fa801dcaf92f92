"""How far a hand is open whose fingers a linkage carries: beside the bars' own closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.station.sim.linkage_hand import FRAME, SHUT, X_FG, linkage_hand, opening
from twin_diagram.errors import ModelError
from twin_diagram.model.description.finger_travel import FingerTravel, travel_of
from twin_diagram.planning.collision.ball_cover import arm_plant
from twin_diagram.planning.collision.between_fingers import between_fingers, refuse_turning
from twin_diagram.planning.collision.hand_shape import hand_shape
from twin_diagram.planning.grasps.own_gripper import gripper_of_shape
from twin_diagram.planning.tasks.task_system import Fingers
from twin_diagram.scenario import ArmModel, Pose


def told(model: Path) -> ArmModel:
    return ArmModel(model=str(model), tool_frame=FRAME, X_FG=Pose(translation=list(X_FG)))


def described(spec: ArmModel) -> FingerTravel | None:
    plant, _, arm, _keep = arm_plant(spec)
    return travel_of(plant, arm)


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_opening_is_that_of_the_bars(tmp_path: Path, mirrored: bool) -> None:
    travel = described(told(linkage_hand(tmp_path, mirrored=mirrored)))
    assert travel is not None
    way = -1.0 if mirrored else 1.0
    np.testing.assert_array_equal([travel.closed, travel.opened], [[way * SHUT], [0.0]])
    for angle in np.linspace(0.0, SHUT, 50):
        at = way * np.array([angle])
        assert travel.opening(at) == pytest.approx(float(opening(angle)), abs=1e-5)
        slope = float(opening(angle - 1e-6) - opening(angle + 1e-6)) / 2e-6
        assert travel.lever(at)[0] == pytest.approx(slope, rel=0.02)


def test_fingers_know_their_opening_and_speed(tmp_path: Path) -> None:
    plant, _, arm, _keep = arm_plant(told(linkage_hand(tmp_path)))
    fingers = Fingers.of(plant, arm, np.zeros(1))
    assert fingers.widest == pytest.approx(float(opening(0.0)), abs=1e-9)
    for share in (0.0, 0.3, 1.0):
        assert fingers.opening(fingers.at(share)) == pytest.approx(share * fingers.widest, abs=1e-12)
    at = np.array([0.4])
    moved = float(opening(0.4) - opening(0.4 + 1e-5)) / 1e-5 / 2.0  # of one finger, at 1 rad/s
    assert fingers.fastest(at, np.ones(1)) == pytest.approx(moved, rel=0.02)


def test_each_of_two_motors_moves_one_finger() -> None:
    """Alike but for their sense: the opening grows by 3 cm with each of them, a finger moves by as much."""
    travel = FingerTravel(np.array([0.6, -0.6]), np.zeros(2), np.linspace(0.0, 0.06, 9))
    at = np.array([0.3, -0.3])
    assert travel.opening(at) == pytest.approx(0.03)
    np.testing.assert_allclose(travel.lever(at), 0.05)
    fingers = Fingers(np.zeros(2), travel.closed, travel.opened, travel=travel)
    assert fingers.fastest(at, np.array([0.2, -0.1])) == pytest.approx(0.01)


def test_a_linkage_makes_a_gripper_and_what_fingers_sweep_counts(tmp_path: Path) -> None:
    plant, scene_graph, arm, _keep = arm_plant(told(linkage_hand(tmp_path)))
    refuse_turning(plant, arm)
    X_LG = between_fingers(plant, scene_graph, arm)
    assert X_LG is not None
    tool, last = plant.get_frame(arm.tool_frame), plant.get_body(arm.last_link).body_frame()
    X_LT = plant.CalcRelativeTransform(plant.CreateDefaultContext(), last, tool).GetAsMatrix4()
    np.testing.assert_allclose(X_LG[:3, 3], np.asarray(X_LT)[:3, 3], atol=1e-4)
    gripper = gripper_of_shape(hand_shape(plant, scene_graph, arm), "bars", FRAME)
    assert gripper is not None
    # Bars that come to stand straighter carry the pads ahead: open by 9.5 mm less than half open, shut by 0.7 less.
    reach = [0.01 - 0.05 * (np.cos(0.45 - 0.6435) - np.cos(angle - 0.6435)) for angle in (0.0, SHUT)]
    assert gripper.finger_front == pytest.approx(max(reach), abs=2e-4)
    assert gripper.pad_front == pytest.approx(min(reach), abs=2e-4)
    assert gripper.pad_back == pytest.approx(max(reach) - 0.05, abs=2e-4)
    assert gripper.opening_most == pytest.approx(2 * (0.06 - 0.0173), abs=1e-3)
    assert gripper.force == pytest.approx(20.0 / (2.0 * 0.04), rel=0.05)  # effort over the lever, open


def test_pads_that_turn_are_refused(tmp_path: Path) -> None:
    spec = told(linkage_hand(tmp_path, parallel=False))
    assert described(spec) is None
    plant, _, arm, _keep = arm_plant(spec)
    with pytest.raises(ModelError, match="left_bar_joint turns its fingers' pads; a pick needs pads that are carried"):
        refuse_turning(plant, arm)


def test_fingers_that_slide_need_none_of_it() -> None:
    assert described(ArmModel(model="arms/panda_hand.urdf", tool_frame="panda_tcp")) is None
