"""The object filter's figures against independent ones: gates, growth of covariances, learning of the scatter."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import chi2

from twin_diagram import scenario
from twin_diagram.scene import object_filter, object_update
from twin_diagram.scene.object_filter import FilterLayout, Mode
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import PoseMeasurement

SETTINGS = object_filter.FilterSettings.of(scenario.SceneUpdater())
STILL = np.array([1.0, 0, 0, 0, 0.5, -0.1, 0.1])
CLAIMED = np.diag(np.array([0.02, 0.02, 0.02, 0.01, 0.01, 0.01]) ** 2)


def filtered(mode: Mode, time: float = 1.0) -> Array:
    """A filter last updated at `time`, at STILL, whose pose and velocity are certain."""
    filter_ = object_filter.initial_filters(1)[0]
    filter_[FilterLayout.MODE] = mode
    filter_[FilterLayout.LAST_SEEN] = time
    filter_[FilterLayout.POSE] = STILL
    filter_[FilterLayout.COVARIANCE] = 0.0
    filter_[FilterLayout.NOISE_SCALE] = 1.0
    return filter_


def measured(time: float, away: Array) -> PoseMeasurement:
    return PoseMeasurement(1.0, time, object_update.moved(STILL, away), CLAIMED)


def noise(scale: float = 1.0) -> Array:
    """What a measurement of CLAIMED is taken to scatter by, with the share of the floor that all have."""
    return scale * CLAIMED + np.diag(SETTINGS.floor * 0.3**2)


@pytest.mark.parametrize("axis", [3, 5])
def test_the_gate_is_at_its_stated_probability(axis: int) -> None:
    """χ² of 6: what happens to one measurement in 500 is used, what happens to one in 10 000 is not."""
    now = 1.0 + 1 / 15
    before = filtered(Mode.REST)
    variance = noise()[axis, axis] + SETTINGS.rest_walk[axis] / 15
    for rarity, used in ((2e-3, True), (1e-4, False)):
        away = np.zeros(6)
        away[axis] = np.sqrt(chi2.isf(rarity, 6) * variance)
        after = object_update.update(before, measured(now, away), now, SETTINGS)
        assert (after[FilterLayout.LAST_SEEN] == now) == used
        assert (after[FilterLayout.REJECTED] == 0) == used


def test_the_trend_is_tested_at_its_stated_probability() -> None:
    """A running mean of white noise that happens at one image in 10⁴ is rest, at one in 10⁵ a motion."""
    memory = object_update.TUNING.trend_memory
    impulse = (1 - memory) * memory ** np.arange(200)
    variance = float((impulse**2).sum())
    for rarity, rests in ((1e-4, True), (1e-5, False)):
        mean = np.zeros(6)
        mean[4] = np.sqrt(chi2.isf(rarity, 6) * variance)
        after = filtered(Mode.REST)
        after[FilterLayout.MEAN] = mean
        object_update._watch_rest(after, np.zeros((12, 12)), noise(), mean)
        assert (after[FilterLayout.MODE] == Mode.REST) == rests
        assert after[FilterLayout.CALM] == (0 if rests else -4)  # four images for the mean velocity to build up


def test_the_scatter_is_learnt_as_a_mean_over_twenty_images() -> None:
    filter_ = filtered(Mode.REST)
    filter_[FilterLayout.NOISE_COUNT] = 1.0
    scales = [1.0]
    for k in range(1, 31):
        filter_ = object_update.update(filter_, measured(1.0 + k / 15, np.zeros(6)), 4.0, SETTINGS)
        scales.append(filter_[FilterLayout.NOISE_SCALE])
        assert filter_[FilterLayout.NOISE_COUNT] == min(1 + k, 20)
    # Exact hits say: no scatter at all; the n-th of them counts for 1/n, from the twentieth on for 1/20.
    expected = np.cumprod([1 - 1 / min(1 + k, 20) for k in range(1, 31)])
    np.testing.assert_allclose(scales[1:], np.maximum(expected, 0.02), rtol=1e-9)


@pytest.mark.parametrize("truth", [0.5, 2.0])
def test_the_learnt_scatter_is_the_true_one(truth: float) -> None:
    """Measurements that scatter by `truth` times what they claim: the variance learnt is its square."""
    learnt = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        filter_ = object_filter.initial_filters(1)[0]
        for k in range(100):
            away = truth * np.sqrt(np.diag(CLAIMED)) * rng.standard_normal(6)
            filter_ = object_update.update(filter_, measured(k / 15, away), 100.0, SETTINGS)
            assert filter_[FilterLayout.MODE] == Mode.REST
            if k >= 60 and k % 10 == 0:
                learnt.append(filter_[FilterLayout.NOISE_SCALE])
    assert np.mean(learnt) == pytest.approx(truth**2, rel=0.15)


@pytest.mark.parametrize(("sigmas", "moves"), [(1.5, False), (2.5, False), (6.0, True)])
def test_what_the_arm_comes_before_shifts_within_its_claim_and_does_not_move(sigmas: float, moves: bool) -> None:
    """Images that repeat teach that nothing scatters; an error that lasts shows once less is seen of the object."""
    filter_ = filtered(Mode.REST)
    for k in range(1, 61):
        away = np.zeros(6)
        away[4] = 0.0 if k <= 40 else sigmas * 0.01
        filter_ = object_update.update(filter_, measured(1.0 + k / 15, away), 5.0, SETTINGS)
        if k == 40:
            assert filter_[FilterLayout.NOISE_SCALE] < 0.3
        if filter_[FilterLayout.MODE] == Mode.MOVING:
            break
    assert (filter_[FilterLayout.MODE] == Mode.MOVING) == moves
    if moves:
        assert k <= 43  # the third image of it at the latest


def test_a_moving_object_is_propagated_as_white_acceleration_says() -> None:
    """Against the matrix exponential of Van Loan (1978)."""
    filter_ = filtered(Mode.MOVING)
    rng = np.random.default_rng(3)
    root = 0.01 * rng.standard_normal((12, 12))
    filter_[FilterLayout.COVARIANCE] = (root @ root.T).ravel()
    age = 0.2
    dynamics, driven = np.zeros((12, 12)), np.zeros((12, 12))
    dynamics[:6, 6:] = np.eye(6)
    driven[6:, 6:] = np.diag(SETTINGS.acceleration_density)
    block = expm(np.block([[-dynamics, driven], [np.zeros((12, 12)), dynamics.T]]) * age)
    F = block[12:, 12:].T
    expected = F @ (root @ root.T) @ F.T + F @ block[:12, 12:]
    found = object_filter.propagate(filter_[None], 1.0 + age, SETTINGS).covariances[0]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-15)


def test_variances_grow_by_the_scenarios_walks() -> None:
    params = scenario.SceneUpdater()
    rest = object_filter.propagate(filtered(Mode.REST)[None], 1.0 + 2.0, SETTINGS).covariances[0]
    unseen = 2.0 - params.stale_after
    assert rest[3, 3] == pytest.approx(2.0 * params.rest_walk**2 + unseen * params.stale_walk**2)
    assert rest[0, 0] == pytest.approx(2.0 * params.rest_turn**2 + unseen * params.stale_turn**2)
    assert (rest[6:] == 0).all()
    # A moving one goes on for a quarter of a second; from then on it may be anywhere that its speed could take it.
    moving = filtered(Mode.MOVING)
    moving[FilterLayout.VELOCITY] = [0, 0, 0.2, 0.1, 0, 0]
    coasted, later = (object_filter.propagate(moving[None], 1.0 + age, SETTINGS) for age in (0.25, 0.75))
    np.testing.assert_allclose(later.poses[0, 4:], STILL[4:] + [0.025, 0, 0])
    grown = np.diag(later.covariances[0] - coasted.covariances[0])[:6]
    np.testing.assert_allclose(grown, 0.5 * (SETTINGS.stale_walk + np.array([0, 0, 0.2, 0.1, 0, 0]) ** 2), rtol=1e-9)
    assert (later.velocities == 0).all() and (coasted.velocities == moving[FilterLayout.VELOCITY]).all()


def test_two_rejected_measurements_that_agree_start_a_motion_with_their_covariance() -> None:
    """Half a second apart at most, to the bit; the covariance is that of two independent poses and their difference."""
    for second, moves in ((1.5, True), (1.75, False)):
        filter_ = filtered(Mode.REST, 0.75)
        away = np.array([0, 0, 0, 0.1, 0, 0])
        filter_ = object_update.update(filter_, measured(1.0, away), 2.0, SETTINGS)
        assert filter_[FilterLayout.REJECTED] == 1
        filter_ = object_update.update(filter_, measured(second, 1.5 * away), 2.0, SETTINGS)
        assert (filter_[FilterLayout.MODE] == Mode.MOVING) == moves
        if not moves:
            assert filter_[FilterLayout.REJECTED] == 1
            continue
        np.testing.assert_allclose(filter_[FilterLayout.VELOCITY], away, atol=1e-12)
        np.testing.assert_allclose(filter_[FilterLayout.POSE], object_update.moved(STILL, 1.5 * away))
        found = filter_[FilterLayout.COVARIANCE].reshape(12, 12)
        pair = np.block([[noise(), np.zeros((6, 6))], [np.zeros((6, 6)), noise()]])
        last_and_rate = np.block([[np.zeros((6, 6)), np.eye(6)], [-2 * np.eye(6), 2 * np.eye(6)]])
        expected = last_and_rate @ pair @ last_and_rate.T
        expected[6:, 6:] += np.diag(0.5 * SETTINGS.acceleration_density)
        np.testing.assert_allclose(found, expected, atol=1e-15)


@pytest.mark.parametrize("period", [0.6, 1.0])
def test_at_few_images_a_second_the_second_one_of_a_push_is_believed(period: float) -> None:
    """Half a second apart at most, it was stale at its old place until it counted as lost."""
    filter_ = filtered(Mode.REST, 1.0)
    for k in (1, 2):
        time, away = 1.0 + k * period, np.array([0, 0, 0, 0.1, 0, 0])
        filter_ = object_update.update(filter_, measured(time, away), time, SETTINGS)
        assert (filter_[FilterLayout.MODE] == Mode.MOVING) == (k == 2)
    np.testing.assert_allclose(filter_[FilterLayout.POSE], object_update.moved(STILL, away))


def test_rejected_measurements_that_disagree_begin_anew() -> None:
    filter_ = filtered(Mode.REST, 0.9)
    for time, side in ((1.0, 1), (1.1, -1), (1.2, 1)):
        away = np.array([0, 0, 0, 0.1 * side, 0, 0])
        filter_ = object_update.update(filter_, measured(time, away), 2.0, SETTINGS)
        assert filter_[FilterLayout.MODE] == Mode.REST and filter_[FilterLayout.REJECTED] == 1


def test_what_no_object_can_do_is_not_believed_at_once() -> None:
    for speed, believed in ((1.9, True), (2.1, False)):
        filter_ = filtered(Mode.REST, 0.9)
        for time in (1.0, 1.1):
            away = np.array([0, 0, 0, speed * (time - 0.9), 0, 0])
            filter_ = object_update.update(filter_, measured(time, away), 2.0, SETTINGS)
        assert (filter_[FilterLayout.MODE] == Mode.MOVING) == believed


def test_statuses_change_at_the_scenarios_ages() -> None:
    params = scenario.SceneUpdater()
    filters = np.stack([filtered(Mode.REST), filtered(Mode.MOVING), object_filter.initial_filters(1)[0]])
    told = {
        age: object_filter.statuses(filters, 1.0 + age, SETTINGS).astype(int).tolist()
        for age in (0.0, params.stale_after * 1.01, params.lost_after * 1.01)
    }
    status = object_filter.ObjectStatus
    assert list(told.values()) == [
        [status.TRACKED, status.MOVING, status.UNSEEN],
        [status.STALE, status.STALE, status.UNSEEN],
        [status.LOST, status.LOST, status.UNSEEN],
    ]


def test_nothing_is_known_at_first() -> None:
    """Any rotation, a metre: the variance of an angle that is even over a turn is π²/3."""
    filters = object_filter.initial_filters(2)
    belief = object_filter.propagate(filters, 7.0, SETTINGS)
    np.testing.assert_array_equal(belief.poses, np.tile([1.0, 0, 0, 0, 0, 0, 0], (2, 1)))
    even = np.linspace(-np.pi, np.pi, 100_001)
    expected = np.diag([np.var(even)] * 3 + [1.0] * 3 + [0.0] * 6)
    np.testing.assert_allclose(belief.covariances[1], expected, rtol=1e-4)
    np.testing.assert_array_equal(filters[:, FilterLayout.REMEMBERED_POSE], belief.poses)
    assert (filters[:, FilterLayout.REMEMBERED_TIME] < 0).all() and (filters[:, FilterLayout.LAST_SEEN] < 0).all()


def test_settings_are_a_scenarios_deviations_squared() -> None:
    params = scenario.SceneUpdater(
        stale_after=0.7, lost_after=8.0, acceleration_std=0.5, angular_acceleration_std=2.0, position_floor=0.003,
        rotation_floor=0.04, rest_walk=0.02, rest_turn=0.06, stale_walk=0.11, stale_turn=0.13, rest_speed=0.017,
        rest_spin=0.19,
    )  # fmt: skip
    settings = object_filter.FilterSettings.of(params)
    assert (settings.stale_after, settings.lost_after) == (0.7, 8.0)
    # An acceleration that forgets itself within 0.3 s: the integral of σ² exp(−|t| / 0.3 s).
    t = np.linspace(-6.0, 6.0, 200_001)
    forgets = float(np.sum(np.exp(-np.abs(t) / 0.3)) * (t[1] - t[0]))
    np.testing.assert_allclose(settings.acceleration_density, forgets * np.array([4.0] * 3 + [0.25] * 3), rtol=1e-4)
    np.testing.assert_allclose(settings.rest_walk, [0.0036] * 3 + [0.0004] * 3)
    np.testing.assert_allclose(settings.stale_walk, [0.0169] * 3 + [0.0121] * 3)
    np.testing.assert_allclose(settings.floor, [0.0016] * 3 + [9e-6] * 3)
    np.testing.assert_array_equal(settings.slow, [0.19, 0.017])


def test_time_does_not_run_backwards() -> None:
    filter_ = filtered(Mode.MOVING)
    filter_[FilterLayout.VELOCITY] = [0, 0, 0.2, 0.1, 0, 0]
    then, before = (object_filter.propagate(filter_[None], now, SETTINGS) for now in (1.0, 0.5))
    for one, two in zip(then, before, strict=True):
        np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(before.poses[0], STILL)


def test_a_turning_objects_errors_turn_with_it() -> None:
    """The share of the covariance that comes from the pose, against differences of perturbed filters."""
    filter_ = filtered(Mode.MOVING)
    filter_[FilterLayout.VELOCITY] = [1.0, -2.0, 3.0, 0.3, 0.1, -0.2]
    step, age = 1e-6, 0.2
    columns = []
    for axis in range(6):
        poses = []
        for side in (step, -step):
            other = filter_.copy()
            other[FilterLayout.POSE] = object_update.moved(STILL, side * np.eye(6)[axis])
            poses.append(object_filter.propagate(other[None], 1.0 + age, SETTINGS).poses[0])
        columns.append(object_update.pose_difference(*poses) / (2 * step))
    transition = np.array(columns).T
    root = 0.1 * np.random.default_rng(1).normal(size=(6, 6))
    known = np.zeros((12, 12))
    known[:6, :6] = root @ root.T
    filter_[FilterLayout.COVARIANCE] = known.ravel()
    later = object_filter.propagate(filter_[None], 1.0 + age, SETTINGS)
    filter_[FilterLayout.COVARIANCE] = 0.0
    driven = object_filter.propagate(filter_[None], 1.0 + age, SETTINGS).covariances[0]
    found = later.covariances[0] - driven
    np.testing.assert_allclose(found[:6, :6], transition @ root @ root.T @ transition.T, atol=1e-8)
    np.testing.assert_allclose(later.poses[0, 4:], STILL[4:] + age * filter_[FilterLayout.VELOCITY][3:])


def test_ignorance_has_an_end() -> None:
    for mode in (Mode.REST, Mode.MOVING):
        filter_ = filtered(mode)
        later = object_filter.propagate(filter_[None], 1e7, SETTINGS).covariances[0]
        coasted = object_filter.propagate(filter_[None], 1.25, SETTINGS).covariances[0] if mode == Mode.MOVING else 0.0
        expected = np.diag([np.pi**2 / 3] * 3 + [1.0] * 3)
        np.testing.assert_allclose((later - coasted)[:6, :6], expected, atol=1e-9)


def test_statuses_are_kept_up_to_the_age_itself() -> None:
    """Half a second, five seconds: to the bit."""
    status = object_filter.ObjectStatus
    filters = np.stack([filtered(Mode.REST), filtered(Mode.MOVING)])
    for now, told in ((1.5, [status.TRACKED, status.MOVING]), (6.0, [status.STALE, status.STALE])):
        assert object_filter.statuses(filters, now, SETTINGS).tolist() == told


def test_what_averaging_does_not_remove_is_added() -> None:
    filters = np.stack([filtered(Mode.REST), filtered(Mode.REST)])
    leaning = np.array([np.cos(0.3), np.sin(0.3), 0, 0])  # by 0.6 rad about x
    filters[:, FilterLayout.POSE.start : FilterLayout.POSE.start + 4] = leaning
    belief = object_filter.propagate(filters, 1.0, SETTINGS)
    known = 1e-4 * np.eye(12)
    belief = belief._replace(covariances=np.stack([known, known]))
    plain, round_ = object_filter.pose_covariances(belief, np.array([[0, 0, 0.0], [0, 0, 1.0]]), SETTINGS)
    expected = np.diag(1e-4 + np.array([0.005] * 3 + [0.0005] * 3) ** 2)
    np.testing.assert_allclose(plain, expected, atol=1e-15)
    axis = np.array([0.0, -np.sin(0.6), np.cos(0.6)])
    expected[:3, :3] += np.pi**2 / 3 * np.outer(axis, axis)
    np.testing.assert_allclose(round_, expected, atol=1e-12)
    np.testing.assert_array_equal(belief.covariances[0], known)
