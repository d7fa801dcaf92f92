"""Depth noise of real cameras, measured: how much, how much of it white, correlated, fixed for the run."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from twin_diagram.scenario import CameraDefects
from twin_diagram.station.sim.camera_noise import DepthNoiseField, correlated
from twin_diagram.station.sim.camera_profiles import CameraFaults, faults
from twin_diagram.station.sim.picture_kernels import delivered

SHAPE = (240, 320)
"""Half of 640 px: figures in pixels are half, too."""
D435 = faults(CameraDefects("d435"))


@pytest.fixture(scope="module")
def frames() -> npt.NDArray[np.float32]:
    field = DepthNoiseField(SHAPE, D435, seed=5)
    return np.array([field.frame(k) for k in range(60)])


@pytest.mark.parametrize(
    ("profile", "wanted"),
    [("d415", [0.54, 1.5, 6.0]), ("d435", [1.368, 3.8, 15.2]), ("kinect1", [1.276, 1.884, 6.064])],
)
def test_the_rms_is_the_formulas(profile: str, wanted: list[float]) -> None:
    off = faults(CameraDefects(profile))
    depth = np.array([0.6, 1.0, 2.0], dtype=np.float32)
    seen = with_error(depth, np.full(3, 10.0, dtype=np.float32), off, (0.1, 3.0), 1.0)
    np.testing.assert_allclose(100.0 * (seen - depth), wanted, rtol=1e-3, atol=2e-3)


def with_error(
    depth: npt.NDArray[np.float32],
    error: npt.NDArray[np.float32],
    off: CameraFaults,
    reach: tuple[float, float],
    scale: float,
    unit: float = 1e-5,
    most: float = 1e6,
) -> npt.NDArray[np.float32]:
    result, single = depth.copy(), np.float32
    law = (single(off.depth_noise_start), single(off.depth_noise), single(off.depth_noise_floor))
    units = (single(1.0 / unit), unit, single(most))
    delivered(result, error, law, (single(reach[0]), single(reach[1])), single(scale), units)
    return result


def test_depth_is_delivered_within_its_range_in_whole_units() -> None:
    depth = np.array([0.0, 0.29, 0.31, 1.0, 1.98, 2.5], dtype=np.float32)
    error = np.array([9.0, 0.0, -100.0, 0.0, 0.0, -150.0], dtype=np.float32)
    seen = with_error(depth, error, faults(CameraDefects("d415")), (0.3, 2.0), 1.01, 0.001, 1500.0)
    # None stays none; too near, or by its error; scaled; more units than are told; within the range by its error.
    np.testing.assert_allclose(seen, [0.0, 0.0, 0.0, 1.01, 1.5, 1.105], atol=1e-6)
    assert seen[3] == np.float32(1010 * 0.001)


def test_all_of_it_has_variance_one(frames: npt.NDArray[np.float32]) -> None:
    assert frames.var() == pytest.approx(1.0, rel=0.02)
    assert abs(frames.mean()) < 0.01
    centre, rim = frames[:, 100:140, 140:180], np.concatenate([frames[:, :3].ravel(), frames[:, :, -3:].ravel()])
    assert rim.var() == pytest.approx(1.0, rel=0.25) and centre.var() == pytest.approx(1.0, rel=0.25)
    # What is anew each frame has the same variance up to the rim.
    fresh = frames - frames.mean(axis=0)
    assert np.concatenate([fresh[:, :3].ravel(), fresh[:, :, -3:].ravel()]).var() == pytest.approx(0.7, rel=0.04)


def test_three_tenths_are_fixed_for_the_run_and_another_runs_are_others(frames: npt.NDArray[np.float32]) -> None:
    between = frames[:-1] * frames[1:]
    assert between.mean() == pytest.approx(0.3, abs=0.02)
    assert (frames[0] * frames[59]).mean() == pytest.approx(0.3, abs=0.06)
    own, other = DepthNoiseField(SHAPE, D435, seed=5), DepthNoiseField(SHAPE, D435, seed=6)
    assert own.waves.std() == pytest.approx(np.sqrt(0.3), rel=1e-3)
    assert abs(np.corrcoef(own.waves.ravel(), other.waves.ravel())[0, 1]) < 0.4
    assert abs((own.frame(3) - own.waves).ravel() @ (other.frame(3) - other.waves).ravel()) / own.waves.size < 0.05


def test_correlation_over_pixels_is_that_of_two_gaussians_and_a_tenth_is_white(
    frames: npt.NDArray[np.float32],
) -> None:
    fresh = (frames - frames.mean(axis=0)) * np.sqrt(60 / 59)
    for axis in (1, 2):
        for d in (1, 2, 3, 5):
            at = np.moveaxis(fresh, axis, 1)
            product = (at[:, :-d] * at[:, d:]).mean()
            assert product == pytest.approx(0.6 * np.exp(-(d**2) / (4 * 1.25**2)), abs=0.012), (axis, d)
    assert (fresh**2).mean() == pytest.approx(0.7, abs=0.015)
    waves = np.mean([DepthNoiseField(SHAPE, D435, seed).waves[:, :-8] * DepthNoiseField(SHAPE, D435, seed).waves[:, 8:]
                     for seed in range(4)])  # fmt: skip
    assert waves == pytest.approx(0.3 * np.exp(-(8**2) / (4 * 7.5**2)), abs=0.02)


def test_noise_is_a_function_of_seed_and_frame(frames: npt.NDArray[np.float32]) -> None:
    again = DepthNoiseField(SHAPE, D435, seed=5)
    np.testing.assert_array_equal(again.frame(7), frames[7])
    np.testing.assert_array_equal(again.frame(3), frames[3])
    assert (again.frame(3) != frames[4]).mean() > 0.99


def test_a_field_is_normal() -> None:
    field = correlated((400, 400), 2.0, np.random.default_rng(3))
    assert field.std() == pytest.approx(1.0, rel=0.03)
    assert np.mean(np.abs(field) > 2.0) == pytest.approx(0.0455, abs=0.006)


def test_the_figures_in_pixels_scale_with_the_width() -> None:
    wide = DepthNoiseField((60, 640), faults(CameraDefects("d435", white_share=0.0, wave_share=0.0)), 1)
    found = np.mean([(f[:, :-5] * f[:, 5:]).mean() for f in map(wide.frame, range(20))])
    assert found == pytest.approx(np.exp(-(5**2) / (4 * 2.5**2)), abs=0.02)
