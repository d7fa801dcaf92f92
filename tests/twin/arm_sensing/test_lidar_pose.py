"""A lidar without any camera: its clouds as poses of a link, by hand and in a Diagram."""

from __future__ import annotations

import functools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.perception import PointCloud
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from tests.estimation_bench import HOME, World, simulate, twin_terms
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.ekf_system import AdaptiveEkf
from twin_diagram.estimation.filter.belief import SensorTrack
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.sensors import LIDAR_NOISE, CloudError, LidarPose
from twin_diagram.estimation.sensors.cloud_pose import TUNING as CLOUD_POSE
from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.scenario import ArmModel, Filter, SensorSpec
from twin_diagram.signals.layouts import NEVER
from twin_diagram.station.sim.lidar import ScannedSolid, world_solids
from twin_diagram.station.sim.lidar import scan as ranges_of
from twin_diagram.twin.arm_sensing.cloud_measurement import SIZE, measured, near
from twin_diagram.twin.arm_sensing.lidar_pose import ArmScan
from twin_diagram.twin.arm_sensing.link_surface import Points, link_surface, other_surfaces

LINK = "panda_link7"
X_WS = RigidTransform(RollPitchYaw(0.1, 0.4, 2.8), [1.6, 0.3, 1.0])


@functools.cache
def terms() -> ArmTerms:
    return twin_terms()


@functools.cache
def surface() -> Points:
    return link_surface(ArmModel(model="arms/panda_hand.urdf"), LINK)


@functools.cache
def shown() -> tuple[MultibodyPlant, list[ScannedSolid], list[ScannedSolid]]:
    """The arm, its shapes for the simulated lidar's own ray casting, and those of the link and what is welded to it."""
    scene_graph, plant = SceneGraph(), MultibodyPlant(0.0)
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    add_arm(plant, ArmModel(model="arms/panda_hand.urdf"))
    plant.Finalize()
    found = world_solids(SimpleNamespace(plant=plant, scene_graph=scene_graph))
    link = {int(body.index()) for body in plant.GetBodiesWeldedTo(plant.GetBodyByName(LINK))}
    return plant, found, [solid for solid in found if solid.body in link]


def scan(q: np.ndarray, rng: np.random.Generator, count: int = 400, whole: bool = False) -> np.ndarray:
    """(K, 3) in S: what beams meet of the link, or of the whole arm, off along them, a wall, and no echo."""
    plant, arm, link = shown()
    context = plant.CreateDefaultContext()
    plant.SetPositions(context, np.concatenate([q, np.zeros(plant.num_positions() - len(q))]))
    R, p = LidarPose(terms(), LINK, *surface()).frame.pose(q)
    origin = X_WS.translation()
    beams = rng.normal(0.0, 0.1, (10 * count, 3)) + surface()[0].mean(axis=0) @ R.T + p - origin
    beams /= np.linalg.norm(beams, axis=1, keepdims=True)
    far = ranges_of(origin, beams, arm if whole else link, plant.get_body_poses_output_port().Eval(context))
    beams, far = beams[np.isfinite(far)][:count], far[np.isfinite(far)][:count]
    assert len(far) == count
    points = origin + (far + np.hypot(0.01, 0.005 * far**2) * rng.normal(size=count))[:, None] * beams
    wall = rng.uniform([-1.0, -1.0, 0.0], [-0.9, 1.0, 2.0], (200, 3))
    no_echo = np.array([[np.inf] * 3, [np.nan] * 3])
    return np.vstack([(np.vstack([points, wall]) - origin) @ X_WS.rotation().matrix(), no_echo])


def pose(q: np.ndarray) -> np.ndarray:
    R, p = LidarPose(terms(), LINK, *surface()).frame.pose(q)
    return np.concatenate([RotationMatrix(R).ToQuaternion().wxyz(), p])


def test_poses_are_as_sure_as_they_say() -> None:
    rng = np.random.default_rng(1021)
    system = ArmScan(terms(), LINK, surface(), X_WS)
    sensor, nees, off = LidarPose(terms(), LINK, *surface()), [], []
    for _ in range(40):
        q = HOME + rng.normal(0.0, 0.2, 7)
        z, R = system.align(scan(q, rng), q + rng.normal(0.0, 0.004, 7))
        error = sensor.innovation(z, pose(q))
        nees.append(error @ np.linalg.solve(R, error))
        off.append(np.linalg.norm(error[3:]))
    assert 2.5 < np.mean(nees) < 10.0  # 6 on average
    assert np.median(off) < 0.006
    with pytest.raises(CloudError, match="points lie near"):
        system.align(scan(HOME, rng)[400:], HOME)


def test_a_measurement_is_sought_where_the_arm_was_and_absent_where_nothing_was_met() -> None:
    asked = []

    def align(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked.append(q)
        if q[0] > 1.0:
            raise CloudError("nothing there")
        return np.arange(7.0), np.diag(np.arange(1.0, 7.0))

    found = measured(1.9, 2.0, np.array([0.5, -0.5, 1.0, 2.0]), align)
    np.testing.assert_allclose(asked.pop(), [0.4, -0.7])
    np.testing.assert_array_equal(found[:7], np.arange(7.0))
    np.testing.assert_array_equal(found[7:].reshape(6, 6), np.diag(np.arange(1.0, 7.0)))
    for nothing in (measured(1.9, 2.0, np.array([1.5, 0.0]), align), measured(NEVER, 2.0, np.zeros(2), align)):
        assert nothing.shape == (SIZE,) and np.isnan(nothing[:7]).all() and not nothing[7:].any()
    assert len(asked) == 1  # before the first cloud nothing is sought


def test_points_near_a_place_are_thinned_out() -> None:
    points = np.random.default_rng(1025).uniform(-1.0, 1.0, (5000, 3))
    place = np.array([0.2, 0.0, 0.1])
    inside = {tuple(p) for p in points if np.linalg.norm(p - place) < 0.8}
    some = near(points, place, 0.8, 300)
    assert {tuple(p) for p in some} <= inside and 300 <= len(some) < 600
    assert len(near(points, place, 0.8, len(inside))) == len(inside)
    assert near(points, np.array([9.0, 0.0, 0.0]), 0.8, 300).shape == (0, 3)


def test_noise_grows_with_distance_squared() -> None:
    """A plate seen from three times as far is nine times as uncertain, where that outweighs what is near."""
    rng = np.random.default_rng(1022)
    plate = np.hstack([rng.uniform(-0.2, 0.2, (10000, 2)), np.zeros((10000, 1))])
    noise = replace(LIDAR_NOISE, std_0=1e-5, floor_p=1e-6, floor_r=1e-6)
    lidar = LidarPose(terms(), LINK, plate, np.tile([0.0, 0.0, 1.0], (10000, 1)), noise=noise)
    R, p = lidar.frame.pose(HOME)
    points = plate[:1000] @ R.T + p
    near, far = (lidar.align(points, p + d * R[:, 2], HOME)[1] for d in (3.0, 9.0))
    turned = np.kron(np.eye(2), R)
    near, far = (np.sqrt(np.diag(turned.T @ cov @ turned)) for cov in (near, far))
    told, untold = [0, 1, 5], [2, 3, 4]
    np.testing.assert_allclose(far[told] / near[told], 9.0, rtol=0.15)
    assert near[5] == pytest.approx(0.045 / np.sqrt(1000.0), rel=0.1)
    # Of a turn about its normal and of slides along it, a plate's points say nothing.
    for claimed in (near, far):
        np.testing.assert_allclose(
            claimed[untold], [CLOUD_POSE.nothing[0], CLOUD_POSE.nothing[1], CLOUD_POSE.nothing[1]], rtol=0.05
        )


def test_points_of_other_links_are_left_out() -> None:
    """Beams that meet the whole arm: where the other links are known, the pose is as sure as it says."""
    rng, arm = np.random.default_rng(1026), ArmModel(model="arms/panda_hand.urdf")
    others = other_surfaces(arm, LINK)
    assert {"panda_link0", "panda_link6"} <= set(others) and LINK not in others and "panda_hand" not in others
    told, alone = (ArmScan(terms(), LINK, surface(), X_WS, others=known) for known in (others, None))
    sensor, nees = LidarPose(terms(), LINK, *surface()), {"told": [], "alone": []}
    for _ in range(15):
        q = HOME + rng.normal(0.0, 0.2, 7)
        points, start = scan(q, rng, 600, whole=True), q + rng.normal(0.0, 0.004, 7)
        for name, system in (("told", told), ("alone", alone)):
            try:
                z, R = system.align(points, start)
            except CloudError:
                continue
            error = sensor.innovation(z, pose(q))
            nees[name].append(error @ np.linalg.solve(R, error) / 6.0)
    assert len(nees["told"]) >= 12 and np.mean(nees["told"]) < 2.0 < np.mean(nees["alone"])


@pytest.mark.slow
def test_lidar_carries_on_where_the_encoders_fall_silent() -> None:
    """By hand, without any Diagram: predict and update, the scans 50 ms late."""
    run = simulate(World(seed=1023, period=4.0), 4.0)
    rng = np.random.default_rng(1023)
    alone, fused = (Ekf(terms(), Filter(parameters=["payload"])) for _ in range(2))
    lidar = LidarPose(terms(), LINK, *surface())
    fused.add(lidar)
    errors = {"alone": [], "fused": []}
    lost = 400
    for k in range(len(run.time)):
        for name, ekf in (("alone", alone), ("fused", fused)):
            if k < lost:
                ekf.observe(run.q[k], run.v[k], run.tau[k], run.time[k])
            else:
                ekf.predict(run.tau[k], 0.005)
                errors[name].append(np.linalg.norm(lidar.frame.pose(ekf.belief.q)[1] - pose(run.q_true[k])[4:]))
        if k >= lost and k % 20 == 0:
            taken = k - 10
            points = scan(run.q_true[taken], rng)[:-2] @ X_WS.rotation().matrix().T + X_WS.translation()
            z, R = lidar.align(points, X_WS.translation(), fused.belief.q - 0.05 * fused.belief.v)
            fused.update(lidar, z, run.time[taken], R)
    found = {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in errors.items()}
    print(found, fused.counters())
    assert fused.counters()["lidar"]["accepted"] >= 18
    assert found["fused"] < 0.02 and found["fused"] < 0.5 * found["alone"]


def test_in_a_diagram_scans_reach_the_filter() -> None:
    run, rng = simulate(World(seed=1024, start=1e9, mass=0.0), 0.5), np.random.default_rng(1024)
    builder = DiagramBuilder()
    spec = SensorSpec("body_pose", name="lidar", body=LINK)
    ekf = builder.AddNamedSystem("ekf", AdaptiveEkf(terms(), Filter(parameters=[], sensors=[spec])))
    scanner = ArmScan.AddToBuilder(builder, ekf, "lidar", LINK, surface(), X_WS)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    of_ekf, of_scan = (system.GetMyMutableContextFromRoot(context) for system in (ekf, scanner))
    scanner.GetInputPort("scan_time").FixValue(of_scan, [NEVER])
    scanner.GetInputPort("point_cloud").FixValue(of_scan, Value(PointCloud(0)))
    for k in range(100):
        for name, value in (
            ("position_measured", run.q[k]),
            ("velocity_estimated", run.v[k]),
            ("torque_measured", run.tau[k]),
            ("measurement_time", [run.time[k]]),
        ):
            ekf.GetInputPort(name).FixValue(of_ekf, value)
        if k in (20, 40, 60, 80):
            points = scan(run.q_true[k], rng)[0 if k < 80 else 400 :]  # the last one meets nothing but the wall
            cloud = PointCloud(len(points))
            cloud.mutable_xyzs()[:] = points.T
            scanner.GetInputPort("point_cloud").FixValue(of_scan, Value(cloud))
            scanner.GetInputPort("scan_time").FixValue(of_scan, [run.time[k]])
        simulator.AdvanceTo(0.005 * (k + 1))
    belief = ekf.belief(of_ekf)
    (track,) = belief.tracks
    assert (track[SensorTrack.ACCEPTED], track[SensorTrack.REFUSED], track[SensorTrack.INVALID]) == (3, 0, 1)
    np.testing.assert_allclose(belief.q, run.q_true[99], atol=5e-5)
