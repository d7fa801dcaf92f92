"""The simulated lidar: held against closed forms, and its scans from the scenario's switch to the filter."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.geometry import Box, Capsule, Cylinder, Ellipsoid, Sphere
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.systems.analysis import Simulator

from twin_diagram.errors import ScenarioError, StationError
from twin_diagram.estimation.filter.belief import SensorTrack
from twin_diagram.runs.run import replay_scenario, run_scenario
from twin_diagram.scenario import ArmModel, Lidar, LidarDefects, Pose, Scenario, SensorSpec
from twin_diagram.scenario.file import override_scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station import make_station, ports
from twin_diagram.station.scan_cloud import beams
from twin_diagram.station.sim.lidar import LidarSystem, ScannedSolid, _parts, scan
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop
from twin_diagram.twin.twin import make_twin

HOME = [0.0, -1.3, 1.6, -1.8, -1.57, 0.4]
PORT = ports.lidar("room")
POSE = Pose([1.9, 0.5, 0.9], [0.0, 0.2, -2.9])


def solids(shape: object, corners: Array | None = None, X: RigidTransform | None = None) -> list[ScannedSolid]:
    X = X or RigidTransform()
    R = X.rotation().matrix()
    return [
        ScannedSolid(0, R, X.translation() + R @ shift, radius, axes, planes)
        for shift, axes, planes, radius in _parts(shape, corners)  # type: ignore[arg-type]
    ]


def rays(count: int, seed: int) -> tuple[Array, Array]:
    """From 2 m away, all over a ball of 0.6 m about the origin."""
    rng = np.random.default_rng(seed)
    origin = np.array([2.0, 0.3, -0.4])
    ways = rng.normal(0.0, 0.25, (count, 3)) - origin
    return origin, ways / np.linalg.norm(ways, axis=1, keepdims=True)


def outside(p: Array, shape: object) -> Array:
    """How far points (K, 3) lie outside a shape, negative within, by its distance function."""
    if isinstance(shape, Sphere):
        return np.asarray(np.linalg.norm(p, axis=1) - shape.radius())
    if isinstance(shape, Box):
        return np.asarray((np.abs(p) - 0.5 * np.asarray(shape.size())).max(axis=1))
    if isinstance(shape, Capsule):
        z = np.clip(p[:, 2], -0.5 * shape.length(), 0.5 * shape.length())
        return np.asarray(np.linalg.norm(p - np.stack([0 * z, 0 * z, z], axis=1), axis=1) - shape.radius())
    if isinstance(shape, Ellipsoid):
        return np.asarray(np.linalg.norm(p / [shape.a(), shape.b(), shape.c()], axis=1) - 1.0)
    assert isinstance(shape, Cylinder)
    side = np.hypot(p[:, 0], p[:, 1]) - shape.radius()
    return np.asarray(np.maximum(side, np.abs(p[:, 2]) - 0.5 * shape.length()))


@pytest.mark.parametrize(
    "shape", [Sphere(0.3), Box(0.4, 0.2, 0.5), Capsule(0.15, 0.4), Cylinder(0.2, 0.4), Ellipsoid(0.3, 0.2, 0.1)]
)
def test_beams_end_where_they_first_meet_a_shape(shape: object) -> None:
    """Marched along in steps of a millimetre by the shape's distance function, which the scan does not know."""
    X = RigidTransform(RollPitchYaw(0.3, -0.8, 1.1), [0.05, -0.02, 0.1])
    origin, ways = rays(400, 1051)
    found = scan(origin, ways, solids(shape, X=X), [RigidTransform()])
    steps = np.arange(1.0, 3.2, 0.001)
    R, p = X.rotation().matrix(), X.translation()
    hits = 0
    for way, r in zip(ways, found, strict=True):
        gap = outside((origin + steps[:, None] * way - p) @ R, shape)
        inside = np.flatnonzero(gap < 0.0)
        if len(inside) > 5:  # it does not just graze it
            assert r == pytest.approx(steps[inside[0]], abs=0.003)
            hits += 1
        elif gap.min() > 0.002:
            assert np.isinf(r)
    assert 40 < hits < 390


def test_what_stands_before_hides_what_is_behind_and_a_hull_is_its_corners() -> None:
    corners = np.array([[x, y, z] for x in (-0.2, 0.2) for y in (-0.1, 0.1) for z in (-0.25, 0.25)])
    origin, ways = rays(300, 1052)
    box, hull = Box(0.4, 0.2, 0.5), solids(None, corners)
    near, far = solids(box), [ScannedSolid(1, *(lambda s: (s.R, s.p, s.radius, s.axes, s.planes))(solids(box)[0]))]
    poses = [RigidTransform(), RigidTransform([-1.0, 0.0, 0.0])]
    one = scan(origin, ways, near, poses)
    np.testing.assert_allclose(scan(origin, ways, hull, poses), one, rtol=1e-9)
    np.testing.assert_array_equal(
        scan(origin, ways, near + far, poses), np.minimum(one, scan(origin, ways, far, poses))
    )
    assert np.isinf(scan(origin, -ways, near + far, poses)).all(), "nothing stands behind the lidar"


def test_noise_grows_with_distance_squared_and_seed_and_scan_say_all() -> None:
    defects = LidarDefects(noise=0.01, growth=0.005, dropout=0.1)
    data = Lidar(columns=40, rows=40, width=0.1, height=0.1)
    for distance in (1.0, 3.0, 6.0):
        wall = [ScannedSolid(0, np.eye(3), np.zeros(3), 1e3, None, np.array([[-1.0, 0.0, 0.0, distance]]))]
        system = LidarSystem(data, defects, wall, 7)
        true = distance / beams(data)[:, 0]
        scans = [system.ranges([RigidTransform()], tick) for tick in (1, 2, 1)]
        error = np.concatenate([(s - true)[s > 0.0] for s in scans[:2]])
        assert np.std(error) == pytest.approx(np.hypot(0.01, 0.005 * distance**2), rel=0.06)
        assert np.mean(scans[0] == 0.0) == pytest.approx(0.1, abs=0.03)
        np.testing.assert_array_equal(scans[0], scans[2])
        assert not np.array_equal(scans[0], scans[1])


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3), st.integers(0, 2**31))
def test_from_anywhere_an_echo_lies_on_the_surface(origin: list[float], seed: int) -> None:
    ways = np.random.default_rng(seed).normal(size=(64, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    shape = Box(0.4, 0.2, 0.5)
    met = scan(np.array(origin), ways, solids(shape), [RigidTransform()])
    hit = np.isfinite(met)
    np.testing.assert_allclose(outside(np.array(origin) + met[hit, None] * ways[hit], shape), 0.0, atol=1e-9)
    assert (met > 0.0).all()


# From the scenario to the filter.


def plan(duration: float = 1.2) -> Scenario:
    scenario = Scenario(seed=1053, duration=duration)
    twin, world = scenario.twin, scenario.world
    twin.arm, world.arm = (ArmModel("arms/ur5e.urdf", tool_frame="tool0") for _ in range(2))
    twin.home, twin.camera, world.objects, world.fixtures = list(HOME), None, {}, []
    twin.task.X_WG, twin.task.start = Pose([0.35, 0.25, 0.45], [3.1, 0.0, 0.4]), 0.1
    twin.lidar = Lidar(X_WS=POSE, columns=240, rows=120)
    twin.filter.sensors = [SensorSpec("lidar", body="forearm_link")]
    return scenario


def run(scenario: Scenario, until: float) -> tuple[ClosedLoop, Simulator]:
    loop = make_closed_loop(scenario)
    simulator = Simulator(loop.diagram)
    simulator.AdvanceTo(until)
    return loop, simulator


@pytest.fixture(scope="module")
def live() -> tuple[ClosedLoop, Simulator]:
    return run(plan(), 1.2)


@pytest.mark.long
def test_scans_reach_the_filter_and_are_as_sure_as_they_say(live: tuple[ClosedLoop, Simulator]) -> None:
    loop, simulator = live
    root = simulator.get_context()
    found = loop.twin.ekf.belief(loop.twin.ekf.GetMyContextFromRoot(root))
    (track,) = found.tracks
    assert track[SensorTrack.ACCEPTED] >= 9 and track[SensorTrack.REFUSED] <= 2 and track[SensorTrack.INVALID] == 0
    # Its mean whitened innovation, over some ten scans.
    assert np.abs(track[len(SensorTrack) :]).max() < 2.0
    station = loop.station.GetMyContextFromRoot(root)
    ranges = loop.station.GetOutputPort(PORT).Eval(station)
    taken = loop.station.GetOutputPort(ports.time_of(PORT)).Eval(station)[0]
    assert len(ranges) == 240 * 120 and np.count_nonzero(ranges) > 1000
    assert taken == pytest.approx(1.1)


def test_without_the_switch_nobody_asks_for_scans() -> None:
    scenario = plan()
    scenario.twin.filter.sensors = []
    assert PORT not in ports.input_names(make_twin(scenario.twin).diagram)
    assert PORT in ports.output_names(make_station(scenario))
    switched = override_scenario(scenario, ["twin.filter.sensors=[{kind: lidar, std: [0.004, 0.01]}]"])
    (fused,) = make_twin(switched.twin).fused
    assert (fused.reading, fused.time, fused.spec.body) == (PORT, "room.lidar_time", "wrist_3_link")
    scenario.twin.lidar = None
    assert PORT not in ports.output_names(make_station(scenario))


def test_scrambling_the_world_changes_nothing_that_the_twin_is_built_of() -> None:
    scenario = plan()
    before = ports.input_names(make_twin(scenario.twin).diagram)
    scenario.world.lidar_defects = LidarDefects(noise=1.0, growth=3.0, dropout=0.9, missing=[[0.0, 9.0]])
    assert ports.input_names(make_twin(scenario.twin).diagram) == before
    loop, simulator = run(scenario, 0.4)
    found = loop.twin.ekf.belief(loop.twin.ekf.GetMyContextFromRoot(simulator.get_context()))
    assert found.valid and not found.tracks[0][SensorTrack.ACCEPTED]
    station = loop.station.GetMyContextFromRoot(simulator.get_context())
    assert loop.station.GetOutputPort(ports.time_of(PORT)).Eval(station)[0] == NEVER


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lidar") / "recording"
    run_scenario(plan(0.55), record=folder, say=lambda text: None, quiet=True)
    return folder


def believed(loop: ClosedLoop, simulator: Simulator) -> Array:
    belief = loop.twin.ekf.belief(loop.twin.ekf.GetMyContextFromRoot(simulator.get_context()))
    return np.array(belief.vector)


@pytest.mark.slow
def test_a_recording_shows_scans_again_to_the_bit(recorded: Path) -> None:
    again = replay_scenario(recorded)
    live, replayed = run(plan(), 0.5), run(again, 0.5)
    for loop, simulator in (live, replayed):
        found = loop.twin.ekf.belief(loop.twin.ekf.GetMyContextFromRoot(simulator.get_context()))
        assert found.tracks[0][SensorTrack.ACCEPTED] >= 3
    np.testing.assert_array_equal(believed(*live), believed(*replayed))
    ranges, times = (
        [
            loop.station.GetOutputPort(name).Eval(loop.station.GetMyContextFromRoot(simulator.get_context())).copy()
            for loop, simulator in (live, replayed)
        ]
        for name in (PORT, ports.time_of(PORT))
    )
    np.testing.assert_array_equal(*ranges)
    np.testing.assert_array_equal(*times)
    assert np.count_nonzero(ranges[0]) > 1000
    # Before the first scan nothing is on the ports.
    loop, _ = replayed
    station = loop.station.CreateDefaultContext()
    assert not loop.station.GetOutputPort(PORT).Eval(station).any()
    assert loop.station.GetOutputPort(ports.time_of(PORT)).Eval(station)[0] == NEVER


@pytest.mark.long
def test_a_recording_without_scans_is_one_in_which_the_lidar_is_silent(recorded: Path, tmp_path: Path) -> None:
    """As earlier versions wrote them: their manifests do not know the word."""
    folder = Path(shutil.copytree(recorded, tmp_path / "recording"))
    manifest = yaml.safe_load((folder / "manifest.yaml").read_text())
    del manifest["lidar"]
    (folder / "manifest.yaml").write_text(yaml.safe_dump(manifest))
    shutil.rmtree(folder / PORT)
    loop, simulator = run(replay_scenario(folder), 0.3)
    found = loop.twin.ekf.belief(loop.twin.ekf.GetMyContextFromRoot(simulator.get_context()))
    assert found.valid and not found.tracks[0][SensorTrack.ACCEPTED] and not found.tracks[0][SensorTrack.INVALID]
    without = replay_scenario(recorded)
    without.twin.filter.sensors, without.twin.lidar = [], None
    assert PORT not in ports.output_names(make_station(without))


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda folder: (folder / "scan_000001.npz").unlink(), "scan_000001.npz: missing"),
        (lambda folder: (folder / "scans.csv").write_text("index,capture\n0,0.1\n"), "needs the columns"),
        (lambda folder: (folder / "scans.csv").write_text("index,capture,delivery\n0,0.1,2\n1,0.2,1\n"), "go back"),
        (lambda folder: (folder / "scan_000000.npz").write_bytes(b"no"), "scan_000000.npz: not a scan"),
        (lambda folder: np.savez(folder / "scan_000000.npz", ranges=np.zeros(3)), r"holds \(3,\) numbers"),
        (lambda folder: np.savez(folder / "scan_000000.npz", other=np.zeros(3)), "not a scan"),
    ],
)
def test_damaged_scans_are_named(recorded: Path, tmp_path: Path, damage, words: str) -> None:  # type: ignore[no-untyped-def]
    folder = Path(shutil.copytree(recorded, tmp_path / "recording"))
    damage(folder / PORT)
    with pytest.raises(StationError, match=words) as caught:
        station = make_station(replay_scenario(folder))
        context = station.CreateDefaultContext()
        context.SetTime(0.15)
        station.GetOutputPort(PORT).Eval(context)
    assert "\n" not in str(caught.value)


def test_another_lidar_than_was_recorded_is_refused(recorded: Path) -> None:
    again = replay_scenario(recorded)
    assert again.twin.lidar is not None
    again.twin.lidar.rows = 7
    with pytest.raises(ScenarioError, match=r"twin\.lidar\.rows: 7; recorded was 120"):
        make_station(again)


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("twin.lidar.range", lambda s: setattr(s.twin.lidar, "range", [2.0, 1.0])),
        ("twin.lidar.latency", lambda s: setattr(s.twin.lidar, "latency", 0.2)),
        ("twin.lidar.rows", lambda s: setattr(s.twin.lidar, "rows", 0)),
        ("twin.filter.sensors.0", lambda s: setattr(s.twin, "lidar", None)),
        ("twin.filter.sensors.0.std", lambda s: setattr(s.twin.filter.sensors[0], "std", [0.1])),
        ("twin.filter.sensors.0.X_BS", lambda s: setattr(s.twin.filter.sensors[0], "X_BS", Pose([0.1, 0.0, 0.0]))),
        ("world.lidar_defects.noise", lambda s: setattr(s.world.lidar_defects, "noise", -1.0)),
        ("world.lidar_defects.missing", lambda s: setattr(s.world.lidar_defects, "missing", [[1.0]])),
    ],
)
def test_what_cannot_be_is_refused_by_its_field(field: str, change) -> None:  # type: ignore[no-untyped-def]
    scenario = plan()
    change(scenario)
    with pytest.raises(ScenarioError, match=field.replace(".", r"\.")) as caught:
        make_closed_loop(scenario)
    assert "\n" not in str(caught.value)
