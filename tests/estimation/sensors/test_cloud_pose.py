"""Poses of clouds of exact points: where they go, and what is claimed of them, against least squares by hand."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.math import RigidTransform, RotationMatrix

from tests.estimation.small_arms import gantry
from twin_diagram.estimation.sensors import CloudError, DepthCloud, PointNoise
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.rotations import difference, exp, matrix

ARM = gantry()
Q = np.array([0.3, -0.2])
ORIGIN = np.array([0.3, -0.2, 2.0])
"""Of the sensor: two metres above the car."""


def faces(*axes: int, count: int = 7, size: float = 0.05) -> tuple[Array, Array]:
    """Points on faces of a box of 0.1 m, and their normals; faces 0, 1, 2 look along x, y, z."""
    points, normals = [], []
    for axis in axes:
        grid = np.stack(np.meshgrid(*[np.linspace(-size, size, count)] * 2), axis=-1).reshape(-1, 2)
        face = np.insert(grid, axis, 0.05, axis=1)
        points.append(face)
        normals.append(np.tile(np.eye(3)[axis], (len(face), 1)))
    return np.vstack(points), np.vstack(normals)


def cloud(surface: tuple[Array, Array], **more: object) -> DepthCloud:
    return DepthCloud(ARM, "car", *surface, **more)  # type: ignore[arg-type]


def middle_of(surface: tuple[Array, Array]) -> Array:
    return np.asarray(0.5 * (surface[0].min(axis=0) + surface[0].max(axis=0)))


def test_a_point_errs_more_with_the_square_of_its_distance() -> None:
    found = cloud(faces(2)).variance(np.array([0.0, 0.5, 2.0]))
    np.testing.assert_allclose(found, 0.001**2 + (0.002 * np.array([0.0, 0.25, 4.0])) ** 2)


def test_exact_points_give_the_pose_and_its_information() -> None:
    """A corner of a box, turned and moved a little: R is the inverse information about the middle, carried to O."""
    surface = faces(0, 1, 2, size=0.035)
    noise = PointNoise(std_0=0.002, growth=0.0, floor_p=0.0007, floor_r=0.003)
    sensor, turn, way = cloud(surface, noise=noise), np.array([0.01, -0.008, 0.012]), np.array([0.001, -0.002, 0.0015])
    p_WO = np.array([*Q, 0.0]) + way
    R = matrix(exp(turn))
    z, cov = sensor.align(surface[0] @ R.T + p_WO, ORIGIN, Q)
    np.testing.assert_allclose(difference(z[:4], np.array([1.0, 0, 0, 0])), turn, atol=2e-4)
    np.testing.assert_allclose(z[4:], p_WO, atol=2e-5)
    R = RotationMatrix(matrix(z[:4])).matrix()
    information, middle = np.diag([1.0] * 3 + [1.0 / 0.09] * 3), middle_of(surface)
    for point, normal in zip(*surface, strict=True):
        n = R @ normal
        row = np.concatenate([np.cross(R @ (point - middle), n), n])
        information += np.outer(row, row) / 0.002**2
    about = np.eye(6)
    for k, unit in enumerate(np.eye(3)):
        about[3:, k] = np.cross(unit, -(R @ middle))  # a turn about the middle moves O, which lies at minus it
    expected = about @ np.linalg.inv(information) @ about.T + np.diag([0.003**2] * 3 + [0.0007**2] * 3)
    np.testing.assert_allclose(cov, expected, rtol=2e-2, atol=2e-9)


@pytest.mark.parametrize(("std", "offset"), [(0.3, 0.02), (0.05, 0.02), (0.3, 0.06)])
def test_where_points_say_little_a_pose_stays_near_the_prediction(std: float, offset: float) -> None:
    """A face lifted by a known way: the maximum of a posterior with 3 cm of search, Cauchy's weights on the gaps."""
    surface = faces(2, count=5)
    sensor = cloud(surface, noise=PointNoise(std_0=std, growth=0.0), reach=0.2)
    p_WO = np.array([*Q, 0.0])
    z, cov = sensor.align(surface[0] + p_WO + [0.0, 0.0, offset], ORIGIN, Q)
    lifted = 0.0
    for _ in range(500):
        weight = 25.0 / (std**2 + (offset - lifted) ** 2 / 9.0)
        lifted = weight * offset / (weight + 1.0 / 0.03**2)
    assert z[6] == pytest.approx(lifted, rel=2e-3)
    np.testing.assert_allclose(z[4:6], Q, atol=1e-9)
    weight = 25.0 / (std**2 + (offset - lifted) ** 2 / 9.0)
    assert cov[5, 5] == pytest.approx(1.0 / (weight + 1.0 / 0.3**2) + 0.0005**2, rel=2e-3)
    # What a plane does not tell: its own turn by a radian, its own way by 0.3 m.
    assert cov[2, 2] == pytest.approx(1.0 + 0.002**2, rel=1e-6)
    assert cov[3, 3] == pytest.approx(0.09 + cov[1, 1] * 0.05**2, rel=0.05)


def test_points_that_lie_farther_off_than_their_noise_make_the_pose_less_sure() -> None:
    """Half of them 2 σ above and half below: what is claimed grows by the median's ratio."""
    surface = faces(2, count=8)
    sensor = cloud(surface, noise=PointNoise(std_0=0.001, growth=0.0, floor_p=1e-9))
    sign = np.where(np.arange(64) % 2 == (np.arange(64) // 8) % 2, 1.0, -1.0)
    for off, ratio in ((0.0, 1.0), (0.5e-3, 1.0), (2e-3, 4.0 / 0.4549)):
        points = surface[0] + [*Q, 0.0] + np.outer(off * sign, [0.0, 0.0, 1.0])
        _, cov = sensor.align(points, ORIGIN, Q)
        weight = 64.0 / (1e-6 + off**2 / 9.0)
        assert cov[5, 5] == pytest.approx(ratio / weight, rel=1e-2)


@pytest.mark.parametrize(("sigmas", "strange"), [(1.99, False), (2.05, True)])
def test_points_are_of_something_else_beyond_three_times_their_noise(sigmas: float, strange: bool) -> None:
    """By the median of squares, over that of a normal variate: 2.02 σ all alike."""
    surface = faces(2, count=8)
    sensor = cloud(surface, noise=PointNoise(std_0=0.001, growth=0.0))
    sign = np.where(np.arange(64) % 2 == (np.arange(64) // 8) % 2, 1.0, -1.0)
    points = surface[0] + [*Q, 0.0] + np.outer(1e-3 * sigmas * sign, [0.0, 0.0, 1.0])
    if strange:
        with pytest.raises(CloudError, match=r"3\.\d times their noise"):
            sensor.align(points, ORIGIN, Q)
    else:
        sensor.align(points, ORIGIN, Q)


def test_twelve_points_within_reach_make_a_pose() -> None:
    surface = faces(2, count=8)
    p_WO = np.array([*Q, 0.0])
    sensor = cloud(surface, reach=0.02)
    points = surface[0] + p_WO
    for count, enough in ((12, True), (11, False)):
        rest = points[count : count + 20] + [0.0, 0.0, 0.5]
        told = np.vstack([points[:count], rest, np.full((3, 3), np.nan)])
        if enough:
            z, _ = sensor.align(told, ORIGIN, Q)
            np.testing.assert_allclose(z[4:], p_WO, atol=1e-9)
        else:
            with pytest.raises(CloudError, match="11 points"):
                sensor.align(told, ORIGIN, Q)
    for far, near, reach in ((0.0199, True, 0.02), (0.0201, False, 0.02), (0.0299, True, 0.0), (0.0301, False, 0.0)):
        more = {"reach": reach} if reach else {}  # three centimetres where none is told
        sensor = cloud(surface, noise=PointNoise(std_0=10.0, growth=0.0), **more)
        if near:
            sensor.align(points + [0.0, 0.0, far], ORIGIN, Q)
        else:
            with pytest.raises(CloudError, match="0 points"):
                sensor.align(points + [0.0, 0.0, far], ORIGIN, Q)
    for wrong in (surface[0][:11], surface[0][:, :2]):
        with pytest.raises(CloudError, match="both must be"):
            cloud((wrong, wrong))
    cloud((surface[0][:12], surface[1][:12]))
    with pytest.raises(CloudError):
        cloud((surface[0], surface[1][:-1]))


@pytest.mark.parametrize(("offset", "astray"), [(0.0899, False), (0.0905, True)])
def test_a_search_goes_astray_beyond_three_of_its_deviations(offset: float, astray: bool) -> None:
    """9 cm."""
    surface = faces(2, count=8)
    sensor = cloud(surface, reach=0.3, noise=PointNoise(std_0=1e-4, growth=0.0))
    points = surface[0] + [*Q, offset]
    if astray:
        with pytest.raises(CloudError, match=r"astray, by 0\.09"):
            sensor.align(points, ORIGIN, Q)
    else:
        assert sensor.align(points, ORIGIN, Q)[0][6] == pytest.approx(offset, rel=1e-3)


def test_a_search_that_does_not_settle_adds_the_scatter_of_its_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A surface that follows the search about: the second half of its path scatters by what it was led."""
    surface = faces(2, count=6)
    sensor = cloud(surface, reach=0.3, noise=PointNoise(std_0=0.01, growth=0.0))
    points = surface[0] + [*Q, 0.0]
    led = 0.002 * np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 2.0, -1.0, 1.0, -1.0])
    told: list[float] = []
    partners = DepthCloud._partners

    def leading(self: DepthCloud, at: Array, origin: Array, known: object) -> object:
        told.append(float(led[len(told)]))
        self._normals = surface[1]
        self._surface = surface[0] + [0.0, 0.0, at[0, 2] - 0.05 - told[-1]]
        return partners(self, at, origin, known)

    monkeypatch.setattr(DepthCloud, "_partners", leading)
    _, cov = sensor.align(points, ORIGIN, Q)
    assert len(told) == 10
    path = np.cumsum(led)
    scatter = np.mean((path[5:] - path[-1]) ** 2)
    assert cov[5, 5] == pytest.approx(scatter + 0.0005**2 + 1e-4 / 36.0, rel=3e-2)


def test_a_search_ends_where_its_steps_are_a_thousandth_of_its_deviations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps of 3 cm and 0.2 rad, over a thousand."""
    surface, partners = faces(2, count=6), DepthCloud._partners
    for step, settles in ((2.9e-5, True), (3.1e-5, False)):
        sensor = cloud(surface, reach=0.3, noise=PointNoise(std_0=1e-4, growth=0.0))
        count = 0

        def leading(self: DepthCloud, at: Array, origin: Array, known: object, step: float = step) -> object:
            nonlocal count
            count += 1
            self._surface = surface[0] + [0.0, 0.0, at[0, 2] - 0.05 - step]
            return partners(self, at, origin, known)

        with monkeypatch.context() as patch:
            patch.setattr(DepthCloud, "_partners", leading)
            sensor.align(surface[0] + [*Q, 0.0], ORIGIN, Q)
        assert (count == 1) == settles


def test_a_frame_on_the_link_may_be_anywhere() -> None:
    surface = faces(0, 1, 2)
    X_BO = RigidTransform(RotationMatrix(matrix(exp(np.array([0.3, 0.2, 0.1])))), [0.1, 0.2, 0.3])
    sensor = cloud(surface, X_BO=X_BO, noise=PointNoise(std_0=1e-4, growth=0.0))
    R, p = sensor.frame.pose(Q)
    z, _ = sensor.align(surface[0] @ R.T + p + [0.001, 0.0, -0.001], ORIGIN, Q)
    np.testing.assert_allclose(z[4:], p + [0.001, 0.0, -0.001], atol=2e-5)
    np.testing.assert_allclose(matrix(z[:4]), R, atol=1e-4)
