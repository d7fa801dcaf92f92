"""The camera's calibration, found again from a table and an arm of balls seen with the noise of a real camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.synthetic_scene import camera
from twin_diagram.perception import calibration
from twin_diagram.perception.calibration import CalibrationEstimate, KnownSurface, calibrate, corrected
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.scenario import CameraDefects
from twin_diagram.signals.calibration_error import CalibrationError
from twin_diagram.station.sim.camera_noise import DepthNoiseField
from twin_diagram.station.sim.camera_profiles import faults

Array = npt.NDArray[np.float64]
TOLD = replace(camera(160, 120, 150.0), depth_noise=DepthSigma(growth=0.0038))
SHEET = CalibrationError(shift=0.005, turn=np.radians(0.5), focal=0.003, centre=0.25, depth_scale=0.01)
RADIUS = 0.08
OFF = faults(CameraDefects("d435"))


def on_plane(points: Array) -> tuple[Array, Array]:
    return points * [1.0, 1.0, 0.0], np.tile([0.0, 0.0, 1.0], (len(points), 1))


def seen(view: Pinhole, centres: Array, field: Array, scale: float, frame: int) -> list[KnownSurface]:
    """What a camera shows of a table and of balls, of those only where they face it well."""
    rays = view.rays()
    depth = np.where(rays[..., 2] < -0.05, -view.p_WC[2] / np.minimum(rays[..., 2], -0.05), 9.0)
    number = np.full(depth.shape, -1)
    for k, centre in enumerate(centres):
        to = centre - view.p_WC
        b, norm = rays @ to, np.einsum("hwi,hwi->hw", rays, rays)
        root = b**2 - norm * (to @ to - RADIUS**2)
        z = (b - np.sqrt(np.maximum(root, 0.0))) / norm
        hit = (root > 0.3 * norm * RADIUS**2) & (z < depth)
        depth, number = np.where(hit, z, depth), np.where(hit, k, number)
    rms = OFF.depth_noise_floor + OFF.depth_noise * (depth - OFF.depth_noise_start) ** 2
    rough = (depth + rms * field) * scale
    found = []
    for k in range(-1, len(centres)):
        row, column = np.nonzero((number == k) & (depth < 2.0))
        step = 4 if k < 0 else 2  # of the table fewer points do
        kept = (row % step == 0) & (column % step == 0)
        row, column = row[kept], column[kept]
        pixels = np.column_stack([column, row]).astype(float)

        # Its own centre each, not that of the last.
        def on_ball(points: Array, centre: Array = centres[k]) -> tuple[Array, Array]:
            normals = points - centre
            normals /= np.linalg.norm(normals, axis=1, keepdims=True)
            return centre + RADIUS * normals, normals

        found.append(
            KnownSurface(pixels, rough[row, column], on_plane if k < 0 else on_ball, 0.0005, step, frame, k + 1)
        )
    return found


def trial(seed: int, frames: int = 12) -> tuple[Array, CalibrationEstimate]:
    rng = np.random.default_rng([seed, 19])
    errors = rng.standard_normal(10) * np.sqrt(SHEET.variances)
    true, factor = corrected(TOLD, errors)
    noise = DepthNoiseField((120, 160), OFF, seed)
    surfaces = []
    for k in range(frames):
        centres = rng.uniform([0.35, -0.3, 0.1], [0.75, 0.3, 0.45], (6, 3))
        surfaces += seen(true, centres, noise.frame(k), 1.0 / factor, k)
    return errors, calibrate(surfaces, TOLD, SHEET)


@pytest.fixture(scope="module")
def trials() -> list[tuple[Array, CalibrationEstimate]]:
    return [trial(seed) for seed in range(20)]


def test_errors_are_at_least_halved(trials: list[tuple[Array, CalibrationEstimate]]) -> None:
    """Of what is seen of them: of where points at 1 m are shown, and of the scale of depth."""
    before = np.array([errors for errors, _ in trials])
    after = before - np.array([found.errors for _, found in trials])
    for part in (slice(0, 3), slice(3, 6), slice(6, 7)):
        ratio = np.sqrt(np.mean(after[:, part] ** 2) / np.mean(before[:, part] ** 2))
        assert ratio < 0.5, (part, ratio)


def test_claims_are_right(trials: list[tuple[Array, CalibrationEstimate]]) -> None:
    nees = []
    for errors, found in trials:
        off = (errors - found.errors)[:7]
        nees.append(off @ np.linalg.solve(found.covariance[:7, :7], off) / 7)
    assert 0.5 < np.mean(nees) < 1.5, np.mean(nees)


def test_without_noise_it_is_exact_and_without_points_it_is_the_prior() -> None:
    errors = np.array([0.004, -0.006, 0.003, 0.003, -0.004, 0.002, 0.008, 0.0, 0.0, 0.0])
    true, factor = corrected(TOLD, errors)
    centres = np.array([[0.4, -0.2, 0.3], [0.6, 0.2, 0.2], [0.7, -0.1, 0.4], [0.45, 0.15, 0.1]])
    exact = replace(SHEET, focal=1e-7, centre=1e-6, shift=1.0, turn=1.0, depth_scale=1.0)
    surfaces = [replace(s, place_std=0.0) for s in seen(true, centres, np.zeros((120, 160)), 1.0 / factor, 0)]
    found = calibrate(surfaces, TOLD, exact)
    np.testing.assert_allclose(found.errors[:7], errors[:7], atol=2e-5)
    mended, by = found.corrected(TOLD)
    np.testing.assert_allclose(mended.R_WC, true.R_WC, atol=3e-5)
    np.testing.assert_allclose([*mended.p_WC, by], [*true.p_WC, factor], atol=3e-5)
    nothing = calibrate([], TOLD, SHEET)
    np.testing.assert_array_equal(nothing.errors, np.zeros(10))
    np.testing.assert_allclose(nothing.covariance, np.diag(SHEET.variances), rtol=1e-9)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_begun_at_a_wrong_place_of_rest_it_goes_back(sign: float) -> None:
    errors, _ = trial(5, 1)
    true, factor = corrected(TOLD, errors)
    centres = np.array([[0.4, -0.2, 0.3], [0.6, 0.2, 0.2], [0.7, -0.1, 0.4]])
    surfaces = seen(true, centres, np.zeros((120, 160)), 1.0 / factor, 0)
    good = calibrate(surfaces, TOLD, SHEET)
    deviation = np.sqrt(np.diag(good.covariance))
    values, ways = np.linalg.eigh(good.covariance[:6, :6] / deviation[:6, None] / deviation[:6])
    start = good.errors.copy()
    start[:6] += sign * 3.0 * np.sqrt(values[-1]) * ways[:, -1] * deviation[:6]
    again = calibrate(surfaces, TOLD, SHEET, start)
    assert (np.abs(again.errors - good.errors) < 0.1 * deviation).all()


def test_what_is_not_of_the_surface_and_a_place_known_badly_count_less() -> None:
    errors, found = trial(3)
    true, factor = corrected(TOLD, errors)
    centres = np.array([[0.4, -0.2, 0.3], [0.6, 0.2, 0.2], [0.7, -0.1, 0.4]])
    surfaces = seen(true, centres, np.zeros((120, 160)), 1.0 / factor, 0)
    good = calibrate(surfaces, TOLD, SHEET)
    dirty = []
    for surface in surfaces:
        depth = surface.depth.copy()
        depth[::9] -= 0.15
        dirty.append(replace(surface, depth=depth))
    np.testing.assert_allclose(calibrate(dirty, TOLD, SHEET).errors[:7], good.errors[:7], atol=1.2e-3)
    loose = calibrate([replace(s, place_std=0.02) for s in surfaces], TOLD, SHEET)
    assert (np.diag(loose.covariance)[3:6] > np.diag(good.covariance)[3:6]).all()
    assert found.points > good.points > 200


def test_a_camera_is_corrected_by_its_errors() -> None:
    view, factor = corrected(TOLD, np.array([0.0, 0.0, np.pi / 2, 0.1, 0.2, 0.3, 0.25, 0.01, 2.0, -3.0]))
    np.testing.assert_allclose(view.R_WC, np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ TOLD.R_WC, atol=1e-12)
    np.testing.assert_allclose(view.p_WC - TOLD.p_WC, [0.1, 0.2, 0.3])
    assert factor == 0.8 and (view.fx, view.fy) == (151.5, 151.5)
    assert view.centre == (TOLD.centre[0] + 2.0, TOLD.centre[1] - 3.0) and view.focal == 151.5


def test_the_cost_by_which_places_of_rest_are_compared_falls_as_the_steps_say() -> None:
    """Tukey's loss and the prior, weighed against each other as in the equations that led there."""
    centres = np.array([[0.45, -0.2, 0.2], [0.6, 0.2, 0.3], [0.5, 0.0, 0.4]])
    surfaces = [replace(one, place_std=0.0) for one in seen(TOLD, centres, np.zeros((120, 160)), 1.0, 0)]
    together, prior = calibration.pixels_together(surfaces, TOLD.width), SHEET.variances
    at = 0.5 * np.sqrt(prior) * np.random.default_rng(3).standard_normal(10)

    def cost(errors: Array) -> float:
        return calibration._cost(surfaces, together, corrected(TOLD, errors), errors, prior)

    view, wanted = corrected(TOLD, at), -at / prior
    for surface, alike in zip(surfaces, together, strict=True):
        wanted = wanted + calibration._normal_equations(surface, view, alike, 0.0)[1]
    steps = 1e-4 * np.sqrt(prior) * np.eye(10)
    slope = np.array([(cost(at + step) - cost(at - step)) / 2e-4 for step in steps])
    np.testing.assert_allclose(slope, -wanted * np.sqrt(prior), rtol=0.03, atol=0.03 * np.abs(slope).max())
    assert np.abs(wanted + at / prior).max() > 1.0


def test_what_is_seen_again_in_one_place_averages_lasting_noise_no_further() -> None:
    """Of one body and one square of the image; patches of white noise are anew in each frame."""

    def shown(frame: int, body: int, column: float) -> KnownSurface:
        return KnownSurface(np.array([[column, 10.0]]), np.ones(1), nowhere, frame=frame, body=body)

    def nowhere(points: Array) -> tuple[Array, Array]:
        return points, points

    told, side = calibration.TUNING, calibration.TUNING.cell
    surfaces = [shown(0, 1, 5.0), shown(1, 1, 6.0), shown(1, 2, 5.0), shown(1, 1, side + 5.0), shown(1, 1, 7.0)]
    twice, once = told.patch + 2.0 * told.lasting, told.patch + told.lasting
    found = [float(one[0]) for one in calibration.pixels_together(surfaces, 640)]
    assert found == [twice, twice, once, once, twice]
    # In an image half as wide a square has half the pixels across.
    small = [replace(one, pixels=0.5 * one.pixels) for one in surfaces]
    assert [float(one[0]) for one in calibration.pixels_together(small, 320)] == [x / 4.0 for x in found]


def test_the_prior_and_a_surfaces_own_place_cost_what_they_should() -> None:
    """Half a squared deviation each; of points that are all aside by d, where they and the place may be: ½ d² / var."""
    prior = SHEET.variances
    at = 0.5 * np.sqrt(prior) * np.arange(1.0, 11.0)
    wanted = 0.5 * 0.25 * np.sum(np.arange(1.0, 11.0) ** 2)
    assert calibration._cost([], [], corrected(TOLD, at), at, prior) == pytest.approx(wanted)
    ahead, aside = TOLD.R_WC[:, 2], 2e-4

    def nearest(points: Array) -> tuple[Array, Array]:
        return points + aside * ahead, np.tile(-ahead, (len(points), 1))

    pixels = np.array([[80.0 + x, 60.0 + y] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
    place_std, alone = 0.002, np.ones(9)
    surface = KnownSurface(pixels, np.ones(9), nearest, place_std)
    cost = calibration._cost([surface], [alone], (TOLD, 1.0), np.zeros(10), prior)
    variance = place_std**2 + float(TOLD.depth_noise(np.array(1.0))) ** 2 / 9.0
    assert cost == pytest.approx(0.5 * aside**2 / variance, rel=0.02)
