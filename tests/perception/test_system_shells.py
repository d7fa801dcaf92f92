"""The two systems of perception by themselves: when they look, and what they hand on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydrake.common.value import AbstractValue, Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from twin_diagram import scenario
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.registration import pose_system
from twin_diagram.perception.registration.pose_system import IcpPoseEstimator
from twin_diagram.perception.registration.slots import Slot, measurement
from twin_diagram.perception.segmentation import segmentation_system
from twin_diagram.perception.segmentation.segmentation_system import PerceptionSystem
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.layouts import MEASUREMENT_SIZE, NEVER, PoseMeasurement

CAMERA = scenario.Camera(width=16, height=12, focal=20.0, rate=8.0, latency=0.03125)


# Poses.


class Steps:
    """Stands for tracking: each image counts up, and says so in the objects' places."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.times: list[float] = []
        self.smallest: list[int] = []
        monkeypatch.setattr(pose_system, "step", self.step)
        monkeypatch.setattr(pose_system.ModelCloud, "of", staticmethod(lambda asset, points: (asset, points)))
        monkeypatch.setattr(pose_system.Known, "of", staticmethod(lambda model: model))

    def step(self, library: Any, slots: list[Slot], segments: Segments, params: Any, smallest: int) -> Any:
        assert library == (("can", 600), ("mug", 600)) and isinstance(params, scenario.Registration)
        self.times.append(segments.time)
        self.smallest.append(smallest)
        after = [Slot(p=slot.p + [1.0, float(k), 0.0]) for k, slot in enumerate(slots)]
        return after, [measurement(slot, None, segments.time) for slot in after], None


def estimator(**given: Any) -> IcpPoseEstimator:
    return IcpPoseEstimator({"can": "can", "mug": "mug"}, CAMERA, scenario.Registration(), **given)  # type: ignore[dict-item]


def seen(time: float) -> Segments:
    from dataclasses import replace

    return replace(Segments.empty(Pinhole.from_scenario(CAMERA), 2), time=time)


def poses(system: IcpPoseEstimator, context: Any) -> list[PoseMeasurement]:
    packed = system.get_output_port().Eval(context).reshape(-1, MEASUREMENT_SIZE)
    return [PoseMeasurement.unpack(row) for row in packed]


def test_poses_are_those_of_each_image_once_a_millisecond_after_it(monkeypatch: pytest.MonkeyPatch) -> None:
    steps, system = Steps(monkeypatch), estimator(perception=scenario.Perception(smallest=33))
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    port = system.get_input_port()
    assert [one.time for one in poses(system, context)] == [NEVER, NEVER]
    for now, image, known in (
        (0.02, 0.0, 0),
        (0.0320, 0.0, 0),  # 31.25 ms after capture the image is there, and a millisecond later its poses
        (0.0325, 0.0, 1),
        (0.1560, 0.125, 1),
        (0.1574, 0.125, 2),
        (0.2824, 0.125, 2),  # the same image again says nothing new
        (0.4080, 0.0625, 2),  # nor does an older one
        (0.5330, 0.375, 3),
        (0.6580, -1.0, 3),
    ):
        port.FixValue(context, AbstractValue.Make(seen(image)))
        simulator.AdvanceTo(now)
        assert len(steps.times) == known, now
        if known:
            can, mug = poses(system, context)
            assert can.time == mug.time == steps.times[-1]
            np.testing.assert_allclose([can.pose[4:], mug.pose[4:]], [[known, 0, 0], [known, known, 0]])
    assert steps.times == [0.0, 0.125, 0.375] and set(steps.smallest) == {33}


def test_what_is_not_told_is_as_usual(monkeypatch: pytest.MonkeyPatch) -> None:
    steps, system = Steps(monkeypatch), estimator()
    simulator = Simulator(system)
    system.get_input_port().FixValue(simulator.get_mutable_context(), AbstractValue.Make(seen(0.0)))
    simulator.AdvanceTo(0.04)
    assert steps.smallest == [60] and system.names == ("can", "mug")
    system = IcpPoseEstimator({}, CAMERA, scenario.Registration())
    assert system.get_output_port().size() == 0 and system.num_continuous_states() == 0


# Segments.


class Shape:
    """Stands for the robot's shapes: near is what lies left of the first joint's angle."""

    joint_count, finger_count = 2, 1

    def __init__(self, *given: Any) -> None:
        self.given = given
        self.asked: list[Any] = []

    def near(self, points: Any, q: Any, margin: float, fingers: Any) -> Any:
        self.fingers = fingers
        self.asked.append((points.copy(), np.array(q), margin))
        return np.zeros(len(points), dtype=bool)


def test_an_image_is_taken_apart_with_the_arm_as_it_was_then(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def apart(rgb: Any, depth: Any, time: float, grid: Any, params: Any, near: Any) -> Segments:
        asked[:] = [rgb.copy(), depth.copy(), time, grid, params, near(np.ones((1, 3)), 0.07)]
        return seen(time)

    monkeypatch.setattr(segmentation_system, "RobotShape", Shape)
    monkeypatch.setattr(segmentation_system, "segment", apart)
    arm, params = scenario.ArmModel(), scenario.Perception(stride=3, table_height=0.2)
    system = PerceptionSystem(arm, CAMERA, params, {"pkg": "there"}, "base")
    assert system._robot.given == (arm, {"pkg": "there"}, "base")
    assert system.GetInputPort("arm_state").size() == 4
    context = system.CreateDefaultContext()
    rgb, depth = ImageRgba8U(16, 12), ImageDepth32F(16, 12)
    rgb.mutable_data[:], depth.mutable_data[:] = 77, 0.5
    system.GetInputPort("rgb_image").FixValue(context, Value(rgb))
    system.GetInputPort("depth_image").FixValue(context, Value(depth))
    system.GetInputPort("arm_state").FixValue(context, [1.0, 2.0, 10.0, -20.0])
    context.SetTime(0.75)
    system.GetInputPort("image_time").FixValue(context, [NEVER])
    none = system.get_output_port().Eval(context)
    assert none.time == NEVER and not asked
    assert none.label_image.shape == (4, 6) and none.stride == 3 and none.table[2] == 0.2
    for time in (0.5, 0.0):
        system.GetInputPort("image_time").FixValue(context, [time])
        assert system.get_output_port().Eval(context).time == time
        assert asked[0].shape == (12, 16, 3) and asked[1].shape == (12, 16) and asked[2] == time
        assert asked[3].stride == 3 and asked[4] is params
        # Where it was then, and half a frame before.
        for back, (points, q, margin) in zip((0.0, 0.5 / CAMERA.rate), system._robot.asked[-2:], strict=True):
            np.testing.assert_allclose(q, [1.0 - 10.0 * (0.75 + back - time), 2.0 + 20.0 * (0.75 + back - time)])
            assert points.shape == (1, 3) and margin == 0.07
    assert system._robot.fingers is None
    for told, fingers in (([0.03, 0.2], [0.03]), ([np.nan, 0.0], None)):
        system.GetInputPort("gripper_state").FixValue(context, told)
        system.get_output_port().Eval(context)
        assert system._robot.fingers == fingers, "where they are, or half open"
