"""Recording and replay: a recorded run is shown again to the bit; damaged and foreign recordings are refused."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, DiscreteValues, LeafSystem, PortDataType

from twin_diagram.errors import LogError, ScenarioError, StationError
from twin_diagram.logs import read_log
from twin_diagram.runs.replayed import replay_scenario
from twin_diagram.scenario import Camera, CameraDefects, DepthCamera, Fixture, Pose, Scenario, WayPoint, WorldObject
from twin_diagram.scenario.file import load_scenario, save_scenario
from twin_diagram.station import make_station, ports
from twin_diagram.station.replay.recorder import add_recorder, open_recording
from twin_diagram.station.replay.recording import RecordingWriter
from twin_diagram.station.replay.recording_folder import Manifest, RecordedCamera
from twin_diagram.station.replay.station import newest

HOME = [0.3, 0.2, -0.1, -2.0, 0.1, 2.2, 0.9]
JOINTS = [f"panda_joint{k}" for k in range(1, 8)]


def scenario(camera: bool = True) -> Scenario:
    plan = Scenario(seed=8)
    path = [WayPoint(0.0, Pose([0.7, -0.2, 0.12])), WayPoint(0.5, Pose([0.6, 0.1, 0.12]))]
    plan.world.fixtures = [Fixture("scenes/table.sdf")]
    plan.world.objects = {"mover": WorldObject("objects/mover", path=path)}
    plan.world.camera_defects.covered = [[0.25, 0.3]]
    plan.twin.home = list(HOME)
    pose = Pose([1.4, 0.0, 0.85], [-2.2689, 0.0, 1.5708])
    plan.twin.camera = Camera(X_WC=pose, width=80, height=60, focal=75.0) if camera else None
    return plan


class Wave(LeafSystem):
    """A command."""

    def __init__(self) -> None:
        super().__init__()
        self.DeclareVectorOutputPort("command", 7, self._calc, {self.time_ticket()})

    def _calc(self, context: Context, output: BasicVector) -> None:
        t = context.get_time()
        output.SetFromVector(np.array(HOME) + 0.2 * np.sin(4 * t) if t > 0.0512 else np.full(7, np.nan))


class Consumer(LeafSystem):
    """Looks at all ports at several rates, some of them at the very times at which messages come, and keeps digests."""

    def __init__(self, station) -> None:  # type: ignore[no-untyped-def]
        super().__init__()
        self.names = sorted(n for n in ports.output_names(station) if not n.startswith(ports.TRUTH))
        for name in self.names:
            port = station.GetOutputPort(name)
            if port.get_data_type() == PortDataType.kVectorValued:
                self.DeclareVectorInputPort(name, port.size())
            else:
                self.DeclareAbstractInputPort(name, port.Allocate())
        self.DeclareDiscreteState(1)
        for period, offset in ((0.005, 0.0), (0.0131, 0.0), (1 / 15, 0.035), (1 / 15, 0.036), (1 / 60, 0.0)):
            self.DeclarePeriodicDiscreteUpdateEvent(period, offset, self._look)
        self.seen: list[tuple[float, str]] = []

    def _look(self, context: Context, discrete: DiscreteValues) -> None:
        digest = hashlib.sha256()
        for name in self.names:
            value = self.GetInputPort(name).Eval(context)
            digest.update((value if isinstance(value, np.ndarray) else value.data).tobytes())
        self.seen.append((context.get_time(), digest.hexdigest()))


def run(plan: Scenario, duration: float = 0.5, record: Path | None = None, steps: int = 1) -> list[tuple[float, str]]:
    builder = DiagramBuilder()
    station = make_station(plan)
    builder.AddNamedSystem("station", station)
    wave, consumer = builder.AddSystem(Wave()), Consumer(station)
    builder.AddSystem(consumer)
    builder.Connect(wave.get_output_port(), station.GetInputPort(ports.POSITION_COMMANDED))
    for name in consumer.names:
        builder.Connect(station.GetOutputPort(name), consumer.GetInputPort(name))
    writer = None if record is None else open_recording(plan, record)
    if writer is not None:
        add_recorder(builder, station, writer, wave.get_output_port())
    simulator = Simulator(builder.Build())
    simulator.Initialize()
    for k in range(1, steps + 1):
        simulator.AdvanceTo(duration * k / steps)
    if writer is not None:
        writer.close()
    return consumer.seen


@pytest.fixture(scope="module")
def recorded(egl, tmp_path_factory) -> tuple[Path, list[tuple[float, str]]]:
    folder = tmp_path_factory.mktemp("recordings") / "run"
    return folder, run(scenario(), record=folder, steps=7)


def replaying(folder: Path, camera: bool = True) -> Scenario:
    plan = scenario(camera)
    plan.station, plan.replay.log = "replay", str(folder)
    return plan


def copy(folder: Path, to: Path) -> Path:
    import shutil

    return Path(shutil.copytree(folder, to / "copy"))


# To the bit.


def test_replay_shows_what_was_live_to_the_bit(recorded) -> None:
    folder, live = recorded
    assert len(live) > 150 and len({digest for _, digest in live}) > 100
    assert run(replaying(folder)) == live


def test_recording_changes_nothing_of_the_run(recorded) -> None:
    assert run(scenario()) == recorded[1]


def test_what_the_world_says_is_not_read(recorded) -> None:
    folder, live = recorded
    plan = replaying(folder)
    plan.seed = 99
    plan.world.objects = {"nonsense": WorldObject("nowhere")}
    plan.world.arm.model = "no.urdf"
    plan.world.q0 = [1.0]
    plan.world.time_step = -1.0
    plan.world.camera_defects.depth_unit = 0.3
    plan.world.X_WC = Pose([9.0, 9.0, 9.0])
    assert run(plan) == live


def test_a_recording_of_a_replay_is_the_same_again(recorded, tmp_path: Path) -> None:
    folder, live = recorded
    plan = replaying(folder)
    plan.world.camera_defects.depth_unit = 0.3
    assert run(plan, record=tmp_path / "again") == live
    assert run(replaying(tmp_path / "again")) == live


def test_recording_is_a_readable_log_with_pictures(recorded) -> None:
    folder, _ = recorded
    log = read_log(folder / "log.csv")
    assert log.joints == tuple(JOINTS)
    assert np.allclose(np.diff(log.time), 0.0025) and len(log) >= 199
    assert log.velocity is not None and log.torque is not None and log.position_commanded is not None
    held = log.time < 0.05
    assert np.array_equal(log.position_commanded[held], log.position[held])  # no command yet: it holds its pose
    assert np.allclose(log.position_commanded[-1], np.array(HOME) + 0.2 * np.sin(4 * 0.5), atol=0.01)
    images = sorted(path.name for path in (folder / "camera").iterdir())
    assert images[:2] == ["depth_000000.png", "depth_000001.png"] and "frames.csv" in images and len(images) == 15
    manifest = yaml.safe_load((folder / "manifest.yaml").read_text())
    assert manifest["camera"]["depth_unit"] == 0.00025 and manifest["joints"] == JOINTS
    assert not [path for path in folder.parent.iterdir() if path.name.startswith(".")]


def test_two_contexts_of_a_replay(recorded) -> None:
    station = make_station(replaying(recorded[0]))
    early, late = station.CreateDefaultContext(), station.CreateDefaultContext()
    names = [n for n in ports.output_names(station)]

    def outputs(context: Context, time: float) -> list[bytes]:
        context.SetTime(time)
        values = [station.GetOutputPort(n).Eval(context) for n in names]
        return [(v if isinstance(v, np.ndarray) else v.data).tobytes() for v in values]

    first = outputs(early, 0.15)
    outputs(late, 0.4)
    assert outputs(early, 0.15) == first != outputs(late, 0.4)
    assert outputs(late, 0.15) == first  # and back in time


def test_a_replay_without_the_camera(recorded) -> None:
    station = make_station(replaying(recorded[0], camera=False))
    ports.check(station, 7, 2, ())


@given(st.lists(st.floats(0, 10), min_size=1, max_size=30), st.floats(-1, 11))
def test_newest_is_what_came_before_now(times: list[float], now: float) -> None:
    delivery = np.sort(times)
    k = newest(delivery, now)
    assert k == -1 or delivery[k] < now
    assert k == len(delivery) - 1 or delivery[k + 1] >= now


# Bare logs.


def write_csv(path: Path, **changes) -> Path:  # type: ignore[no-untyped-def]
    t = 100.0 + 0.004 * np.arange(50)
    columns = {"time": t}
    for k, joint in enumerate(JOINTS):
        columns[f"position_measured.{joint}"] = HOME[k] + 0.1 * np.sin(t + k)
        columns[f"torque_measured.{joint}"] = 0.5 * np.cos(t + k)
    columns |= changes
    columns = {name: values for name, values in columns.items() if values is not None}
    rows = np.column_stack(list(columns.values()))
    path.write_text("\n".join([",".join(columns), *(",".join(map(repr, map(float, row))) for row in rows)]) + "\n")
    return path


def test_a_bare_log_is_played_from_its_first_sample(tmp_path: Path) -> None:
    plan = replaying(write_csv(tmp_path / "log.csv"))
    station = make_station(plan)
    ports.check(station, 7, 2, ("camera",))
    context = station.CreateDefaultContext()
    log = read_log(tmp_path / "log.csv")

    def read(name: str, time: float) -> np.ndarray:
        context.SetTime(time)
        return np.array(station.GetOutputPort(name).Eval(context))

    assert read(ports.MEASUREMENT_TIME, 0.0)[0] < 0
    assert read(ports.MEASUREMENT_TIME, 0.001)[0] == 0.0
    assert np.array_equal(read(ports.POSITION_MEASURED, 0.0225), log.position[5])
    assert np.array_equal(read(ports.TORQUE_MEASURED, 0.0225), log.torque[5])
    assert np.allclose(read(ports.VELOCITY_ESTIMATED, 0.0225), (log.position[5] - log.position[4]) / 0.004, rtol=1e-6)
    assert abs(read(ports.MEASUREMENT_TIME, 99.0)[0] - 49 * 0.004) < 1e-9
    assert read("camera.image_time", 99.0)[0] < 0
    assert np.isnan(read(ports.GRIPPER_MEASURED, 0.1)).all(), "the log does not tell"


def test_currents_are_played_as_torques(tmp_path: Path) -> None:
    torque = {f"torque_measured.{joint}": None for joint in JOINTS}
    current = {f"current_measured.{joint}": np.full(50, 0.1 * (k + 1)) for k, joint in enumerate(JOINTS)}
    log = write_csv(tmp_path / "log.csv", **torque, **current)
    with pytest.raises(LogError, match="--torque-constants"):
        make_station(replaying(log))
    constants = [f"{joint}={10.0 * (k + 1)}" for k, joint in enumerate(JOINTS)]
    for some in (constants, [str(10 * (k + 1)) for k in range(7)]):
        plan = replay_scenario(log, "arms/panda_hand.urdf", constants=some)
        save_scenario(plan, tmp_path / "replay.yaml")
        station = make_station(load_scenario(tmp_path / "replay.yaml"))
        context = station.CreateDefaultContext()
        context.SetTime(0.0225)
        played = station.GetOutputPort(ports.TORQUE_MEASURED).Eval(context)
        np.testing.assert_allclose(played, [(k + 1.0) ** 2 for k in range(7)])
    with pytest.raises(LogError, match="'much' is no torque constant"):
        replay_scenario(log, "arms/panda_hand.urdf", constants=["much"])


def test_velocities_of_some_joints_alone_are_played(tmp_path: Path) -> None:
    """A gripper's driver tells none of its own; the others' were lost with it."""
    told = {f"velocity_estimated.{joint}": np.full(50, 0.5 + k) for k, joint in enumerate(JOINTS) if k != 6}
    station = make_station(replaying(write_csv(tmp_path / "log.csv", **told)))
    context = station.CreateDefaultContext()
    context.SetTime(0.1)
    shown = station.GetOutputPort(ports.VELOCITY_ESTIMATED).Eval(context)
    np.testing.assert_allclose(shown[:6], 0.5 + np.arange(6.0))
    assert np.isfinite(shown[6]) and abs(shown[6]) < 0.11


def test_an_encoder_of_one_turn_costs_no_jump(tmp_path: Path) -> None:
    whole = np.pi + 0.4 * np.sin(30.0 * 0.004 * np.arange(50))
    wrapped = (whole + np.pi) % (2.0 * np.pi) - np.pi
    assert np.any(np.abs(np.diff(wrapped)) > 6.0)
    station = make_station(replaying(write_csv(tmp_path / "log.csv", **{f"position_measured.{JOINTS[6]}": wrapped})))
    context = station.CreateDefaultContext()
    shown = []
    for k in range(1, 50):
        context.SetTime(0.004 * k + 0.001)
        names = ports.POSITION_MEASURED, ports.VELOCITY_ESTIMATED
        shown.append([station.GetOutputPort(name).Eval(context)[6] for name in names])
    position, velocity = np.array(shown).T
    assert np.allclose(position - wrapped[0], whole[1:] - whole[0], atol=1e-9)
    assert np.allclose(velocity, np.diff(whole) / 0.004, atol=1e-6)


def test_a_log_without_the_arms_joints_is_refused(tmp_path: Path) -> None:
    lacking = {f"{signal}_measured.panda_joint3": None for signal in ("position", "torque")}
    with pytest.raises(LogError, match=r"replay\.log: .*panda_joint3"):
        make_station(replaying(write_csv(tmp_path / "a.csv", **lacking)))
    lacking = {f"torque_measured.{joint}": None for joint in JOINTS}
    with pytest.raises(LogError, match="torque"):
        make_station(replaying(write_csv(tmp_path / "b.csv", **lacking)))


@pytest.mark.parametrize(
    ("log", "error", "words"),
    [
        ("", ScenarioError, r"replay\.log: names no log"),
        ("/nowhere/at/all.csv", StationError, r"replay\.log: /nowhere/at/all\.csv: no such file"),
    ],
)
def test_a_missing_log_is_named(log: str, error: type[Exception], words: str) -> None:
    plan = scenario()
    plan.station, plan.replay.log = "replay", log
    with pytest.raises(error, match=words):
        make_station(plan)


# Damaged and foreign recordings.


def no_manifest(folder: Path) -> None:
    (folder / "manifest.yaml").unlink()


def odd_manifest(folder: Path) -> None:
    (folder / "manifest.yaml").write_text("joints: [a]\nmagic: 3\ncamera: null\n")


def list_manifest(folder: Path) -> None:
    (folder / "manifest.yaml").write_text("[1, 2")


def newer_version(folder: Path) -> None:
    file = folder / "manifest.yaml"
    file.write_text(file.read_text().replace("version: 1", "version: 7"))


def other_arm(folder: Path) -> None:
    file = folder / "manifest.yaml"
    file.write_text(file.read_text().replace("panda_joint1", "elbow"))


def cut_log(folder: Path) -> None:
    lines = (folder / "log.csv").read_text().splitlines()
    (folder / "log.csv").write_text("\n".join([*lines[:20], lines[20][:40]]))


def short_log(folder: Path) -> None:
    lines = (folder / "log.csv").read_text().splitlines()
    (folder / "log.csv").write_text("\n".join(lines[:20]) + "\n")


def empty_log(folder: Path) -> None:
    lines = (folder / "log.csv").read_text().splitlines()
    (folder / "log.csv").write_text(lines[0] + "\n")


def time_goes_back(folder: Path) -> None:
    lines = (folder / "messages.csv").read_text().splitlines()
    (folder / "messages.csv").write_text("\n".join([lines[0], lines[2], lines[1], *lines[3:]]) + "\n")


def lost_image(folder: Path) -> None:
    (folder / "camera" / "depth_000003.png").unlink()


def swapped(file: str, old: str, new: str) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        text = (folder / file).read_text()
        assert old in text
        (folder / file).write_text(text.replace(old, new, 1))

    return damage


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (no_manifest, "no manifest"),
        (swapped("log.csv", "time,", "seconds,"), r"log\.csv: no column time"),
        (swapped("messages.csv", "time,delivery", "time"), r"messages\.csv"),
        (lambda folder: (folder / "messages.csv").write_text("time\n0.1\n"), "needs the columns time, delivery"),
        (lambda folder: (folder / "camera" / "frames.csv").write_text("index,capture\n"), r"frames\.csv: needs the"),
        (swapped("manifest.yaml", "sensors: []", "sensors: null"), "sensors: None is no list of names"),
        (swapped("manifest.yaml", "depth_shape: null", "depth_shape: [8]"), "not width and height"),
        (swapped("manifest.yaml", "  width: ", "  width: 0  # "), r"camera\.width: 0 is no number"),
        (swapped("manifest.yaml", "depth_unit: ", "depth_unit: -"), "is not a length"),
        (odd_manifest, "not a recording's manifest"),
        (list_manifest, "not a recording's manifest"),
        (newer_version, "version 7"),
        (other_arm, r"recorded joints \['elbow'"),
        (cut_log, r"log\.csv: not a table of numbers"),
        (short_log, "19 rows"),
        (empty_log, "no message"),
        (time_goes_back, "delivery times go back"),
        (lost_image, r"depth_000003\.png: missing"),
    ],
)
def test_a_damaged_recording_is_refused(recorded, tmp_path: Path, damage, words: str) -> None:
    folder = copy(recorded[0], tmp_path)
    damage(folder)
    with pytest.raises(StationError, match=words):
        make_station(replaying(folder))


def test_a_damaged_image_is_named_when_it_is_shown(recorded, tmp_path: Path) -> None:
    folder = copy(recorded[0], tmp_path)
    (folder / "camera" / "rgb_000002.png").write_bytes(b"no picture")
    station = make_station(replaying(folder))
    context = station.CreateDefaultContext()
    context.SetTime(0.19)
    with pytest.raises(StationError, match=r"rgb_000002\.png: not a PNG image of 80×60"):
        station.GetOutputPort("camera.rgb_image").Eval(context)


def test_another_camera_is_refused(recorded) -> None:
    plan = replaying(recorded[0])
    assert plan.twin.camera is not None
    plan.twin.camera.width = 640
    with pytest.raises(ScenarioError, match=r"twin\.camera\.width: 640; recorded was 80"):
        make_station(plan)


# The writer.


def manifest(camera: bool = False) -> Manifest:
    return Manifest(["a"], [], RecordedCamera("eye", 4, 3, 15.0, 0.01, 0.001) if camera else None)


def message(writer: RecordingWriter, time: float) -> None:
    signals = ("position_measured", "velocity_estimated", "torque_measured", "position_commanded")
    writer.message(time, time, {name: np.array([0.1 * time]) for name in signals})


def test_a_run_that_fails_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="boom"), RecordingWriter(tmp_path / "r", manifest()) as writer:
        message(writer, 0.0)
        raise RuntimeError("boom")
    assert not list(tmp_path.iterdir())


def test_a_recording_replaces_the_one_before_and_nothing_else(tmp_path: Path) -> None:
    for count in (1, 2):
        with RecordingWriter(tmp_path / "r", manifest()) as writer:
            for k in range(count):
                message(writer, 0.1 * k)
            assert count == 1 or len((tmp_path / "r" / "log.csv").read_text().splitlines()) == 2
    assert len((tmp_path / "r" / "log.csv").read_text().splitlines()) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["r"]
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("…")
    with pytest.raises(StationError, match="is no recording"):
        RecordingWriter(tmp_path / "thesis", manifest())
    with pytest.raises(StationError, match="is no recording"):
        RecordingWriter(tmp_path / "r" / "log.csv", manifest())
    with pytest.raises(StationError, match="cannot be written"):
        RecordingWriter(tmp_path / "r" / "log.csv" / "x", manifest())


def test_floats_read_back_to_the_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    values = rng.standard_normal((50, 4)) * 10.0 ** rng.integers(-12, 6, (50, 4))
    signals = ("position_measured", "velocity_estimated", "torque_measured", "position_commanded")
    with RecordingWriter(tmp_path / "r", manifest()) as writer:
        for k, row in enumerate(values):
            writer.message(0.1 * k, 0.1 * k, dict(zip(signals, row[:, None], strict=True)))
    from twin_diagram.station.replay.reading import read_recording

    messages = read_recording(tmp_path / "r", manifest(), ["a"], [])
    back = np.hstack([messages.position, messages.velocity, messages.torque])
    assert np.array_equal(back, values[:, :3]) and np.array_equal(messages.delivery, 0.1 * np.arange(50))


def test_images_wait_in_a_short_queue(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "r", manifest(camera=True)) as writer:
        for k in range(60):
            writer.image(k / 15, k / 15 + 0.01, np.full((3, 4, 4), k, np.uint8), np.full((3, 4), 0.01 * k, np.float32))
            assert len(writer._pending) <= 9
    assert len(list((tmp_path / "r" / "eye").glob("*.png"))) == 120


def test_a_recorder_takes_one_run(tmp_path: Path) -> None:
    plan = scenario(camera=False)
    builder = DiagramBuilder()
    station = make_station(plan)
    builder.AddNamedSystem("station", station)
    with open_recording(plan, tmp_path / "r") as writer:
        add_recorder(builder, station, writer)
        simulator = Simulator(builder.Build())
        simulator.AdvanceTo(0.02)
        simulator.get_mutable_context().SetTime(0.0)
        with pytest.raises(StationError, match="a recording holds one run"):
            simulator.Initialize()


@pytest.mark.long
def test_depth_of_a_real_camera_on_a_grid_of_its_own_is_played_to_the_bit(egl: None, tmp_path: Path) -> None:
    plan = scenario()
    assert plan.twin.camera is not None
    plan.twin.camera.depth = DepthCamera(Pose([-0.02, 0.0, 0.0]), width=70, height=50, fx=60.0)
    plan.world.camera_defects = CameraDefects("d415", depth_unit=1e-4)
    live = run(plan, 0.25, record=tmp_path / "run")
    plan.station, plan.replay.log = "replay", str(tmp_path / "run")
    assert run(plan, 0.25) == live
    plan.twin.camera.depth = None
    with pytest.raises(ScenarioError, match=r"twin\.camera\.depth: depth of 80×60 pixels; recorded was 70×50"):
        make_station(plan)
