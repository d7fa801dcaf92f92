"""A user's own station, controller, perception and segmenter in the twin's place, by their ports' names."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

from tests.small_loop import BLIND, small_scenario
from twin_diagram.errors import TwinError
from twin_diagram.runs import replay_log, run_scenario
from twin_diagram.signals.layouts import MEASUREMENT_SIZE, TRACK_SIZE, ObjectStatus, PoseMeasurement, Track
from twin_diagram.signals.things import Thing
from twin_diagram.twin import make_closed_loop, make_twin

N = 7


class Nod(LeafSystem):
    """A controller in five lines: the wrist nods around where the arm is told to stand."""

    def __init__(self, home: list[float]) -> None:
        super().__init__()
        self.DeclareVectorInputPort("arm_state", 2 * N)
        self.DeclareVectorOutputPort("position_commanded", N, self.calc)
        self.home = np.array(home)

    def calc(self, context: Context, output: BasicVector) -> None:
        output.SetFromVector(self.home + 0.2 * np.sin(2.0 * context.get_time()) * np.eye(N)[5])


class Declared(LeafSystem):
    """Any ports, all zeros."""

    def __init__(self, inputs: dict[str, int], outputs: dict[str, int]) -> None:
        super().__init__()
        for name, size in inputs.items():
            self.DeclareVectorInputPort(name, size)
        for name, size in outputs.items():
            self.DeclareVectorOutputPort(name, size, lambda context, output: None)


class Told(LeafSystem):
    """A perception that was told where everything is."""

    def __init__(self, poses: list[np.ndarray]) -> None:
        super().__init__()
        self.time = self.DeclareVectorInputPort("image_time", 1)
        self.poses = poses
        self.DeclareVectorOutputPort("object_poses", MEASUREMENT_SIZE * len(poses), self.calc)

    def calc(self, context: Context, output: BasicVector) -> None:
        t: Any = self.time.Eval(context)
        found = [PoseMeasurement(1.0, float(t[0]), pose, 1e-6 * np.eye(6)) for pose in self.poses]
        output.SetFromVector(np.concatenate([one.pack() for one in found]))


def test_a_controller_of_ones_own_moves_the_arm() -> None:
    scenario = small_scenario(*BLIND)
    loop = make_closed_loop(scenario, controller=Nod(scenario.twin.home))
    assert len(repr(loop)) < 500 and loop.model.joints[0] in repr(loop.twin)  # a notebook shows it
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(0.75)
    twin = loop.twin.diagram
    own = twin.GetMyContextFromRoot(simulator.get_context())
    q = np.array(twin.GetOutputPort("arm_state").Eval(own))[:N]
    moved = q - np.array(scenario.twin.home)
    assert moved[5] == pytest.approx(0.2 * np.sin(1.5), abs=0.03)
    assert np.abs(np.delete(moved, 5)).max() < 0.02
    assert loop.twin.mpc is None
    np.testing.assert_array_equal(twin.GetOutputPort("arm.torque_commanded").Eval(own), np.zeros(N))
    assert twin.GetOutputPort("plan").size() == N
    number = loop.twin.add_model(loop.model)
    loop.twin.use_model(twin.GetMyMutableContextFromRoot(simulator.get_mutable_context()), number)


def test_a_perception_of_ones_own_fills_the_scene(egl: None) -> None:
    scenario = small_scenario()
    pose = np.array([1.0, 0.0, 0.0, 0.0, 0.5, 0.1, 0.05])
    loop = make_closed_loop(scenario, perception=Told([pose] * len(scenario.twin.library)))
    assert not any("icp" in system.get_name() for system in loop.twin.diagram.GetSystems())
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(0.3)
    twin = loop.twin.diagram
    tracks = np.array(twin.GetOutputPort("tracks").Eval(twin.GetMyContextFromRoot(simulator.get_context())))
    for row in tracks.reshape(len(scenario.twin.library), -1):
        track = Track.unpack(row)
        assert track.status == ObjectStatus.TRACKED
        np.testing.assert_allclose(track.pose, pose, atol=1e-6)


def ids_by_height(rgb: Any, depth: Any, K: Any, X_WC: Any, prior_ids: Any) -> tuple[Any, Any]:
    """A segmenter: whatever hangs together in the image 1 cm above the table."""
    v, u = np.indices(depth.shape)
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(depth.shape)], axis=-1)
    z = depth * (rays @ X_WC[:3, :3].T)[..., 2] + X_WC[2, 3]
    assert rgb.shape == (*depth.shape, 3) and prior_ids.shape == depth.shape
    return cv2.connectedComponents(((depth > 0) & (z > 0.01)).astype(np.uint8))[1], 1.0


def status_of_all(segmenter: Any) -> tuple[list[ObjectStatus], float]:
    """What becomes of the objects in 0.4 s, and how far the first one is off [m]."""
    scenario = small_scenario()
    loop = make_closed_loop(scenario, segmenter=segmenter)
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(0.4)
    twin = loop.twin.diagram
    rows = np.array(twin.GetOutputPort("tracks").Eval(twin.GetMyContextFromRoot(simulator.get_context())))
    tracks = [Track.unpack(row) for row in rows.reshape(len(scenario.twin.library), -1)]
    true = scenario.world.objects["can"].X_WO.translation
    return [track.status for track in tracks], float(np.linalg.norm(tracks[0].pose[4:] - np.array(true)))


@pytest.mark.long
def test_a_segmenter_of_ones_own_takes_images_apart(egl: None) -> None:
    seen, off = status_of_all(ids_by_height)
    assert seen == 2 * [ObjectStatus.TRACKED] and off < 2e-3
    unseen, _ = status_of_all(lambda rgb, depth, *_: (np.zeros(depth.shape, int), 1.0))
    assert ObjectStatus.TRACKED not in unseen


def test_a_segmenter_that_nothing_would_ask_is_refused() -> None:
    for overrides, own, said in (
        (BLIND, {"segmenter": ids_by_height}, "twin.camera is null"),
        ((), {"segmenter": ids_by_height, "perception": Declared({}, {"object_poses": 90})}, "give one of them"),
        ((), {"segmenter": "net.onnx"}, "'net.onnx' is no function"),
    ):
        with pytest.raises(TwinError, match=r"^segmenter: ") as caught:
            make_twin(small_scenario(*overrides).twin, **own)
        assert said in str(caught.value)


def in_another_diagram(system: Declared) -> Declared:
    builder = DiagramBuilder()
    builder.AddSystem(system)
    builder.Build()
    return system


@pytest.mark.parametrize(
    ("controller", "said"),
    [
        (lambda: Declared({}, {}), "no output port 'position_commanded'"),
        (lambda: Declared({}, {"position_commanded": 6}), "'position_commanded' has 6 numbers, the twin's has 7"),
        (lambda: Declared({"arm_state": 7}, {"position_commanded": 7}), "'arm_state' has 7 numbers, the twin's has 14"),
        (lambda: Declared({"state": 14}, {"position_commanded": 7}), "'state' is none that the twin can feed"),
        (lambda: Declared({}, {"position_commanded": 7, "torque_commanded": 1}), "'torque_commanded' has 1 numbers"),
        (lambda: object(), "is no Drake System"),
        (lambda: in_another_diagram(Declared({}, {"position_commanded": 7})), "part of another Diagram already"),
    ],
)
def test_a_controller_that_does_not_fit_is_refused_by_the_ports_name(controller: Callable[[], Any], said: str) -> None:
    with pytest.raises(TwinError, match=r"^controller: ") as caught:
        make_twin(small_scenario(*BLIND).twin, controller=controller())
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("perception", "said"),
    [
        (lambda: Declared({}, {}), "no output port 'object_poses'"),
        (lambda: Declared({}, {"object_poses": 45}), "'object_poses' has 45 numbers, the twin's has 90"),
        (lambda: Declared({"rgb_image": 3}, {"object_poses": 90}), "'rgb_image' must be a value"),
        (lambda: ConstantVectorSource(np.zeros(90)), "no output port 'object_poses'"),
    ],
)
def test_a_perception_that_does_not_fit_is_refused_by_the_ports_name(perception: Callable[[], Any], said: str) -> None:
    with pytest.raises(TwinError, match=r"^perception: ") as caught:
        make_twin(small_scenario().twin, perception=perception())
    assert said in str(caught.value)


class Markers(LeafSystem):
    """Poses from elsewhere, without any image: one object slides along x at 0.1 m/s."""

    def __init__(self, objects: int) -> None:
        super().__init__()
        self.objects = objects
        self.DeclareVectorOutputPort("object_poses", MEASUREMENT_SIZE * objects, self.calc)
        self.DeclareVectorOutputPort("image_time", 1, lambda context, output: output.SetFromVector([self.at(context)]))

    def at(self, context: Context) -> float:
        return float(np.floor(30.0 * context.get_time() + 1e-9) / 30.0)

    def calc(self, context: Context, output: BasicVector) -> None:
        t = self.at(context)
        pose = np.array([1.0, 0.0, 0.0, 0.0, 0.5 + 0.1 * t, 0.1, 0.05])
        output.SetFromVector(np.tile(PoseMeasurement(1.0, t, pose, 1e-8 * np.eye(6)).pack(), self.objects))


@pytest.mark.long
def test_poses_from_elsewhere_need_no_camera() -> None:
    scenario = small_scenario(*BLIND)
    loop = make_closed_loop(scenario, perception=Markers(len(scenario.twin.library)))
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(1.0)
    twin = loop.twin.diagram
    context = twin.GetMyContextFromRoot(simulator.get_context())
    track = Track.unpack(np.array(twin.GetOutputPort("tracks").Eval(context))[:TRACK_SIZE])
    assert track.status in (ObjectStatus.TRACKED, ObjectStatus.MOVING) and loop.twin.lacking(context) == []
    np.testing.assert_allclose(track.pose[4:], [0.6, 0.1, 0.05], atol=3e-3)


class Seer(Markers):
    """Tells of an unknown cube, besides."""

    def __init__(self, objects: int, unknown: int) -> None:
        super().__init__(objects)
        corners = np.array([[x, y, z] for x in (0.4, 0.5) for y in (-0.4, -0.3) for z in (0.0, 0.1)])
        cube = Thing(1, ObjectStatus.TRACKED, 0.0, 0.0, corners.mean(axis=0), (corners,)).pack()
        rows = np.concatenate([cube, np.zeros((unknown - 1) * len(cube))])
        self.DeclareVectorOutputPort("things", len(rows), lambda context, output: output.SetFromVector(rows))


@pytest.mark.long
def test_whoever_steps_a_simulator_has_unknown_things_in_the_scene_by_a_monitor() -> None:
    scenario = small_scenario(*BLIND)
    loop = make_closed_loop(scenario, perception=Seer(len(scenario.twin.library), scenario.twin.slots.unknown))
    scene, query = loop.twin.scene.scene_graph, loop.twin.diagram.GetOutputPort("query_object")
    hanging = []
    for monitored in (False, True):
        simulator = Simulator(loop.diagram)
        if monitored:
            simulator.set_monitor(loop.twin.scene_monitor())
        simulator.AdvanceTo(0.2)
        inspector = query.Eval(loop.twin.diagram.GetMyContextFromRoot(simulator.get_context())).inspector()
        hanging.append(inspector.num_geometries() - scene.model_inspector().num_geometries())
    assert hanging[0] == 0 < hanging[1]  # and each Context has its own


def test_poses_without_images_tell_when_they_were_measured() -> None:
    with pytest.raises(TwinError, match="no output port 'image_time'"):
        make_twin(small_scenario(*BLIND).twin, perception=Declared({}, {"object_poses": 90}))
    with pytest.raises(TwinError, match="'rgb_image' is none that the twin can feed"):
        own = Declared({"rgb_image": 3}, {"object_poses": 90, "image_time": 1})
        make_twin(small_scenario(*BLIND).twin, perception=own)


class Driver(LeafSystem):
    """A station in a few lines: an arm that stands still and tells so every 5 ms, without torque."""

    def __init__(self, home: list[float], left_out: str = "", n: int = N) -> None:
        super().__init__()
        self.home = np.array(home)
        self.DeclareVectorInputPort("arm.position_commanded", n)
        values = {
            "arm.position_measured": lambda t: self.home,
            "arm.velocity_estimated": lambda t: np.zeros(N),
            "arm.torque_measured": lambda t: np.zeros(N),
            "arm.measurement_time": lambda t: [np.floor(200.0 * t + 1e-9) / 200.0],
            "gripper.state_measured": lambda t: np.zeros(4),
            "spindle.temperature": lambda t: [20.0],
        }
        for name, value in values.items():
            if name != left_out:

                def calc(context: Context, output: BasicVector, value: Callable[[float], Any] = value) -> None:
                    output.SetFromVector(np.array(value(context.get_time())))

                self.DeclareVectorOutputPort(name, len(value(0.0)), calc, {self.time_ticket()})


def test_a_station_of_ones_own_is_watched_and_run(tmp_path: Path) -> None:
    scenario = small_scenario(*BLIND, "duration=0.3")
    home = scenario.twin.home
    told = run_scenario(scenario, station=Driver(home), record=tmp_path / "rec", quiet=True, say=lambda text: None)
    np.testing.assert_allclose(list(told["joints"].values()), home, atol=1e-3)
    assert told["health"] == [] and "objects" in told
    again = replay_log(tmp_path / "rec", say=lambda text: None)
    assert again["joints"] == told["joints"]


@pytest.mark.parametrize(
    ("station", "said"),
    [
        (lambda home: Driver(home, left_out="arm.torque_measured"), "no output port 'arm.torque_measured'"),
        (lambda home: Driver(home, n=6), "'arm.position_commanded' has 6 numbers, the twin's has 7"),
        (lambda home: Declared({"arm.speed_commanded": 7}, {}), "'arm.speed_commanded' is none that the twin can feed"),
        (lambda home: home, "is no Drake System"),
    ],
)
def test_a_station_that_does_not_fit_is_refused_by_the_ports_name(station: Callable[[Any], Any], said: str) -> None:
    scenario = small_scenario(*BLIND)
    with pytest.raises(TwinError, match=r"^station: ") as caught:
        make_closed_loop(scenario, station=station(scenario.twin.home))
    assert said in str(caught.value)
