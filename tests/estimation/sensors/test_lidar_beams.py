"""Which surface a beam meets: borders of what is hidden, beside, astray; by a few points each, a metre away."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.small_arms import gantry
from twin_diagram.estimation.sensors import LIDAR_NOISE, CloudError, LidarPose
from twin_diagram.estimation.sensors.lidar_pose import apart, visible
from twin_diagram.signals.arrays import Array

ARM = gantry()
EYE = np.array([0.0, 0.0, 1.0])
"""Where the lidar stands: a metre above the surface, whose normals look up."""
UP = np.array([0.0, 0.0, 1.0])


def plate(count: int = 9, spacing: float = 0.02, z: float = 0.0) -> Array:
    line = spacing * (np.arange(count) - count // 2)
    return np.stack([*np.meshgrid(line, line), np.full((count, count), z)], axis=-1).reshape(-1, 3)


def ups(points: Array) -> Array:
    return np.tile(UP, (len(points), 1))


def lidar(surface: Array, normals: Array | None = None, **more: float) -> LidarPose:
    return LidarPose(ARM, "car", surface, ups(surface) if normals is None else normals, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(("beside", "hides"), [(0.0058, True), (0.0062, False)])
def test_a_point_hides_another_that_lies_within_six_millimetres_beside_it(beside: float, hides: bool) -> None:
    points = np.vstack([plate(), [[0.05, 0.05, 0.0]]])
    points[-1] = [beside, 0.0, -0.02]  # below the plate's middle
    points[-1, :2] *= 1.02
    seen = visible(points, ups(points), EYE)
    assert seen[:-1].all() and seen[-1] != hides


@pytest.mark.parametrize(("below", "hides"), [(0.0048, False), (0.0052, True)])
def test_and_half_a_centimetre_below_its_surface(below: float, hides: bool) -> None:
    points = np.vstack([plate(), [[0.002, 0.0, -below]]])
    assert visible(points, ups(points), EYE)[-1] != hides
    points = np.vstack([[[0.002, 0.0, -below]], plate()])  # in whatever order they come
    assert visible(points, ups(points), EYE)[0] != hides
    assert not visible(points, -ups(points), EYE).any()
    level = visible(np.array([[0.5, 0.0, 1.0], [0.0, 0.0, 0.0]]), ups(points)[:2], EYE)
    np.testing.assert_array_equal(level, [False, True])  # what is seen edge on is not seen


@pytest.mark.parametrize(
    ("at", "height", "hidden"),
    [
        (0.0, 0.0102, True),  # another link's point before it, a centimetre nearer
        (0.0, 0.0098, False),
        (0.0, -0.1, False),
        (0.0148, 0.2, True),  # within a centimetre and a half of the beam
        (0.0152, 0.2, False),
    ],
)
def test_what_another_link_hides(at: float, height: float, hidden: bool) -> None:
    surface = plate(5, 0.04)
    middle = len(surface) // 2
    other = np.array([[at * (1.0 - height), 0.0, height]])
    free, met = apart(surface, (other, ups(other)), surface, EYE)
    assert free[middle] != hidden
    assert free.sum() == 25 - hidden
    turned, _ = apart(surface, (other, -ups(other)), surface, EYE)  # its back is not there to hide anything
    assert turned.all()
    assert not hidden or not met[middle]


def test_nothing_is_met_where_all_is_hidden() -> None:
    surface, lid = plate(3), plate(9, 0.01, 0.3)
    free, met = apart(surface, (lid, ups(lid)), plate(5), EYE)
    assert not free.any() and not met.any() and len(met) == 25


@pytest.mark.parametrize(("past", "meets"), [(0.0098, True), (0.0102, False)])
def test_a_beam_meets_what_it_passes_by_less_than_a_centimetre(past: float, meets: bool) -> None:
    surface, far = plate(5, 0.03), np.array([[9.0, 0.0, -3.0]])
    for reach in (1.0, 0.5):  # whatever range was measured along it
        beam = EYE + reach * (np.array([[0.06 + past, 0.0, 0.0]]) - EYE)
        _, met = apart(surface, (far, ups(far)), beam, EYE)
        assert met[0] == meets


@pytest.mark.parametrize(
    ("place", "height", "kept"),
    [
        (0.0148, 0.0, False),  # beside it: it may meet that one
        (0.0152, 0.0, True),
        (0.012, -0.05, False),
        (0.0075, -0.05, True),  # behind what is in front of it by eight millimetres: it cannot be met
        (0.0085, -0.05, False),
    ],
)
def test_a_beam_that_may_meet_another_link_is_left_out(place: float, height: float, kept: bool) -> None:
    """Of a single point of the link, and a beam upon it."""
    surface = np.array([[0.0, 0.0, 0.0]])
    other = np.array([[place * (1.0 - height), 0.0, height]])
    _, met = apart(surface, (other, ups(other)), surface, EYE)
    assert met[0] == kept


def test_gaps_are_as_large_as_noise_along_the_beam_spacing_and_doubt() -> None:
    sensor = lidar(plate())
    variance, slant, doubt = np.array([1e-4, 4e-4]), np.array([-1.0, -0.5]), np.array([0.0, 0.03])
    expected = [1e-4 + 0.004**2, (4e-4 + 9e-4) * 0.25 + 0.004**2]
    np.testing.assert_allclose(sensor._square(variance, slant, doubt), expected)
    np.testing.assert_allclose(sensor.variance(np.array([1.0, 2.0])), [1e-4 + 25e-6, 1e-4 + 16.0 * 25e-6])
    assert (LIDAR_NOISE.std_0, LIDAR_NOISE.growth) == (0.01, 0.005)


@pytest.mark.parametrize(("off", "near"), [(0.99, True), (1.01, False), (-0.99, True), (-1.01, False)])
def test_a_point_is_left_out_by_its_range_beyond_three_deviations_and_reach(off: float, near: bool) -> None:
    surface, shown = plate(), np.arange(81)
    sensor = lidar(surface, reach=0.02)
    range_ = 1.0
    for _ in range(50):
        range_ = 1.0 + off * (0.02 + 3.0 * np.hypot(0.01, 0.005 * range_**2))
    found = sensor._partners(np.array([[0.0, 0.0, 1.0 - range_]]), EYE, shown)
    assert found.near[0] == near and found.index[0] == 40


@pytest.mark.parametrize(("past", "near"), [(0.0295, True), (0.0305, False)])
def test_a_beam_that_passes_by_three_centimetres_has_no_partner(past: float, near: bool) -> None:
    surface = plate(3, 0.01)
    beam = np.array([[0.01 + past, 0.0, 0.0]])
    assert lidar(np.vstack([surface, surface]))._partners(beam, EYE, np.arange(9)).near[0] == near


def test_doubt_is_half_the_range_of_where_the_nearest_four_points_are_met() -> None:
    """Faces that a beam meets at its own cosine, or at a twentieth where that is less."""
    spots = np.array([[0.0, 0.0, 0.0], [0.002, 0.0, 0.0], [0.0, 0.003, 0.0], [0.0, 0.0, -0.04], [0.011, 0.0, 0.3]])
    surface = np.vstack([spots, plate(3, 0.05, -0.2)])
    normals = ups(surface)
    sensor = lidar(surface, normals)
    found = sensor._partners(np.array([[0.0, 0.0, 0.1]]), EYE, np.arange(5))
    assert found.doubt[0] == pytest.approx(0.5 * 0.04)
    normals[2] = [0.0, np.sqrt(1.0 - 0.02**2), 0.02]  # all but along the beam
    sensor = lidar(surface, normals)
    meets = [1.0, (normals[2] @ (surface[2] - EYE)) / -0.05, 1.04]
    found = sensor._partners(np.array([[0.0, 0.0, 0.1]]), EYE, np.arange(5))
    assert found.doubt[0] == pytest.approx(0.5 * (max(meets) - min(meets)), rel=1e-6)
    few = sensor._partners(np.array([[0.0, 0.0, 0.1]]), EYE, np.array([0, 3]))
    assert few.doubt[0] == pytest.approx(0.5 * 0.04)


def test_a_plate_is_found_where_it_is_and_needs_twelve_points() -> None:
    surface = plate(9, 0.02)
    q = np.array([0.1, -0.1])
    seat = np.array([0.1, -0.1, 1.0])
    sensor = lidar(surface)
    z, cov = sensor.align(surface + [0.1, -0.1, 0.004], seat, q)
    assert z[6] == pytest.approx(0.004, abs=1e-4)
    np.testing.assert_allclose(z[4:6], q, atol=1e-4)
    slants = 1.0 / np.linalg.norm(surface - EYE, axis=1)
    assert cov[5, 5] == pytest.approx(1.0 / np.sum(1.0 / (1.25e-4 * slants**2 + 0.004**2)) + 0.0005**2, rel=0.1)
    for keep, enough in ((12, True), (11, False)):
        few = lidar(plate(9, 0.06))
        lid = np.array([0.1, -0.1, 0.0]) + (plate(9, 0.06)[keep:] - EYE) * 0.7 + EYE
        others = (lid, ups(lid))
        points = plate(9, 0.06)[:keep] + [0.1, -0.1, 0.0]
        if enough:
            few.align(np.vstack([points, points + 1e-4]), seat, q, others)
        else:
            with pytest.raises(CloudError, match="11 points of the surface"):
                few.align(np.vstack([points, points + 1e-4]), seat, q, others)
