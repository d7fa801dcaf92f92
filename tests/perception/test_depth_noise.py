"""The told noise of depth, and by how much it was told too small."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.errors import ScenarioError
from twin_diagram.perception.depth_noise import DepthSigma, _second, excess_of, measured
from twin_diagram.scenario import DepthNoise
from twin_diagram.signals.arrays import Array
from twin_diagram.station.sim.camera_noise import correlated


@pytest.mark.parametrize(
    ("sheet", "wanted"),
    [
        ("ideal", [0.2e-3, 0.8e-3, 3.2e-3]),
        ("d415", [0.375e-3, 1.5e-3, 6.0e-3]),
        ("d435", [0.95e-3, 3.8e-3, 15.2e-3]),
        ("kinect1", [1.219e-3, 1.884e-3, 6.064e-3]),
    ],
)
def test_sheets_say_how_noise_grows(sheet: str, wanted: list[float]) -> None:
    np.testing.assert_allclose(DepthSigma.of(DepthNoise(sheet))(np.array([0.5, 1.0, 2.0])), wanted, rtol=1e-9)


def test_figures_win_over_the_sheet_and_none_means_the_old_noise() -> None:
    own = DepthSigma.of(DepthNoise("kinect1", floor=0.002, growth=0.001, start=0.5))
    assert own(np.array(1.5)) == pytest.approx(0.003)
    assert DepthSigma.of(DepthNoise("kinect1", growth=0.0)) == DepthSigma(0.0012, 0.0, 0.4, 0.6, 0.3)
    assert DepthSigma() == DepthSigma.of(DepthNoise()) == DepthSigma(0.0, 0.0008, 0.0, 0.0, 0.0)
    with pytest.raises(ScenarioError, match=r"depth_noise\.sheet: .*d405"):
        DepthSigma.of(DepthNoise("d405"))


def excess(residual: Array, sigma: Array) -> float:
    return excess_of(float(np.median(np.abs(residual) / sigma)), len(residual))


def test_residuals_say_by_how_much_a_sheet_promises_too_much() -> None:
    rng = np.random.default_rng(8)
    sigma = rng.uniform(0.001, 0.004, 4000)
    residual = rng.standard_normal(4000) * sigma
    assert excess(residual, sigma / 2.0) == pytest.approx(2.0, rel=0.05)
    assert excess(residual, 2.0 * sigma) == 1.0
    residual[:400] = 0.1  # what is not of the object
    assert excess(residual, sigma / 2.0) == pytest.approx(2.2, rel=0.1)
    assert excess(np.full(29, 1.0), np.full(29, 0.1)) == 1.0 < excess(np.full(30, 1.0), np.full(30, 0.1))


def planes(seed: int) -> tuple[np.ndarray, np.random.Generator]:
    """A sloping plane with a step, a hole and a ball, 640 × 480 [m]."""
    v, u = np.mgrid[:480, :640].astype(float)
    depth = 1.0 / (1.0 + 4e-4 * (u - 320) - 6e-4 * (v - 240))
    depth[100:250, 200:400] -= 0.1
    ball = (u - 500) ** 2 + (v - 300) ** 2
    depth = np.where(ball < 60.0**2, depth - 1e-3 * np.sqrt(np.maximum(60.0**2 - ball, 0.0)), depth)
    depth[300:330, 50:150] = 0.0
    return depth, np.random.default_rng(seed)


@pytest.mark.parametrize("sheet", ["ideal", "d415", "d435"])
def test_a_picture_shows_its_noise(sheet: str) -> None:
    depth, rng = planes(3)
    told = DepthSigma.of(DepthNoise(sheet))
    field = np.sqrt(1.0 - told.correlated - told.lasting) * rng.standard_normal(depth.shape)
    field += np.sqrt(told.correlated) * correlated(depth.shape, 2.5, rng)
    field += np.sqrt(told.lasting) * correlated(depth.shape, 15.0, rng)
    found = measured(depth + np.where(depth > 0.0, told(depth) * field, 0.0))
    assert found.growth == pytest.approx(told.growth, rel=0.1)
    assert found.correlated == pytest.approx(told.correlated, abs=0.05)
    assert found.lasting == pytest.approx(told.lasting, abs=0.05)


@pytest.mark.parametrize("size", [(0.05, 0.15), (0.03, 0.08)])
def test_many_edges_are_no_patches(size: tuple[float, float]) -> None:
    """Things on a table, and a twentieth of them in the way of each other: a renderer's noise stays white."""
    rng, (depth, _) = np.random.default_rng(6), planes(6)
    for _ in range(round(0.4 * depth.size / 640**2 / np.mean(size) ** 2)):
        (height, width), high = (640 * rng.uniform(*size, 2)).astype(int), rng.uniform(0.05, 0.2)
        v, u = rng.integers(0, 480 - height), rng.integers(0, 640 - width)
        depth[v : v + height, u : u + width] -= high
    told = DepthSigma.of(DepthNoise("ideal"))
    found = measured(depth + np.where(depth > 0.0, told(depth) * rng.standard_normal(depth.shape), 0.0))
    assert (found.correlated, found.lasting) == (0.0, 0.0)
    assert found.growth == pytest.approx(told.growth, rel=0.1)
    told = DepthSigma.of(DepthNoise("d415"))
    field = np.sqrt(1.0 - told.correlated) * rng.standard_normal(depth.shape)
    field += np.sqrt(told.correlated) * correlated(depth.shape, 2.5, rng)
    assert measured(depth + np.where(depth > 0.0, told(depth) * field, 0.0)).correlated > 0.3


def test_a_picture_without_noise_or_with_little_in_it_has_the_least() -> None:
    depth, _ = planes(3)
    least = DepthSigma(growth=0.0002)
    assert measured(depth) == measured(np.zeros((480, 640))) == measured(depth[:30, :60]) == least


def told_in_file(disparity: Array, unit: float) -> Array:
    """Depth [m] of disparities of a focal length times baseline of 43.5 px m, as a file of such a unit holds it."""
    return np.asarray(np.float32(np.round(43.5 / disparity / unit) * unit))


@pytest.mark.parametrize("unit", [0.001, 0.0001])
def test_who_rounds_disparities_has_what_lasts_and_a_renderers_noise_stays_white(unit: float) -> None:
    depth, rng = planes(4)
    there = depth > 0.0
    disparity = 43.5 / np.where(there, depth, 1.0) + 0.06 * rng.standard_normal(depth.shape)
    smooth, rounded = (
        measured(np.where(there, told_in_file(each, unit), 0.0))
        for each in (disparity, np.round(disparity * 8.0) / 8.0)
    )
    assert smooth.growth == pytest.approx(0.06 / 43.5, rel=0.1)
    assert (smooth.correlated, smooth.lasting) == (0.0, 0.0)
    white = np.sqrt(0.06**2 + 0.125**2 / 12.0) / 43.5
    assert rounded.growth == pytest.approx(white * np.sqrt(1.5), rel=0.1)
    assert rounded.lasting == pytest.approx(1.0 / 3.0)


@pytest.mark.parametrize("unit", [0.001, 0.002])
def test_a_files_steps_are_no_patches_and_hide_no_noise_of_a_third_of_one(unit: float) -> None:
    v, u = np.mgrid[:480, :640].astype(float)
    sloping = 1.0 / (1.0 / 0.9 + 0.5 * (v - 240) / 550 + 0.1 * (u - 320) / 550)
    for depth in (sloping, planes(3)[0]):
        smooth = measured(np.float32(np.round(depth / unit) * unit))
        assert (smooth.correlated, smooth.lasting, smooth.growth) == (0.0, 0.0, 0.0002)
        assert smooth.floor == pytest.approx(unit / np.sqrt(12.0), rel=1e-3)
        noise = unit / 3.0 * np.random.default_rng(5).standard_normal(depth.shape)
        noisy = measured(np.where(depth > 0.0, np.round((depth + noise) / unit) * unit, 0.0))
        assert noisy.floor == 0.0 < 0.8 * unit / 3.0 < noisy.growth * float(np.median(depth)) ** 2


def test_steps_of_disparity_alone_are_a_cameras() -> None:
    v, u = np.mgrid[:480, :640].astype(float)
    sloping = 43.5 * (1.0 / 0.9 + 0.2 * (v - 240) / 550 + 0.04 * (u - 320) / 550)
    found = measured(told_in_file(np.round(sloping * 8.0) / 8.0, 0.0001))
    assert found.floor == 0.0 < found.lasting


@pytest.mark.parametrize("lag", [1, 3, 10])
def test_second_differences_of_patches(lag: int) -> None:
    field = np.concatenate([correlated((480, 640), 2.5, np.random.default_rng(k)) for k in range(4)])
    second = field[:, : -2 * lag] - 2.0 * field[:, lag:-lag] + field[:, 2 * lag :]
    assert _second(lag, 2.5) == pytest.approx(float(second.var()), rel=0.05)
