"""How one image changes a filter: against the textbook's Kalman filter, and at both sides of each decision."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_diagram import scenario
from twin_diagram.scene import object_filter, object_update
from twin_diagram.scene.object_filter import FilterLayout, FilterSettings, Mode
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, PoseMeasurement

SETTINGS = FilterSettings.of(scenario.SceneUpdater())
STILL = np.array([1.0, 0, 0, 0, 0.5, -0.1, 0.1])
CLAIMED = np.diag(np.array([0.02, 0.03, 0.04, 0.01, 0.012, 0.015]) ** 2)
NOISE = CLAIMED + np.diag(SETTINGS.floor * 0.09)
FRAME = 1 / 16


def filtered(mode: Mode, time: float = 1.0, covariance: Array | None = None) -> Array:
    """A filter at STILL whose noise is what is claimed; certain where no covariance is given."""
    filter_ = object_filter.initial_filters(1)[0]
    filter_[FilterLayout.MODE] = mode
    filter_[FilterLayout.LAST_SEEN] = time
    filter_[FilterLayout.POSE] = STILL
    filter_[FilterLayout.COVARIANCE] = 0.0 if covariance is None else covariance.ravel()
    filter_[FilterLayout.NOISE_SCALE] = 1.0
    filter_[FilterLayout.NOISE_COUNT] = 20.0
    return filter_


def uncertain(size: float, seed: int = 0) -> Array:
    root = size * np.random.default_rng(seed).normal(size=(12, 12))
    return root @ root.T


def measured(time: float, away: Array, covariance: Array = CLAIMED, quality: float = 1.0) -> PoseMeasurement:
    return PoseMeasurement(quality, time, object_update.moved(STILL, away), covariance)


def along(axis: int, size: float) -> Array:
    away = np.zeros(6)
    away[axis] = size
    return away


# Poses and their differences.


def test_a_perturbation_turns_about_the_worlds_axes() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        turn, shift, at = Rotation.random(None, rng), rng.normal(size=3), rng.normal(size=3)
        q = np.asarray(turn.as_quat())[[3, 0, 1, 2]]
        phi = rng.uniform(-1, 1, 3)
        pose = object_update.moved(np.r_[q, at], np.r_[phi, shift])
        expected = Rotation.from_rotvec(phi) * turn
        np.testing.assert_allclose(rotations.matrix(pose[:4]), expected.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(pose[4:], at + shift)
        np.testing.assert_allclose(object_update.pose_difference(pose, np.r_[q, at]), np.r_[phi, shift], atol=1e-9)


# What is a measurement.


def unit(stretch: float) -> Array:
    return np.r_[stretch, 0.0, 0.0, 0.0, 0.5, -0.1, 0.1]


def spoiled(index: int) -> PoseMeasurement:
    vector = measured(1.5, np.zeros(6)).pack()
    vector[index] = np.nan
    return PoseMeasurement.unpack(vector)


def shrunk(eigenvalue: float) -> Array:
    covariance = CLAIMED.copy()
    covariance[4, 4] = eigenvalue
    return covariance


@pytest.mark.parametrize(
    ("measurement", "good"),
    [
        (measured(1.5, np.zeros(6)), True),
        (measured(1.5, np.zeros(6), quality=1e-9), True),
        (measured(1.5, np.zeros(6), quality=0.0), False),
        (measured(1.0, np.zeros(6)), False),
        (measured(1.0 + 1e-12, np.zeros(6)), True),
        (measured(2.0 + 0.9e-9, np.zeros(6)), True),
        (measured(2.0 + 1.1e-9, np.zeros(6)), False),
        (PoseMeasurement(1.0, 1.5, unit(1.0009), CLAIMED), True),
        (PoseMeasurement(1.0, 1.5, unit(1.0011), CLAIMED), False),
        (PoseMeasurement(1.0, 1.5, unit(0.9991), CLAIMED), True),
        (PoseMeasurement(1.0, 1.5, unit(0.9989), CLAIMED), False),
        (measured(1.5, np.zeros(6), shrunk(0.0)), True),
        (measured(1.5, np.zeros(6), shrunk(-0.9e-9)), True),
        (measured(1.5, np.zeros(6), shrunk(-1.1e-9)), False),
        *((spoiled(index), False) for index in (0, 1, 2, 8, 9, 44)),
    ],
)
def test_what_is_usable(measurement: PoseMeasurement, good: bool) -> None:
    """Found, newer than the last at 1 s, not after now at 2 s, whole; a unit to a thousandth."""
    assert object_update.usable(measurement, 1.0, 2.0) == good
    before = filtered(Mode.REST)
    assert (object_update.update(before, measurement, 2.0, SETTINGS) is before) != good


def test_the_first_image_may_be_taken_at_time_zero_and_none_before() -> None:
    for time, good in ((0.0, True), (-0.1, False)):
        assert object_update.usable(measured(time, np.zeros(6)), NEVER, 2.0) == good


# One step.


@pytest.mark.parametrize("mode", [Mode.REST, Mode.MOVING])
def test_one_image_is_fused_as_by_the_textbook(mode: Mode) -> None:
    before = filtered(mode, covariance=uncertain(0.01))
    before[FilterLayout.VELOCITY] = [0.1, -0.2, 0.1, 0.1, 0.05, -0.05] if mode == Mode.MOVING else 0.0
    now = 1.0 + FRAME
    belief = object_filter.propagate(before[None], now, SETTINGS)
    P, H = belief.covariances[0], np.eye(6, 12)
    lopsided = CLAIMED + np.triu(np.full((6, 6), 2e-5), 1)  # only what is symmetric of it counts
    R = (lopsided + lopsided.T) / 2 + np.diag(SETTINGS.floor * 0.09)
    away = np.array([0.01, -0.015, 0.02, 0.008, -0.01, 0.005])
    after = object_update.update(before, measured(now, away, lopsided), now, SETTINGS)
    S = H @ P @ H.T + R
    gain = P @ H.T @ np.linalg.inv(S)
    innovation = object_update.pose_difference(object_update.moved(STILL, away), belief.poses[0])
    assert innovation @ np.linalg.solve(S, innovation) < 20
    correction = gain @ innovation
    expected = object_update.moved(belief.poses[0], correction[:6])
    np.testing.assert_allclose(after[FilterLayout.POSE], expected, atol=1e-12)
    np.testing.assert_allclose(after[FilterLayout.VELOCITY], belief.velocities[0] + correction[6:], atol=1e-12)
    found = after[FilterLayout.COVARIANCE].reshape(12, 12)
    np.testing.assert_allclose(found, (np.eye(12) - gain @ H) @ P, atol=1e-14)
    assert after[FilterLayout.MODE] == mode and after[FilterLayout.LAST_SEEN] == now
    scale = 1.0
    if mode == Mode.REST:
        scale = 1 + (innovation @ np.linalg.solve(S, innovation) / 6 - 1) / 20
        whitened = np.linalg.solve(np.linalg.cholesky(S), innovation)
        np.testing.assert_allclose(after[FilterLayout.MEAN], 0.3 * whitened, atol=1e-12)
    else:
        np.testing.assert_allclose(after[FilterLayout.MEAN], 0.25 * after[FilterLayout.VELOCITY], atol=1e-12)
    assert after[FilterLayout.NOISE_SCALE] == pytest.approx(scale)


def test_a_used_image_forgets_what_was_rejected() -> None:
    before = object_update.update(filtered(Mode.REST), measured(1.1, along(3, 0.2)), 2.0, SETTINGS)
    assert before[FilterLayout.REJECTED] == 1.0 and before[FilterLayout.REMEMBERED_TIME] == 1.1
    np.testing.assert_allclose(before[FilterLayout.REMEMBERED_POSE], object_update.moved(STILL, along(3, 0.2)))
    np.testing.assert_array_equal(before[FilterLayout.POSE], STILL)
    after = object_update.update(before, measured(1.2, np.zeros(6)), 2.0, SETTINGS)
    assert after[FilterLayout.REJECTED] == 0.0 and after[FilterLayout.REMEMBERED_TIME] == NEVER


def test_the_first_image_starts_a_filter_at_twice_the_claimed_deviation() -> None:
    after = object_update.update(object_filter.initial_filters(1)[0], measured(0.5, along(4, 0.3)), 1.0, SETTINGS)
    assert after[FilterLayout.MODE] == Mode.REST and after[FilterLayout.LAST_SEEN] == 0.5
    np.testing.assert_allclose(after[FilterLayout.POSE], object_update.moved(STILL, along(4, 0.3)))
    expected = np.zeros((12, 12))
    expected[:6, :6] = 4 * CLAIMED + np.diag(SETTINGS.floor * 0.09)
    np.testing.assert_allclose(after[FilterLayout.COVARIANCE].reshape(12, 12), expected, atol=1e-15)
    # The first value counts for one image: the second, an exact hit, halves it.
    assert after[FilterLayout.NOISE_SCALE] == 4.0
    again = object_update.update(after, measured(0.6, along(4, 0.3)), 1.0, SETTINGS)
    assert again[FilterLayout.NOISE_SCALE] == pytest.approx(2.0)


def test_who_was_lost_begins_anew() -> None:
    """Five seconds unseen, to the bit."""
    before = filtered(Mode.REST, covariance=1e-6 * np.eye(12))
    away = along(5, 0.004)
    merged = object_update.update(before, measured(6.0, away), 10.0, SETTINGS)
    assert 0.0 < merged[FilterLayout.POSE][6] - STILL[6] < 0.00399
    anew = object_update.update(before, measured(6.0 + 1e-9, away), 10.0, SETTINGS)
    np.testing.assert_array_equal(anew[FilterLayout.POSE], object_update.moved(STILL, away))
    np.testing.assert_allclose(anew[FilterLayout.COVARIANCE].reshape(12, 12)[:6, :6], NOISE)


def test_the_learnt_scatter_stays_below_five_times_the_claimed_deviation() -> None:
    filter_ = filtered(Mode.REST)
    filter_[FilterLayout.NOISE_SCALE] = 24.5
    filter_[FilterLayout.NOISE_COUNT] = 1.0
    side = np.sqrt(22.0 * (24.5 * CLAIMED[3, 3]))
    after = object_update.update(filter_, measured(1.0 + FRAME, along(3, side)), 4.0, SETTINGS)
    assert after[FilterLayout.LAST_SEEN] == 1.0 + FRAME
    assert after[FilterLayout.NOISE_SCALE] == 25.0


# Rest and motion.


def test_a_drift_within_the_noise_is_a_motion_at_the_third_image() -> None:
    """3.6 standard deviations on the same side each time: the mean of 0.3, 0.51, 0.657 of it leaves its band."""
    after, modes = filtered(Mode.REST), []
    whitened = along(1, 3.6)
    for _ in range(3):
        covariance = object_update._watch_rest(after, np.zeros((12, 12)), NOISE, whitened)
        modes.append(int(after[FilterLayout.MODE]))
        if len(modes) == 2:
            np.testing.assert_allclose(after[FilterLayout.MEAN], 0.51 * whitened)
            assert (covariance == 0).all()
    assert modes == [Mode.REST, Mode.REST, Mode.MOVING]
    assert (after[FilterLayout.MEAN] == 0).all()
    # A motion begins: the pose may be off by an image's noise, the speed by half a radian and a decimetre a second.
    expected = np.zeros((12, 12))
    expected[:6, :6] = NOISE
    expected[6:, 6:] = np.diag([0.25] * 3 + [0.01] * 3)
    np.testing.assert_allclose(covariance, expected, atol=1e-18)


def test_the_mean_velocity_remembers_three_quarters_per_image() -> None:
    after, velocity = filtered(Mode.MOVING), np.array([0.5, 0, 0, 0, 0.1, 0])
    after[FilterLayout.VELOCITY] = velocity
    for k in range(1, 6):
        object_update._watch_motion(after, np.eye(12), SETTINGS)
        np.testing.assert_allclose(after[FilterLayout.MEAN], (1 - 0.75**k) * velocity)


@pytest.mark.parametrize(
    ("spin", "speed", "rests"),
    [(0.0, 0.0, True), (0.249, 0.124, True), (0.25, 0.0, False), (0.0, 0.125, False), (0.26, 0.13, False)],
)
def test_who_is_slow_for_four_images_rests(spin: float, speed: float, rests: bool) -> None:
    settings = replace(SETTINGS, slow=np.array([0.25, 0.125]))
    after = filtered(Mode.MOVING)
    after[FilterLayout.VELOCITY] = after[FilterLayout.MEAN] = [0, spin, 0, 0, 0, speed]
    covariance = uncertain(0.1)
    for image in range(4):
        assert after[FilterLayout.MODE] == Mode.MOVING
        assert after[FilterLayout.CALM] == (image if rests else 0)
        found = object_update._watch_motion(after, covariance, settings)
    assert (after[FilterLayout.MODE] == Mode.REST) == rests
    if not rests:
        np.testing.assert_array_equal(found, covariance)
        return
    assert (after[FilterLayout.VELOCITY] == 0).all() and (after[FilterLayout.MEAN] == 0).all()
    np.testing.assert_array_equal(found[:6, :6], covariance[:6, :6])
    assert (found[6:] == 0).all() and (found[:, 6:] == 0).all()


def test_one_fast_image_starts_the_count_anew() -> None:
    after = filtered(Mode.MOVING)
    for speed, calm in ((0.0, 1), (0.0, 2), (0.2, 0), (0.0, 0)):
        after[FilterLayout.VELOCITY] = along(3, speed)
        object_update._watch_motion(after, np.eye(12), SETTINGS)
        assert after[FilterLayout.CALM] == calm


# Surprises.


def surprised(first: Array, second: Array, *, last: float = 0.75, at: tuple[float, float] = (1.0, 1.25)) -> Array:
    """A resting filter after two images that show it elsewhere."""
    filter_ = filtered(Mode.REST, last)
    for time, away in zip(at, (first, second), strict=True):
        filter_ = object_update.update(filter_, measured(time, away, np.eye(6) * 1e-4), 3.0, SETTINGS)
    return filter_


@pytest.mark.parametrize(("degrees", "agree"), [(0, True), (58, True), (-58, True), (62, False), (180, False)])
def test_two_jumps_agree_within_60_degrees(degrees: float, agree: bool) -> None:
    angle = np.radians(degrees)
    second = 0.12 * np.array([0, 0, 0, np.cos(angle), np.sin(angle), 0])
    after = surprised(along(3, 0.1), second)
    assert (after[FilterLayout.MODE] == Mode.MOVING) == agree
    if agree:
        np.testing.assert_allclose(after[FilterLayout.VELOCITY], (second - along(3, 0.1)) / 0.25, atol=1e-9)
        np.testing.assert_array_equal(after[FilterLayout.MEAN], after[FilterLayout.VELOCITY])
        assert after[FilterLayout.NOISE_SCALE] == 1.0 and after[FilterLayout.NOISE_COUNT] == 20.0  # as learnt
        assert after[FilterLayout.REJECTED] == 0.0 and after[FilterLayout.LAST_SEEN] == 1.25
        # A speed of two images is as uncertain as both of them, and goes with the second.
        noise = np.eye(6) * 1e-4 + np.diag(SETTINGS.floor * object_update.TUNING.scatter_share**2)
        P = after[FilterLayout.COVARIANCE].reshape(12, 12)
        np.testing.assert_allclose(P[:6, :6], noise)
        np.testing.assert_allclose(P[6:, :6], noise / 0.25)
        np.testing.assert_allclose(P[6:, 6:], 2.0 * noise / 0.25**2 + np.diag(SETTINGS.acceleration_density * 0.25))
    else:
        assert after[FilterLayout.REJECTED] == 1.0 and after[FilterLayout.LAST_SEEN] == 0.75


@pytest.mark.parametrize(("speed", "agree"), [(1.95, True), (2.05, False)])
def test_no_object_is_faster_than_2_metres_a_second(speed: float, agree: bool) -> None:
    """Between the two images, after a jump that was possible."""
    after = surprised(along(3, 0.2), along(3, 0.2 + 0.25 * speed))
    assert (after[FilterLayout.MODE] == Mode.MOVING) == agree
    assert (after[FilterLayout.REJECTED] == 1.0) != agree


@pytest.mark.parametrize(("spin", "agree"), [(9.8, True), (10.2, False)])
def test_no_object_turns_faster_than_10_radians_a_second(spin: float, agree: bool) -> None:
    after = surprised(along(2, 0.5), along(2, 0.5 + 0.125 * spin), at=(1.0, 1.125))
    assert (after[FilterLayout.MODE] == Mode.MOVING) == agree


@pytest.mark.parametrize(("axis", "fastest"), [(3, 2.0), (1, 10.0)])
def test_a_jump_that_no_object_can_make_takes_longer(axis: int, fastest: float) -> None:
    """Two images, four where no object comes so far; what could come so far up to the second image takes three."""
    for share, needed in ((0.98, 2), (1.02, 3), (1.98, 3), (2.02, 4), (2.4, 4)):
        filter_ = filtered(Mode.REST, 1.0)
        images = 0
        while filter_[FilterLayout.MODE] == Mode.REST:
            images += 1
            away = along(axis, 0.125 * fastest * share)  # in the eighth of a second up to the first
            time = 1.0 + 0.125 * images
            filter_ = object_update.update(filter_, measured(time, away, np.eye(6) * 1e-4), 3.0, SETTINGS)
            assert images <= needed
        assert images == needed


def test_a_turn_about_an_axis_of_symmetry_is_no_motion() -> None:
    """Two images that show a can moved, each turned about its axis at will."""
    turned = [object_update.moved(STILL, np.array([0, 0, turn, x, 0, 0])) for turn, x in ((2.0, 0.1), (-1.0, 0.12))]
    for round_, spins in ((True, False), (False, True)):
        filter_ = filtered(Mode.REST, 0.75)
        for time, pose in zip((1.0, 1.5), turned, strict=True):
            image = PoseMeasurement(1.0, time, pose, np.eye(6) * 1e-4)
            filter_ = object_update.update(filter_, image, 3.0, SETTINGS, round_)
        assert filter_[FilterLayout.MODE] == (Mode.MOVING if round_ else Mode.REST)
        assert not spins or filter_[FilterLayout.REJECTED] == 1.0
        if round_:
            np.testing.assert_allclose(filter_[FilterLayout.VELOCITY], along(3, 0.04), atol=1e-9)


def test_what_scatters_to_and_fro_rests() -> None:
    """A mean velocity within two deviations of what measurements' scatter makes of none counts as none."""
    fast = np.array([0.5, 0, 0, 0, 0, 0])
    for scatter, calm in ((0.26, 1.0), (0.24, 0.0)):
        after = filtered(Mode.MOVING)
        after[FilterLayout.VELOCITY] = after[FilterLayout.MEAN] = fast
        object_update._watch_motion(after, np.eye(12), SETTINGS, np.full(6, scatter))
        assert after[FilterLayout.CALM] == calm


@pytest.mark.parametrize(("side", "rises"), [(4.0, True), (0.1, False)])
def test_a_motion_teaches_more_scatter_never_less(side: float, rises: bool) -> None:
    filter_ = filtered(Mode.MOVING)
    noise = np.sqrt(CLAIMED[3, 3] + filter_[FilterLayout.COVARIANCE].reshape(12, 12)[3, 3])
    after = object_update.update(filter_, measured(1.0 + FRAME, along(3, side * noise)), 4.0, SETTINGS)
    assert after[FilterLayout.LAST_SEEN] == 1.0 + FRAME
    scale = filter_[FilterLayout.NOISE_SCALE]
    assert (after[FilterLayout.NOISE_SCALE] > scale) == rises
    assert after[FilterLayout.NOISE_SCALE] >= scale
