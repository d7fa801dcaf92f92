"""The camera's and the lidar's way to a link: window, ball, frames, floor; no renderer, closed forms instead."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.perception import PointCloud
from pydrake.systems.sensors import ImageDepth32F

from tests.estimation_bench import HOME
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.link_frame import LinkFrame
from twin_diagram.estimation.sensors import PointNoise
from twin_diagram.model.model import Model
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.scenario import ArmModel, Camera, DepthNoise, Pose, SensorSpec
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.lens import Lens
from twin_diagram.signals.rotations import difference
from twin_diagram.twin.arm_sensing import depth_pose, lidar_pose
from twin_diagram.twin.arm_sensing.depth_pose import ArmCloud, point_noise, window
from twin_diagram.twin.arm_sensing.lidar_pose import ArmScan

LINK = "panda_link7"
LOW, HIGH = np.array([-0.05, -0.03, 0.02]), np.array([0.07, 0.05, 0.20])
"""Of the block that stands for the link, in the link's frame [m]."""

# The window.

AHEAD = Pinhole(101, 81, 100.0, np.eye(3), np.zeros(3))
"""Looks along Z of W; its centre is at (50, 40)."""


def bounds(part: tuple[slice, slice]) -> list[int]:
    return [part[0].start, part[0].stop, part[1].start, part[1].stop]


def test_a_ball_ahead_is_held_by_a_window_of_its_reach() -> None:
    # 100 · 0.1 / (1.1 − 0.1) = 10 pixels each way.
    assert bounds(window(AHEAD, np.array([0.0, 0.0, 1.1]), 0.1)) == [30, 51, 40, 61]
    # A centimetre and a half aside and down, at 1 m: u = 51.5, v = 38.5; 100 · 0.1 / 0.9 = 11.11 pixels.
    assert bounds(window(AHEAD, np.array([0.015, -0.015, 1.0]), 0.1)) == [27, 50, 40, 63]


def test_it_ends_at_the_images_edge_and_is_empty_out_of_sight() -> None:
    assert bounds(window(AHEAD, np.array([0.45, 0.35, 1.0]), 0.1))[1::2] == [81, 101]
    assert bounds(window(AHEAD, np.array([-0.45, -0.35, 1.0]), 0.1))[::2] == [0, 0]
    for aside in (np.array([3.0, 0.0, 1.0]), np.array([0.0, -3.0, 1.0])):
        part = window(AHEAD, aside, 0.1)
        assert np.zeros((81, 101))[part].size == 0
    for behind in (-1.0, 0.05, 0.125):  # at 0.125 m it touches the camera's plane
        assert bounds(window(AHEAD, np.array([0.0, 0.0, behind]), 0.125)) == [0, 0, 0, 0]
    assert bounds(window(AHEAD, np.array([0.0, 0.0, 0.13]), 0.125)) == [0, 81, 0, 101]


def test_all_of_a_ball_lies_in_its_window() -> None:
    rng = np.random.default_rng(2011)
    on = rng.normal(size=(3000, 3))
    on /= np.linalg.norm(on, axis=1, keepdims=True)
    wide = Pinhole(641, 481, 400.0, np.eye(3), np.zeros(3))
    for k in range(40):
        camera = wide if k % 2 else AHEAD  # the wide one sees 39° aside: there a ball of 10 cm stood out by 3 pixels
        middle, radius = rng.uniform([-0.6, -0.4, 0.6], [0.6, 0.4, 1.5]), rng.uniform(0.05, 0.2)
        u, v, _ = camera.project(middle + radius * on)
        rows, columns = window(camera, middle, radius)
        seen = (u > -0.5) & (u < camera.width - 0.5) & (v > -0.5) & (v < camera.height - 0.5)
        u, v = np.round(u[seen]), np.round(v[seen])
        assert (v >= rows.start).all() and (v < rows.stop).all()
        assert (u >= columns.start).all() and (u < columns.stop).all()


# A block on the last link, seen by a camera that is traced ray by ray.


@functools.cache
def model() -> Model:
    return Model.load(ArmModel())


@functools.cache
def terms() -> ArmTerms:
    return ArmTerms.from_model(model())


@functools.cache
def block() -> tuple[Array, Array]:
    """Points and outward normals, 3 mm apart, face by face."""
    points, normals = [], []
    for axis in range(3):
        first, second = [np.arange(LOW[k], HIGH[k] + 1e-9, 0.003) for k in range(3) if k != axis]
        grid = np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1).reshape(-1, 2)
        for side, sign in ((LOW, -1.0), (HIGH, 1.0)):
            points.append(np.insert(grid, axis, side[axis], axis=1))
            normals.append(np.tile(sign * np.eye(3)[axis], (len(grid), 1)))
    return np.concatenate(points), np.concatenate(normals)


def link(q: Array) -> tuple[Array, Array]:
    return LinkFrame(terms(), LINK).pose(q)


def meets(origin: Array, ways: Array, q: Array) -> Array:
    """How far along ways (..., 3) in W the block is met; inf where it is not: slab by slab."""
    R, p = link(q)
    o, d = (origin - p) @ R, ways @ R
    with np.errstate(divide="ignore"):
        one, two = (LOW - o) / d, (HIGH - o) / d
    enters, leaves = np.minimum(one, two).max(axis=-1), np.maximum(one, two).min(axis=-1)
    return np.where(enters <= leaves, enters, np.inf)


def looking() -> RigidTransform:
    """A pose whose Z points at the block's middle at HOME, three of its faces in sight."""
    R, p = link(HOME)
    away = R @ [0.45, -0.5, -0.4]
    middle = p + R @ (0.5 * (LOW + HIGH))
    z = -away / np.linalg.norm(away)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    return RigidTransform(RotationMatrix(np.stack([x, np.cross(z, x), z], axis=1)), middle + away)


@functools.cache
def camera() -> Camera:
    X_WC = looking()
    rpy = RollPitchYaw(X_WC.rotation()).vector()
    return Camera(X_WC=Pose(X_WC.translation().tolist(), rpy.tolist()), width=160, height=120, focal=220.0)


@functools.cache
def picture() -> Array:
    """Depth (H, W) of the block at HOME, with a wall a metre behind it."""
    data, X_WC = camera(), looking()
    v, u = np.mgrid[0 : data.height, 0 : data.width]
    rays = np.stack([(u - 79.5) / data.focal, (v - 59.5) / data.focal, np.ones_like(u)], axis=-1)
    depth = meets(X_WC.translation(), rays @ X_WC.rotation().matrix().T, HOME)
    return np.where(np.isfinite(depth), depth, 1.8).astype(np.float32)


def cloud(**spec: Any) -> ArmCloud:
    return ArmCloud(model(), SensorSpec("depth", name="hand", body=LINK, **spec), camera(), block())


OFF = 0.004 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0, -1.0])


def test_the_block_is_found_where_it_is() -> None:
    R, p = link(HOME)
    z, _ = cloud().align(picture(), HOME + OFF)
    np.testing.assert_allclose(z[4:], p, atol=5e-4)
    assert np.linalg.norm(difference(z[:4], RotationMatrix(R).ToQuaternion().wxyz())) < 5e-3


def test_the_pose_is_that_of_the_sensors_frame_on_the_link() -> None:
    X_BS = RigidTransform(RollPitchYaw(0.3, -0.2, 0.5), [0.02, -0.03, 0.1])
    R, p = link(HOME)
    z, _ = cloud(X_BS=Pose([0.02, -0.03, 0.1], [0.3, -0.2, 0.5])).align(picture(), HOME + OFF)
    X_WS = RigidTransform(RotationMatrix(R), p) @ X_BS
    np.testing.assert_allclose(z[4:], X_WS.translation(), atol=1e-3)
    assert np.linalg.norm(difference(z[:4], X_WS.rotation().ToQuaternion().wxyz())) < 5e-3


def test_what_all_points_share_is_a_millimetre_and_five_milliradians_unless_told() -> None:
    own, told = (cloud(std=std).align(picture(), HOME + OFF) for std in ([], [0.003, 0.02]))
    np.testing.assert_array_equal(own[0], told[0])
    wanted = np.diag(np.repeat([0.02**2 - 0.005**2, 0.003**2 - 0.001**2], 3))
    np.testing.assert_allclose(told[1] - own[1], wanted, atol=1e-12)


def test_points_of_the_link_alone_are_aligned(monkeypatch: pytest.MonkeyPatch) -> None:
    """All that lies in the ball about the block, 1 cm wider than it, is handed on, about a thousand at most."""
    asked: list[Any] = []
    one, near = cloud(), depth_pose.near

    def spy(points: Array, middle: Array, radius: float, most: int) -> Array:
        asked[:] = [points, middle, radius, most]
        return near(points, middle, radius, most)

    monkeypatch.setattr(depth_pose, "near", spy)
    one.align(picture(), HOME)
    points, middle, radius, most = asked
    R, p = link(HOME)
    np.testing.assert_allclose(middle, p + R @ (0.5 * (LOW + HIGH)), atol=2e-3)
    # The block's own half diagonal, as far as points of its surface tell it, and a centimetre.
    assert radius == pytest.approx(0.5 * np.linalg.norm(HIGH - LOW) + 0.01, abs=1.5e-3)
    assert most == 1000
    met = (points - p) @ R
    on = np.all((met > LOW - 1e-4) & (met < HIGH + 1e-4), axis=1)
    assert np.count_nonzero(on) == np.count_nonzero(picture() < 1.7), "no pixel of the block is left out"


def test_a_point_counts_to_a_centimetre_off_the_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    handed: list[Array] = []
    one = cloud()
    monkeypatch.setattr(one._sensor, "align", lambda points, *_: handed.append(points))
    partners = one._sensor._partners
    one.align(picture(), HOME)
    middle_of_top = np.array([0.01, 0.01, 0.20])
    for off, wanted in ((0.0095, True), (0.0105, False)):
        near = partners(middle_of_top[None] + [0.0, 0.0, off], np.zeros(3), one._sensor._tree).near
        assert near.item() is wanted
    assert len(handed) == 1


def test_the_port_gives_the_pose_at_the_time_of_the_image() -> None:
    one = cloud()
    v = np.array([0.4, -0.3, 0.2, 0.5, -0.2, 0.3, 0.1])
    assert one.GetInputPort("arm_state").size() == 14 and one.GetOutputPort("measurement").size() == 43
    context = one.CreateDefaultContext()
    image = ImageDepth32F(160, 120)
    image.mutable_data[..., 0] = picture()
    one.GetInputPort("depth_image").FixValue(context, Value(image))
    one.GetInputPort("image_time").FixValue(context, [0.7])
    one.GetInputPort("arm_state").FixValue(context, np.concatenate([HOME + 0.05 * v, v]))
    context.SetTime(0.75)
    z, R = one.align(picture(), HOME)
    measurement = one.GetOutputPort("measurement").Eval(context)
    np.testing.assert_allclose(measurement[:7], z, atol=1e-9)
    np.testing.assert_allclose(measurement[7:].reshape(6, 6), R, rtol=1e-6, atol=1e-12)


# The lidar.

X_WL = RigidTransform(RollPitchYaw(0.1, 0.4, 2.8), [1.6, 0.3, 1.0])


def scan(**more: Any) -> ArmScan:
    return ArmScan(terms(), LINK, block(), X_WL, **more)


@functools.cache
def echoes() -> Array:
    """(K, 3) in the lidar's frame: of the block at HOME, of what stands elsewhere, and none."""
    rng = np.random.default_rng(2012)
    R, p = link(HOME)
    ways = p + rng.uniform(LOW, HIGH, (1500, 3)) @ R.T - X_WL.translation()
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    met = X_WL.translation() + meets(X_WL.translation(), ways, HOME)[:, None] * ways
    wall = rng.uniform([-1.0, -1.0, 0.0], [-0.9, 1.0, 2.0], (200, 3))
    points = (np.concatenate([met, wall]) - X_WL.translation()) @ X_WL.rotation().matrix()
    return np.concatenate([points, [[np.inf] * 3, [np.nan, 0.0, 0.0]]])


def test_the_lidar_finds_the_block_and_takes_the_ball_about_it(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    one, near = scan(), lidar_pose.near

    def spy(points: Array, middle: Array, radius: float, most: int) -> Array:
        asked[:] = [points, middle, radius, most]
        return near(points, middle, radius, most)

    monkeypatch.setattr(lidar_pose, "near", spy)
    z, _ = one.align(echoes(), HOME + OFF)
    R, p = link(HOME)
    np.testing.assert_allclose(z[4:], p, atol=3e-3)
    points, middle, radius, most = asked
    R_off, p_off = link(HOME + OFF)
    np.testing.assert_allclose(middle, p_off + R_off @ (0.5 * (LOW + HIGH)), atol=2e-3)
    reach = one._sensor.reach
    assert reach > 0.01 and radius == pytest.approx(0.5 * np.linalg.norm(HIGH - LOW) + reach, abs=1.5e-3)
    assert most == 2000 and np.isfinite(points).all() and len(points) == 1700
    own = (points[:1500] - p) @ R
    np.testing.assert_allclose(np.max(np.maximum(LOW - own, own - HIGH), axis=1), 0.0, atol=1e-9)


def test_what_stands_beside_is_at_its_own_links_pose() -> None:
    rng = np.random.default_rng(2013)
    others = {}
    for name in ("panda_link3", "panda_link5"):
        normals = rng.normal(size=(50, 3))
        others[name] = (rng.normal(0.0, 0.1, (50, 3)), normals / np.linalg.norm(normals, axis=1, keepdims=True))
    found = scan(others=others)._beside(HOME)
    assert found is not None
    for k, (name, (points, normals)) in enumerate(others.items()):
        R, p = LinkFrame(terms(), name).pose(HOME)
        X_WB = RigidTransform(RotationMatrix(R), p)
        rows = slice(50 * k, 50 * (k + 1))
        np.testing.assert_allclose(found[0][rows], (X_WB @ points.T).T, atol=1e-12)
        np.testing.assert_allclose(found[1][rows], (X_WB.rotation().matrix() @ normals.T).T, atol=1e-12)
    assert scan()._beside(HOME) is None and scan(others={})._beside(HOME) is None


def test_the_lidars_port_gives_the_pose_at_the_time_of_the_scan() -> None:
    one = scan(noise=replace(lidar_pose.LIDAR_NOISE, std_0=0.01))
    v = np.array([0.4, -0.3, 0.2, 0.5, -0.2, 0.3, 0.1])
    assert one.GetInputPort("arm_state").size() == 14 and one.GetOutputPort("measurement").size() == 43
    context = one.CreateDefaultContext()
    points = PointCloud(len(echoes()))
    points.mutable_xyzs()[:] = echoes().T
    one.GetInputPort("point_cloud").FixValue(context, Value(points))
    one.GetInputPort("scan_time").FixValue(context, [0.7])
    one.GetInputPort("arm_state").FixValue(context, np.concatenate([HOME + 0.05 * v, v]))
    context.SetTime(0.75)
    z, R = one.align(points.xyzs().T, HOME)
    measurement = one.GetOutputPort("measurement").Eval(context)
    np.testing.assert_allclose(measurement[:7], z, atol=1e-9)
    np.testing.assert_allclose(measurement[7:].reshape(6, 6), R, rtol=1e-6, atol=1e-12)
    assert one.GetOutputPort("measurement_time").Eval(context)[0] == 0.7


def test_points_err_as_usual_or_as_the_data_sheet_and_the_calibration_say() -> None:
    assert point_noise(Camera(), 0.001, 0.005) == PointNoise(floor_p=0.001, floor_r=0.005)
    bad = Camera(depth_noise=DepthNoise("d435", floor=0.002), X_WC_std=[0.006, 0.01], depth_scale_std=0.02)
    found = point_noise(bad, 0.001, 0.005)
    assert (found.std_0, found.growth) == (0.002, 0.0038)
    # At 1.6 m, the middle of the range; a third of each along each axis.
    away = (0.006**2 + (1.6 * 0.01) ** 2 + (1.6 * 0.02) ** 2) / 3.0
    assert found.floor_p == pytest.approx(np.sqrt(0.001**2 + away))
    assert found.floor_r == pytest.approx(np.sqrt(0.005**2 + 0.01**2 / 3.0))


def test_depth_of_a_camera_of_its_own_is_looked_up_on_its_own_grid() -> None:
    wide = replace(AHEAD, lens=Lens(101, 81, 100.0, 50.0, 40.0, 30.0))
    rows, columns = window(wide, np.array([0.0, 0.0, 1.0]), 0.1)
    assert (columns.start, columns.stop) == (40 - 12, 40 + 12) and (rows.start, rows.stop) == (30 - 6, 30 + 6)
