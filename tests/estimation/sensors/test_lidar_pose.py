"""What a lidar's beams meet, and that poses of small and round links are as sure as they say."""

from __future__ import annotations

import functools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import SceneGraph
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.sensors import LIDAR_NOISE, CloudError, LidarPose, PointNoise
from twin_diagram.estimation.sensors.cloud_pose import TUNING as CLOUD_POSE
from twin_diagram.estimation.sensors.lidar_pose import TUNING as LIDAR_POSE
from twin_diagram.estimation.sensors.lidar_pose import apart, visible
from twin_diagram.model.description.add_arm import add_arm
from twin_diagram.scenario import ArmModel
from twin_diagram.scenario import Lidar as Data
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.rotations import difference
from twin_diagram.station.scan_cloud import beams
from twin_diagram.station.sim.lidar import scan, world_solids
from twin_diagram.twin.arm_sensing.lidar_pose import ArmScan
from twin_diagram.twin.arm_sensing.link_surface import Points, link_surface, other_surfaces

ARM = ArmModel("arms/ur5e.urdf", tool_frame="tool0")
HOME = np.array([0.0, -1.3, 1.6, -1.8, -1.57, 0.4])


@functools.cache
def plant() -> tuple[SceneGraph, MultibodyPlant]:
    scene_graph, arm = SceneGraph(), MultibodyPlant(0.0)
    arm.RegisterAsSourceForSceneGraph(scene_graph)
    add_arm(arm, ARM)
    arm.Finalize()
    return scene_graph, arm


@functools.cache
def terms() -> ArmTerms:
    arm = MultibodyPlant(0.0)
    add_arm(arm, ARM)
    arm.Finalize()
    return ArmTerms(arm, [arm.get_joint(i).name() for i in arm.GetJointIndices() if arm.get_joint(i).num_positions()])


def looking(target: Array, distance: float, rng: np.random.Generator) -> RigidTransform:
    """Where a lidar stands that looks at about a place from some side and above."""
    turn, up = rng.uniform(-np.pi, np.pi), rng.uniform(-0.3, 0.8)
    way = np.array([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])
    left = np.cross([0.0, 0.0, 1.0], -way)
    left /= np.linalg.norm(left)
    R = np.column_stack([-way, left, np.cross(-way, left)])
    return RigidTransform(RotationMatrix(R), target + distance * way)


def trials(link: str, seed: int, count: int) -> tuple[Array, Array, int]:
    """Squared errors over what is claimed, per direction told; how far off (m); how often a pose was refused."""
    scene_graph, arm = plant()
    solids, ways = world_solids(SimpleNamespace(plant=arm, scene_graph=scene_graph)), beams(Data(columns=240, rows=120))
    surface, others = link_surface(ARM, link), other_surfaces(ARM, link)
    context, rng = arm.CreateDefaultContext(), np.random.default_rng(seed)
    sensor, middle = LidarPose(terms(), link, *surface), 0.5 * (surface[0].min(axis=0) + surface[0].max(axis=0))
    squares, off, refused = [], [], 0
    for _ in range(count):
        q = HOME + rng.normal(0.0, 0.5, 6)
        arm.SetPositions(context, q)
        R_WO, p_WO = sensor.frame.pose(q)
        X_WS = looking(p_WO + rng.normal(0.0, 0.1, 3), rng.uniform(1.0, 3.0), rng)
        rays = ways @ X_WS.rotation().matrix().T
        far = scan(X_WS.translation(), rays, solids, arm.get_body_poses_output_port().Eval(context))
        met = np.isfinite(far)
        far = far[met] + np.hypot(0.01, 0.005 * far[met] ** 2) * rng.normal(size=int(met.sum()))
        try:
            z, R = ArmScan(terms(), link, surface, X_WS, others=others).align(
                far[:, None] * ways[met], q + rng.normal(0.0, 0.004, 6)
            )
        except CloudError:
            refused += 1
            continue
        truth = RotationMatrix(R_WO).ToQuaternion().wxyz()
        error = np.concatenate([difference(z[:4], truth), z[4:] - p_WO])
        # Where the points say little, z stays with the prediction by the search's own deviation: of what they tell
        # of each direction, so much should remain.
        arm_W = R_WO @ middle
        about = np.eye(6)
        about[3:, :3] = -np.cross(arm_W, np.eye(3)).T
        told = np.linalg.inv(about @ (R - sensor.noise(np.zeros(6))) @ about.T)
        kept = np.linalg.solve(told + np.diag(np.repeat(np.array(CLOUD_POSE.search) ** -2.0, 3)), told)
        squares.append(error @ np.linalg.solve(R, error) / np.trace(told @ kept @ np.linalg.inv(told) @ kept.T))
        off.append(np.linalg.norm(error[3:]))
    return np.array(squares), np.array(off), refused


@pytest.mark.long
@pytest.mark.parametrize(
    ("link", "count", "off_by", "refused_at_most"),
    [("wrist_3_link", 80, 0.009, 35), ("wrist_1_link", 60, 0.007, 12), ("forearm_link", 30, 0.0045, 0)],
)
def test_poses_of_a_link_are_as_sure_as_they_say(link: str, count: int, off_by: float, refused_at_most: int) -> None:
    squares, off, refused = trials(link, 1101, count)
    assert 0.5 < np.mean(squares) < 2.0
    assert 0.35 < np.median(squares) < 1.5  # of three directions told the median is 0.8
    assert np.percentile(squares, 95) < 6.0
    assert np.median(off) < off_by and refused <= refused_at_most


# By hand.


def cylinder(radius: float = 0.04, length: float = 0.2, spacing: float = 0.003) -> Points:
    """About z, without its ends."""
    turn, z = np.meshgrid(
        np.arange(0.0, 2.0 * np.pi, spacing / radius), np.arange(-0.5 * length, 0.5 * length, spacing)
    )
    normals = np.stack([np.cos(turn).ravel(), np.sin(turn).ravel(), np.zeros(turn.size)], axis=1)
    points = radius * normals
    points[:, 2] = z.ravel()
    return points, normals


def test_noise_does_not_tell_a_turn_of_what_is_round() -> None:
    """Of a cylinder's turn about its axis no number of noisy points says anything."""
    rng, (points, normals) = np.random.default_rng(1102), cylinder()
    lidar = LidarPose(terms(), "wrist_3_link", points, normals, noise=replace(LIDAR_NOISE, floor_p=1e-6, floor_r=1e-6))
    R, p = lidar.frame.pose(HOME)
    origin = R @ np.array([1.5, 0.0, 0.1]) + p
    seen = points[visible(points, normals, (origin - p) @ R)] @ R.T + p
    away = seen - origin
    far = np.linalg.norm(away, axis=1, keepdims=True)
    for noise in (0.0, 1.0):
        z, cov = lidar.align(seen + noise * 0.015 * rng.normal(size=far.shape) * away / far, origin, HOME)
        found = np.kron(np.eye(2), RotationMatrix(Quaternion(z[:4])).matrix())
        own = found.T @ cov @ found
        turn = np.sqrt(own[2, 2])
        assert 0.9 * CLOUD_POSE.nothing[0] < turn <= CLOUD_POSE.nothing[0] * 1.001
        assert np.sqrt(own[3, 3]) < 0.001 and np.sqrt(own[0, 0]) < 0.02 and np.sqrt(own[1, 1]) < 0.02
        assert abs((R.T @ difference(z[:4], RotationMatrix(R).ToQuaternion().wxyz()))[2]) < 0.05


@settings(deadline=None, max_examples=30)
@given(st.floats(-3.1, 3.1), st.floats(-1.2, 1.2), st.floats(0.8, 4.0))
def test_of_a_ball_half_is_visible_and_a_plate_hides_it(turn: float, up: float, distance: float) -> None:
    rng = np.random.default_rng(1103)
    normals = rng.normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ball = 0.06 * normals
    way = np.array([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)])
    origin = distance * way
    seen = visible(ball, normals, origin)
    # Which of a ball's points face a place is known; its rim, seen at a flat angle, may count as hidden.
    facing = normals @ way > 0.06 / distance
    assert not (seen & ~facing).any()
    assert seen[normals @ way > 0.06 / distance + 0.35].all()
    # A larger plate before it leaves nothing to meet, and no beam is the ball's; behind it, it hides nothing.
    across = np.linalg.svd(way[None])[2][1:]
    plate = rng.uniform(-0.2, 0.2, (6000, 2)) @ across
    faces = np.tile(way, (6000, 1))
    before, behind = plate + 0.2 * way, plate - 0.2 * way
    free, met = apart(ball[seen], (before, faces), ball, origin)
    assert not free.any() and not met.any()
    free, met = apart(ball[seen], (behind, faces), ball[seen], origin)
    assert free.all()
    inner = np.linalg.norm(ball[seen] @ across.T, axis=1) < 0.05 - 1.5 * LIDAR_POSE.other
    assert met[inner].all()


def test_ranges_do_not_choose_points() -> None:
    """The same beams are kept whatever their ranges: a choice by range would keep the errors that please."""
    rng, (points, normals) = np.random.default_rng(1104), cylinder()
    origin = np.array([1.5, 0.0, 0.0])
    shown = points[visible(points, normals, origin)]
    others = (points + [0.0, 0.0, 0.2], normals)
    _, met = apart(shown, others, points, origin)
    _, noisy = apart(shown, others, origin + (points - origin) * rng.uniform(0.9, 1.1, (len(points), 1)), origin)
    assert 100 < met.sum() < len(met)
    np.testing.assert_array_equal(met, noisy)


def test_what_tells_no_pose_is_refused_in_a_line() -> None:
    rng, (points, normals) = np.random.default_rng(1105), cylinder()
    lidar = LidarPose(terms(), "wrist_3_link", points, normals, noise=PointNoise(0.002, 0.0), reach=0.05)
    R, p = lidar.frame.pose(HOME)
    origin = R @ np.array([1.5, 0.0, 0.0]) + p
    seen = points[visible(points, normals, (origin - p) @ R)] @ R.T + p
    away = (seen - origin) / np.linalg.norm(seen - origin, axis=1, keepdims=True)
    z, _ = lidar.align(seen, origin, HOME)
    np.testing.assert_allclose(z[4:], p, atol=1e-3)
    hidden = (
        np.array([1.0, 0.0, 0.0]) * 0.3 + rng.uniform(-0.3, 0.3, (9000, 3)) * [0.0, 1.0, 1.0],
        np.eye(3)[[0] * 9000],
    )
    cases = {
        "of something else": lambda: lidar.align(seen + 0.03 * rng.normal(size=(len(seen), 1)) * away, origin, HOME),
        "points lie near": lambda: lidar.align(seen + 0.5 * away, origin, HOME),
        "can be met": lambda: lidar.align(seen, origin, HOME, (hidden[0] @ R.T + p, hidden[1] @ R.T)),
        "0 points lie near": lambda: lidar.align(np.full((5, 3), np.nan), origin, HOME),
    }
    for words, tried in cases.items():
        with pytest.raises(CloudError, match=words) as caught:
            tried()
        assert "\n" not in str(caught.value)
