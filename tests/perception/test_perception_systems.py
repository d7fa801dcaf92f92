"""The two systems in a Diagram: ports, timing, state; and their accuracy on rendered images of the whole scene."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from pydrake.common.value import AbstractValue, Value
from pydrake.common.yaml import yaml_dump_typed
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from tests.synthetic_scene import Thing, picture, yawed
from twin_diagram import scenario
from twin_diagram.assets import Asset
from twin_diagram.assets.description import AssetSpec, CollisionShape, sdf, solid_inertia
from twin_diagram.assets.mesh import Mesh, sample
from twin_diagram.perception import IcpPoseEstimator, PerceptionSystem, Segments
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.rotation import from_quaternion, log
from twin_diagram.perception.registration.slots import SLOT_SIZE, Slot
from twin_diagram.perception.registration.tracking import step
from twin_diagram.perception.registration.view import Known
from twin_diagram.perception.segmentation.robot_shape import RobotShape
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.layouts import MEASUREMENT_SIZE, NEVER, PoseMeasurement

Array = npt.NDArray[np.float64]

CAMERA = scenario.Camera(
    X_WC=scenario.Pose(translation=[1.4, 0.0, 0.85], rpy=[-2.2689, 0.0, np.pi / 2]), rate=15.0, latency=0.035
)
VIEW = Pinhole.from_scenario(CAMERA)
Q = np.array([0.3, 0.1, 0.0, -2.0, 0.0, 2.1, 0.785])


def asset(name: str) -> Asset:
    return Asset.load(models_dir() / "objects" / name)


@pytest.fixture(scope="module")
def library() -> dict[str, Asset]:
    return {name: asset(name) for name in ("sugar_box", "can")}


def things_at(library: dict[str, Asset], time: float) -> list[Thing]:
    box, can = library["sugar_box"], library["can"]
    x = 0.5 + 0.1 * max(time, 0.0)
    return [
        Thing(box, 7, yawed(0.4), np.array([x, -0.2, box.size[2] / 2])),
        Thing(can, 5, np.eye(3), np.array([0.6, 0.15, can.size[2] / 2])),
    ]


def images(rgb: npt.NDArray[np.uint8], depth: npt.NDArray[np.float32]) -> tuple[ImageRgba8U, ImageDepth32F]:
    colour, range_ = ImageRgba8U(640, 480), ImageDepth32F(640, 480)
    colour.mutable_data[..., :3] = rgb
    colour.mutable_data[..., 3] = 255
    range_.mutable_data[..., 0] = depth
    return colour, range_


class Film(LeafSystem):
    """A camera that shows pictures: k / rate, delivered `latency` later."""

    def __init__(self, frames: list[tuple[ImageRgba8U, ImageDepth32F]]) -> None:
        super().__init__()
        self._frames = frames
        blank = (ImageRgba8U(640, 480), ImageDepth32F(640, 480))
        self._blank = blank
        for name, k in (("rgb_image", 0), ("depth_image", 1)):
            self.DeclareAbstractOutputPort(
                name,
                lambda k=k: AbstractValue.Make(blank[k]),
                lambda context, output, k=k: output.set_value(self._frame(context)[k]),
                prerequisites_of_calc={self.time_ticket()},
            )
        self.DeclareVectorOutputPort(
            "image_time",
            1,
            lambda context, output: output.SetAtIndex(0, self._time(context)),
            prerequisites_of_calc={self.time_ticket()},
        )

    def _index(self, context: Context) -> int:
        return int(np.floor((context.get_time() - CAMERA.latency) * CAMERA.rate + 1e-9))

    def _frame(self, context: Context) -> tuple[Any, Any]:
        k = self._index(context)
        return self._blank if k < 0 else self._frames[min(k, len(self._frames) - 1)]

    def _time(self, context: Context) -> float:
        k = min(self._index(context), len(self._frames) - 1)
        return NEVER if k < 0 else k / CAMERA.rate


def loop(library: dict[str, Asset], frames: list[tuple[ImageRgba8U, ImageDepth32F]]) -> Diagram:
    builder = DiagramBuilder()
    film = builder.AddSystem(Film(frames))
    arm = builder.AddSystem(ConstantVectorSource(np.concatenate([Q, np.zeros(7)])))
    perception = builder.AddNamedSystem(
        "perception", PerceptionSystem(scenario.ArmModel(), CAMERA, scenario.Perception())
    )
    poses = builder.AddNamedSystem("poses", IcpPoseEstimator(library, CAMERA, scenario.Registration()))
    for name in ("rgb_image", "depth_image", "image_time"):
        builder.Connect(film.GetOutputPort(name), perception.GetInputPort(name))
    builder.Connect(arm.get_output_port(), perception.GetInputPort("arm_state"))
    builder.Connect(perception.GetOutputPort("segments"), poses.GetInputPort("segments"))
    builder.ExportOutput(poses.GetOutputPort("object_poses"), "object_poses")
    builder.ExportOutput(perception.GetOutputPort("segments"), "segments")
    return builder.Build()


@pytest.fixture(scope="module")
def film(library: dict[str, Asset]) -> list[tuple[ImageRgba8U, ImageDepth32F]]:
    out = []
    for k in range(4):
        rgb, depth, _ = picture(VIEW, things_at(library, k / CAMERA.rate), np.random.default_rng(k))
        out.append(images(rgb, depth))
    return out


@pytest.fixture(scope="module")
def diagram(library: dict[str, Asset], film: list[tuple[ImageRgba8U, ImageDepth32F]]) -> Diagram:
    return loop(library, film)


def measured(diagram: Diagram, context: Context) -> list[PoseMeasurement]:
    vector = np.array(diagram.GetOutputPort("object_poses").Eval(context))
    return [PoseMeasurement.unpack(part) for part in vector.reshape(-1, MEASUREMENT_SIZE)]


def test_ports_and_state(diagram: Diagram) -> None:
    perception, poses = diagram.GetSubsystemByName("perception"), diagram.GetSubsystemByName("poses")
    names = [perception.get_input_port(k).get_name() for k in range(perception.num_input_ports())]
    assert names == ["rgb_image", "depth_image", "image_time", "arm_state", "calibration", "gripper_state", "hand"]
    assert poses.GetOutputPort("object_poses").size() == 2 * MEASUREMENT_SIZE
    # Memory is a vector, and the output does not hang on the input directly.
    assert not poses.HasAnyDirectFeedthrough()
    context = poses.CreateDefaultContext()
    assert context.num_abstract_states() == 0 and context.num_continuous_states() == 0
    assert context.get_discrete_state(0).size() == 2 * SLOT_SIZE
    assert perception.CreateDefaultContext().num_total_states() == 0
    for system in (perception, poses):
        assert ".. pydrake_system::" in (type(system).__doc__ or "")


def test_nothing_before_the_first_image(diagram: Diagram) -> None:
    context = diagram.CreateDefaultContext()
    segments = diagram.GetOutputPort("segments").Eval(context)
    assert isinstance(segments, Segments) and segments.time == NEVER and segments.count == 0
    Simulator(diagram, context).AdvanceTo(0.034)
    for one in measured(diagram, context):
        assert one.quality == 0.0 and one.time == NEVER


def test_poses_come_one_millisecond_after_the_image(diagram: Diagram, library: dict[str, Asset]) -> None:
    context = diagram.CreateDefaultContext()
    simulator = Simulator(diagram, context)
    for k in range(4):
        delivered = k / CAMERA.rate + CAMERA.latency
        simulator.AdvanceTo(delivered + 0.0005)
        assert measured(diagram, context)[0].time == (NEVER if k == 0 else (k - 1) / CAMERA.rate)
        simulator.AdvanceTo(delivered + 0.0015)
        for one, thing in zip(measured(diagram, context), things_at(library, k / CAMERA.rate), strict=True):
            assert one.time == k / CAMERA.rate and one.quality > 0.8
            assert np.linalg.norm(one.pose[4:] - thing.p) < 1.5e-3
            assert np.linalg.eigvalsh(one.covariance).min() > 0
    # The last picture stays: nothing new is measured.
    before = [one.pack() for one in measured(diagram, context)]
    simulator.AdvanceTo(0.4)
    assert all(np.array_equal(a, b.pack()) for a, b in zip(before, measured(diagram, context), strict=True))


def test_two_contexts_do_not_know_of_each_other(diagram: Diagram) -> None:
    def run(simulators: list[Simulator]) -> None:
        for end in (0.04, 0.11, 0.18):
            for simulator in simulators:
                simulator.AdvanceTo(end)

    alone = Simulator(diagram)
    run([alone])
    pair = [Simulator(diagram), Simulator(diagram)]
    pair[0].AdvanceTo(0.11)
    late = pair[1]
    run([late])
    pair[0].AdvanceTo(0.18)
    results = [np.array(diagram.GetOutputPort("object_poses").Eval(s.get_context())) for s in (alone, *pair)]
    assert np.array_equal(results[0], results[1]) and np.array_equal(results[0], results[2])


@pytest.mark.parametrize("late", [0.0, 0.5])
def test_the_robot_is_posed_when_the_image_was_taken(late: float) -> None:
    """x̂ is now, the image is older: an arm that turns fast must still be cut out where it was.

    Depth may be half a frame older yet.
    """
    perception = PerceptionSystem(scenario.ArmModel(), CAMERA, scenario.Perception())
    robot = perception._robot
    probe = np.random.default_rng(2).uniform([0.1, -0.4, 0.1], [0.8, 0.5, 0.6], (20000, 3))
    speed = np.zeros(7)
    speed[0] = 2.0
    shown = Q - late / CAMERA.rate * speed
    inside = probe[robot.near(probe, shown, -0.01)]
    rgb, depth, _ = picture(VIEW, [], balls=[(centre, 0.02) for centre in inside[:40]])
    context = perception.CreateDefaultContext()
    colour, range_ = images(rgb, depth)
    perception.GetInputPort("rgb_image").FixValue(context, Value[ImageRgba8U](colour))
    perception.GetInputPort("depth_image").FixValue(context, Value[ImageDepth32F](range_))
    perception.GetInputPort("image_time").FixValue(context, [1.0])
    delay = 0.2
    context.SetTime(1.0 + delay)
    perception.GetInputPort("arm_state").FixValue(context, np.concatenate([Q + delay * speed, speed]))
    found = perception.GetOutputPort("segments").Eval(context)
    assert found.count == 0 and (found.label_image == SEGMENTS.robot).sum() > 100
    perception.GetInputPort("arm_state").FixValue(context, np.concatenate([Q + delay * speed, np.zeros(7)]))
    wrong = perception.GetOutputPort("segments").Eval(context)
    assert wrong.count > 0 and found.count == 0


def test_empty_library() -> None:
    poses = IcpPoseEstimator({}, CAMERA, scenario.Registration())
    assert poses.GetOutputPort("object_poses").size() == 0
    context = poses.CreateDefaultContext()
    poses.GetInputPort("segments").FixValue(context, AbstractValue.Make(Segments.empty(VIEW, 2)))
    poses.ForcedPublish(context)
    assert poses.EvalUniquePeriodicDiscreteUpdate(context).num_groups() >= 1


# --- The whole scene, rendered --------------------------------------------------------------------------------------


class Studio:
    """Table, Panda and objects before Drake's renderer; poses may be set at will."""

    def __init__(self, objects: dict[str, RigidTransform], files: dict[str, Path] | None = None) -> None:
        from pydrake.geometry import (
            Box,
            ClippingRange,
            ColorRenderCamera,
            DepthRange,
            DepthRenderCamera,
            MakeRenderEngineVtk,
            RenderCameraCore,
            RenderEngineVtkParams,
        )
        from pydrake.multibody.parsing import Parser
        from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
        from pydrake.systems.sensors import CameraInfo, RgbdSensor

        from twin_diagram.model.description.add_arm import add_arm
        from twin_diagram.scenario.poses import pose

        builder = DiagramBuilder()
        self.plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
        scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(RenderEngineVtkParams()))
        self.plant.RegisterVisualGeometry(
            self.plant.world_body(),
            RigidTransform([0.5, 0.0, -0.025]),
            Box(1.6, 1.6, 0.05),
            "table",
            [0.5, 0.4, 0.3, 1],
        )
        self.arm = add_arm(self.plant, scenario.ArmModel())
        parser = Parser(self.plant)
        parser.SetAutoRenaming(True)
        self.bodies = {}
        for name in objects:
            (model,) = parser.AddModels(str(files[name] if files else asset(name).model_file))
            self.bodies[name] = self.plant.GetBodyByName("object", model)
        self.plant.Finalize()
        # Drake's renderer counts the principal point from the corner of the first pixel, not from its centre.
        info = CameraInfo(640, 480, 600.0, 600.0, 320.0, 240.0)
        core = RenderCameraCore("vtk", info, ClippingRange(0.05, 5.0), RigidTransform())
        self.sensor = builder.AddSystem(
            RgbdSensor(
                scene_graph.world_frame_id(),
                pose(CAMERA.X_WC),
                ColorRenderCamera(core),
                DepthRenderCamera(core, DepthRange(0.2, 3.0)),
            )
        )
        builder.Connect(scene_graph.get_query_output_port(), self.sensor.query_object_input_port())
        self.diagram = builder.Build()
        self.context = self.diagram.CreateDefaultContext()
        self.plant_context = self.plant.GetMyMutableContextFromRoot(self.context)
        for name, X_WO in objects.items():
            self.place(name, X_WO)

    def place(self, name: str, X_WO: RigidTransform) -> None:
        self.plant.SetFreeBodyPose(self.plant_context, self.bodies[name], X_WO)

    def pose_arm(self, q: Array) -> None:
        for index, angle in zip(self.arm.joint_indices, q, strict=True):
            self.plant.get_joint(index).set_angle(self.plant_context, angle)

    def shoot(self, rng: np.random.Generator) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
        context = self.sensor.GetMyContextFromRoot(self.context)
        rgb = self.sensor.color_image_output_port().Eval(context).data[..., :3].astype(float)
        depth = self.sensor.depth_image_32F_output_port().Eval(context).data[..., 0].astype(float)
        depth[~np.isfinite(depth)] = 0.0
        edge = np.zeros(depth.shape, dtype=bool)
        for axis in (0, 1):
            for way in (-1, 1):
                edge |= np.abs(np.roll(depth, way, axis) - depth) > 0.015 * depth
        lost = (edge & (rng.random(depth.shape) < 0.5)) | (depth == 0)
        depth = depth * (1.0 + 0.0008 * depth * rng.standard_normal(depth.shape))
        depth = np.where(lost, 0.0, np.round(depth / 0.00025) * 0.00025)
        rgb = np.clip(np.round(rgb + 2.0 * rng.standard_normal(rgb.shape)), 0, 255)
        return rgb.astype(np.uint8), depth.astype(np.float32)


def score(
    names: list[str], found: list[PoseMeasurement], truth: Callable[[str], RigidTransform]
) -> dict[str, tuple[float, float, float]]:
    """Quality, position error [mm], rotation error [deg] by name; of a symmetric object that of its axis."""
    result = {}
    for name, one in zip(names, found, strict=True):
        X_WO = truth(name)
        R, true = from_quaternion(one.pose[:4]), X_WO.rotation().matrix()
        if asset(name).symmetric_axis == "z":
            angle = float(np.arccos(np.clip(R[:, 2] @ true[:, 2], -1.0, 1.0)))
        else:
            angle = float(np.linalg.norm(log(R @ true.T)))
        result[name] = (
            one.quality,
            1e3 * float(np.linalg.norm(one.pose[4:] - X_WO.translation())),
            float(np.degrees(angle)),
        )
    return result


PLACES = {
    "cracker_box": (0.42, 0.38),
    "sugar_box": (0.42, -0.2),
    "gelatin_box": (0.6, -0.15),
    "can": (0.55, 0.05),
    "mug": (0.62, 0.25),
    "bottle": (0.5, -0.38),
    "mover": (0.66, -0.02),
}


@pytest.mark.usefixtures("egl")
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_rendered_scene_is_tracked(seed: int) -> None:
    """Seven objects at any yaw, a moving one, an arm that hides some of them; all defects of a real camera."""
    rng = np.random.default_rng(seed)
    yaw = {name: rng.uniform(-np.pi, np.pi) for name in PLACES}

    def truth(name: str, k: int) -> RigidTransform:
        x, y = PLACES[name]
        turn = yaw[name]
        if name == "mover":
            x, y, turn = x - 0.012 * k, y - 0.004 * k, turn + 0.02 * k
        return RigidTransform(RollPitchYaw(0.0, 0.0, turn), [x, y, asset(name).size[2] / 2])

    studio = Studio({name: truth(name, 0) for name in PLACES})
    names = list(PLACES)
    estimator = IcpPoseEstimator({name: asset(name) for name in names}, CAMERA, scenario.Registration())
    perception = PerceptionSystem(scenario.ArmModel(), CAMERA, scenario.Perception())
    builder = DiagramBuilder()
    count = 6
    frames = []
    for k in range(count):
        studio.place("mover", truth("mover", k))
        studio.pose_arm(Q)
        frames.append(images(*studio.shoot(rng)))
    film = builder.AddSystem(Film(frames))
    arm = builder.AddSystem(ConstantVectorSource(np.concatenate([Q, np.zeros(7)])))
    for system in (perception, estimator):
        builder.AddSystem(system)
    for name in ("rgb_image", "depth_image", "image_time"):
        builder.Connect(film.GetOutputPort(name), perception.GetInputPort(name))
    builder.Connect(arm.get_output_port(), perception.GetInputPort("arm_state"))
    builder.Connect(perception.GetOutputPort("segments"), estimator.GetInputPort("segments"))
    builder.ExportOutput(estimator.GetOutputPort("object_poses"), "object_poses")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    scores: dict[str, list[tuple[float, float, float]]] = {name: [] for name in names}
    for k in range(count):
        simulator.AdvanceTo(k / CAMERA.rate + CAMERA.latency + 0.002)
        found = measured(diagram, simulator.get_context())
        for name, one in score(names, found, lambda name, k=k: truth(name, k)).items():
            scores[name].append(one)
    for name, rows in scores.items():
        table = np.array(rows)
        assert (table[:, 0] > 0.6).all(), (name, table)
        assert np.median(table[:, 1]) < 1.0 and np.median(table[:, 2]) < 1.5, (name, table)
        assert table[:, 1].max() < 5.0 and table[:, 2].max() < 5.0, (name, table)


# --- Real, scanned objects -------------------------------------------------------------------------------------------

SCANS = {
    "003_cracker_box": (0.42, 0.3),
    "004_sugar_box": (0.42, -0.2),
    "005_tomato_soup_can": (0.6, 0.05),
    "006_mustard_bottle": (0.5, -0.35),
    "009_gelatin_box": (0.62, -0.15),
    "010_potted_meat_can": (0.62, 0.25),
}


def scan_to_asset(file: Path, folder: Path) -> Path:
    """An asset from a scanned, textured glTF mesh (Y up), its frame moved to the geometric centre."""
    scan = trimesh.load(str(file), force="mesh")
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    vertices = np.asarray(scan.vertices) @ turn.T
    centre = (vertices.max(axis=0) + vertices.min(axis=0)) / 2
    size = [float(x) for x in np.ptp(vertices, axis=0)]
    material = scan.visual.material
    texture = np.asarray(material.baseColorTexture.convert("RGB"))
    mesh = Mesh(
        vertices - centre, np.asarray(scan.vertex_normals) @ turn.T, np.asarray(scan.visual.uv), np.asarray(scan.faces)
    )
    cloud = sample(mesh, texture, 3000)
    folder.mkdir()
    np.savez(folder / "cloud.npz", points=cloud.points, normals=cloud.normals, colours=cloud.colours)
    spec = AssetSpec(folder.name, "scan", size, 0.4, None, 0, solids=[CollisionShape("box", size)])
    place = "<pose>{:.6f} {:.6f} {:.6f} 0 0 0</pose>".format(*-centre)
    model = sdf(spec, np.zeros(3), solid_inertia(spec)).replace(
        f"<geometry><mesh><uri>{spec.visual}</uri>", f"{place}<geometry><mesh><uri>{file}</uri>"
    )
    (folder / "model.sdf").write_text(model)
    (folder / "asset.yaml").write_text(yaml_dump_typed(spec))
    return folder


@pytest.mark.usefixtures("egl")
@pytest.mark.parametrize(("name", "offset", "least"), [("sugar_box", 0.0, 0.9), ("can", 0.055, 0.9)])
def test_a_thing_in_the_hand_is_seen(name: str, offset: float, least: float) -> None:
    """Between the fingers, or touching them; the arm itself stays the arm, also with its model a centimetre off."""
    studio = Studio({name: RigidTransform([0.0, 0.0, -3.0])})
    studio.pose_arm(Q)
    _, bare = studio.shoot(np.random.default_rng(1))
    X_WT = studio.plant.GetFrameByName("panda_tcp").CalcPoseInWorld(studio.plant_context)
    held = X_WT if not offset else RigidTransform(X_WT.translation() + [0.0, offset, -0.02])
    studio.place(name, held)
    rgb, depth = studio.shoot(np.random.default_rng(2))
    on = ((depth > 0) & (bare > 0) & (bare - depth > 0.012))[::2, ::2]
    arm = ((bare > 0) & (VIEW.p_WC[2] + bare * VIEW.rays()[..., 2] > 0.012))[::2, ::2] & ~on
    robot = RobotShape(scenario.ArmModel())
    for wrong, share in ((0.0, least), (0.01, 0.7)):
        found = segment(
            rgb,
            depth,
            0.0,
            Grid.of(VIEW, 2),
            scenario.Perception(),
            lambda points, margin, off=wrong: robot.near(points - [off, 0.0, 0.0], Q, margin),  # type: ignore[misc]
        )
        assert found.count == 1 and (found.label_image[on] == 0).mean() > share, wrong
        assert (found.label_image[arm] >= 0).mean() < 0.002 and arm.sum() > 5000
    nothing = segment(
        rgb, bare, 0.0, Grid.of(VIEW, 2), scenario.Perception(), lambda points, margin: robot.near(points, Q, margin)
    )
    assert nothing.count == 0


@pytest.mark.long
@pytest.mark.usefixtures("egl")
def test_scanned_objects_are_found(data_dir: Path, tmp_path: Path) -> None:
    """Real textures and shapes, which this project did not make."""
    files = {name: data_dir / "ycb" / f"{name}_textured.gltf" for name in SCANS}
    if not all(file.is_file() for file in files.values()):
        pytest.skip(f"no scanned objects in {data_dir / 'ycb'}")
    assets = {name: Asset.load(scan_to_asset(file, tmp_path / f"scan_{name}")) for name, file in files.items()}
    rng = np.random.default_rng(0)
    poses = {
        name: RigidTransform(RollPitchYaw(0.0, 0.0, rng.uniform(-np.pi, np.pi)), [x, y, assets[name].size[2] / 2])
        for name, (x, y) in SCANS.items()
    }
    studio = Studio(poses, {name: one.model_file for name, one in assets.items()})
    studio.pose_arm(Q)
    known = [Known.of(ModelCloud.of(one, scenario.Registration().model_points)) for one in assets.values()]
    slots = [Slot() for _ in known]
    robot = RobotShape(scenario.ArmModel())
    for k in range(3):
        rgb, depth = studio.shoot(rng)
        segments = segment(
            rgb, depth, k / 15, Grid.of(VIEW, 2), scenario.Perception(), lambda p, margin: robot.near(p, Q, margin)
        )
        slots, found, _ = step(known, slots, segments, scenario.Registration(), 60)
    for (name, X_WO), one in zip(poses.items(), found, strict=True):
        assert one.quality > 0.8, name
        assert np.linalg.norm(one.pose[4:] - X_WO.translation()) < 1e-3, name
        assert np.linalg.norm(log(from_quaternion(one.pose[:4]) @ X_WO.rotation().matrix().T)) < np.radians(1.5), name
