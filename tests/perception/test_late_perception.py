"""Perception whose result counts at a declared latency: the same poses, later, whoever looks at the images."""

from __future__ import annotations

import pickle
from typing import cast

import numpy as np
import numpy.typing as npt
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from tests.perception.test_perception_systems import CAMERA, VIEW, Film, Q, asset, images, things_at
from tests.synthetic_scene import picture
from twin_diagram import scenario
from twin_diagram.errors import ScenarioError
from twin_diagram.perception import IcpPoseEstimator, PerceptionSystem
from twin_diagram.scenario.validation import check_twin
from twin_diagram.signals.hand import Hand
from twin_diagram.signals.pose_vectors import as_matrix

LATE = 0.03
PORTS = ("object_poses", "further_poses", "things", "turned_away")
Frames = list[tuple[ImageRgba8U, ImageDepth32F]]
Outputs = list[npt.NDArray[np.float64]]


@pytest.fixture(scope="module")
def frames() -> Frames:
    library = {name: asset(name) for name in ("sugar_box", "can")}
    rng = np.random.default_rng(3)
    return [images(*picture(VIEW, things_at(library, k / CAMERA.rate), rng)[:2]) for k in range(3)]


def eyes(frames: Frames, latency: float, whole: bool = False) -> Diagram:
    """A camera, an arm at rest, and perception with slots for what is unknown: the can is.

    Where `whole`, a process beside takes images apart, too.
    """
    tuning, builder = scenario.Perception(latency=latency), DiagramBuilder()
    film = builder.AddSystem(Film(frames))
    arm = builder.AddSystem(ConstantVectorSource(np.concatenate([Q, np.zeros(7)])))
    perception = builder.AddNamedSystem("perception", PerceptionSystem(scenario.ArmModel(), CAMERA, tuning))
    library = {"sugar_box": asset("sugar_box")}
    parting = perception.parting if whole else None
    estimator = IcpPoseEstimator(library, CAMERA, scenario.Registration(), tuning, scenario.Slots(), parting=parting)
    builder.AddNamedSystem("poses", estimator)
    for name in ("rgb_image", "depth_image", "image_time"):
        builder.Connect(film.GetOutputPort(name), perception.GetInputPort(name))
    builder.Connect(arm.get_output_port(), perception.GetInputPort("arm_state"))
    for name in ("segments", *(["picture"] if whole else [])):
        builder.Connect(perception.GetOutputPort(name), estimator.GetInputPort(name))
    for name in PORTS:
        builder.ExportOutput(estimator.GetOutputPort(name), name)
    return builder.Build()


def told(diagram: Diagram, late: float) -> Outputs:
    """What is told of each of three images just before its time, and just after it."""
    simulator, found = Simulator(diagram), []
    for k in range(3):
        for margin in (-1e-4, 1e-4):
            simulator.AdvanceTo(k / CAMERA.rate + CAMERA.latency + 0.001 + late + margin)
            ports = [np.array(diagram.GetOutputPort(name).Eval(simulator.get_context())) for name in PORTS]
            found.append(np.concatenate(ports))
    return found


def test_poses_are_the_same_and_later(frames: Frames) -> None:
    at_once, late = told(eyes(frames, 0.0), 0.0), told(eyes(frames, LATE), LATE)
    for one, other in zip(at_once, late, strict=True):
        np.testing.assert_array_equal(one, other)
    assert not np.array_equal(late[0], late[1]) and np.array_equal(late[1], late[2])
    assert not np.array_equal(late[2], late[3])


def test_an_image_as_delivered_asks_the_same(frames: Frames) -> None:
    diagram = eyes(frames, LATE, whole=True)
    for one, other in zip(told(eyes(frames, LATE), LATE), told(diagram, LATE), strict=True):
        np.testing.assert_array_equal(one, other)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(CAMERA.latency + 0.002)
    perception = cast(PerceptionSystem, diagram.GetSubsystemByName("perception"))
    context = diagram.GetSubsystemContext(perception, simulator.get_context())
    segments, seen = (perception.GetOutputPort(name).Eval(context) for name in ("segments", "picture"))
    copied, picture = pickle.loads(pickle.dumps((perception.parting, seen)))
    again = copied.apart(picture)
    assert again.time == segments.time == 0.0 and len(segments.points_W) > 100
    np.testing.assert_array_equal(again.points_W, segments.points_W)
    np.testing.assert_array_equal(again.label_image, segments.label_image)


@pytest.mark.parametrize("latency", [0.0, LATE])
def test_what_is_held_is_told_where_the_hand_had_it_when_the_image_was_taken(frames: Frames, latency: float) -> None:
    builder, speed = DiagramBuilder(), np.array([0.6, 0, 0, 0, 0, 0, -0.3])
    film = builder.AddSystem(Film(frames))
    arm = builder.AddSystem(ConstantVectorSource(np.concatenate([Q, speed])))
    model = scenario.ArmModel(model="arms/panda_hand.urdf", tool_frame="panda_tcp")
    eye = PerceptionSystem(model, CAMERA, scenario.Perception(latency=latency))
    perception = builder.AddNamedSystem("perception", eye)
    X_TO = np.array([1.0, 0, 0, 0, 0.01, -0.02, 0.03])
    hand = builder.AddSystem(ConstantVectorSource(Hand(held=1, X_TO=X_TO).pack()))
    for name in ("rgb_image", "depth_image", "image_time"):
        builder.Connect(film.GetOutputPort(name), perception.GetInputPort(name))
    builder.Connect(arm.get_output_port(), perception.GetInputPort("arm_state"))
    builder.Connect(hand.get_output_port(), perception.GetInputPort("hand"))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(CAMERA.latency + 0.002)
    context = diagram.GetSubsystemContext(perception, simulator.get_context())
    segments = perception.GetOutputPort("segments").Eval(context)
    now = CAMERA.latency + (0.00075 if latency else 0.002)
    assert segments.held.asset == 1
    for s, R, p in zip((0.0, 0.5, 1.0), segments.held.R, segments.held.p, strict=True):
        there = eye.parting.robot.tool(Q - speed * (now - segments.time + s * 0.5 / CAMERA.rate)) @ as_matrix(X_TO)
        np.testing.assert_allclose(np.column_stack([R, p]), there[:3], atol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("whole", [False, True])
def test_a_process_of_its_own_tells_the_same_to_the_bit(frames: Frames, whole: bool) -> None:
    here, diagram = told(eyes(frames, LATE), LATE), eyes(frames, LATE, whole)
    estimator = cast(IcpPoseEstimator, diagram.GetSubsystemByName("poses"))
    with estimator.looking_beside():
        there = told(diagram, LATE)
        assert estimator._looking is not None and not estimator._looking.why
        assert sum(asked.answer is not None for asked in estimator._looking._known) == 3, "it looked at each"
        # One that was killed costs time, and no figure.
        estimator._looking._worker.process.kill()
        alone = told(diagram, LATE)
    for one, other, third in zip(here, there, alone, strict=True):
        np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(one, third)
    assert estimator._looking is None


def test_one_that_would_last_until_the_next_image_is_refused() -> None:
    twin = scenario.Twin()
    twin.perception.latency = 0.064
    check_twin(twin)
    twin.perception.latency = 0.066
    with pytest.raises(ScenarioError, match=r"twin\.perception\.latency: 0\.066 s is more than 0\.06467 s"):
        check_twin(twin)
    twin.perception.latency = -0.01
    with pytest.raises(ScenarioError, match=r"twin\.perception\.latency"):
        check_twin(twin)
    twin.perception.latency = 0.01
    twin.cameras = {"other": scenario.Camera(role="perception")}
    with pytest.raises(ScenarioError, match="one camera"):
        check_twin(twin)
