"""The further sensors' records: who vouches, who is doubted, and what each reading leaves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from twin_diagram.estimation.filter.belief import Belief, Entry, SensorTrack
from twin_diagram.estimation.filter.sensor_registry import Declared, FilterError, note
from twin_diagram.estimation.sensors import Sensor
from twin_diagram.signals.arrays import Array


class Gauge(Sensor):
    """A sensor with biases of these priors."""

    def __init__(self, name: str, size: int, *bias: float) -> None:
        super().__init__(name, size)
        self.bias = np.array(bias)

    def reading(self, x: Array) -> Array:
        return np.zeros(self.size)

    def jacobian(self, x: Array) -> Array:
        return np.zeros((self.size, len(x)))

    def noise(self, x: Array) -> Array:
        return np.eye(self.size)

    def own_std(self) -> Array:
        return self.bias

    def own_walk(self) -> Array:
        return 0.1 * self.bias

    def own_labels(self) -> list[str]:
        return [f"{self.name}.{i}" for i in range(len(self.bias))]


def three() -> tuple[Declared, Belief]:
    declared = Declared()
    for gauge in (Gauge("a", 2, 0.5, 2.0), Gauge("b", 3), Gauge("c", 1, 3.0)):
        declared.add(gauge, 7, None)
    return declared, Belief(2, 1, declared.own, declared.sizes)


def test_own_states_lie_one_after_the_other() -> None:
    declared, belief = three()
    assert [sensor.own for sensor in declared.sensors.values()] == [slice(7, 9), slice(9, 9), slice(9, 10)]
    assert declared.own == 3 and declared.sizes == (2, 3, 1) and belief.size == 10
    np.testing.assert_allclose(declared.prior(), [0.25, 4.0, 9.0])
    np.testing.assert_allclose(declared.walk(), [0.0025, 0.04, 0.09])
    assert declared.labels() == ["a.0", "a.1", "c.0"]
    with pytest.raises(FilterError, match="'a'"):
        declared.add(Gauge("a", 1), 7, None)
    for sensor, track in zip(declared.sensors.values(), belief.tracks, strict=True):
        assert declared.track(belief, sensor) is track
    assert declared.track(belief, Gauge("a", 2)) is None


def test_a_fresh_start_forgets_streaks_and_readings_to_come() -> None:
    declared, belief = three()
    for track, last in zip(belief.tracks, (1.0, 9.0, -1.0), strict=True):
        track[[SensorTrack.STREAK, SensorTrack.LAST]] = 4.0, last
    declared.start(belief, 5.0)
    assert [track[SensorTrack.LAST] for track in belief.tracks] == [1.0, 5.0, -1.0]
    assert not any(track[SensorTrack.STREAK] for track in belief.tracks)


@pytest.mark.parametrize(
    ("last", "heard", "for_a", "for_all"),
    [
        ((9.95, -1.0, -1.0), 1.0, False, True),  # itself alone
        ((1.0, 9.95, -1.0), 1.0, True, True),
        ((1.0, 9.901, -1.0), 1.0, True, True),
        ((1.0, 9.899, -1.0), 1.0, False, False),
        ((1.0, 1.0, -1.0), 9.95, True, False),  # the joints
        ((1.0, 1.0, -1.0), 9.89, False, False),
    ],
)
def test_a_sensor_vouches_that_told_within_a_tenth_of_a_second(
    last: tuple[float, ...], heard: float, for_a: bool, for_all: bool
) -> None:
    declared, belief = three()
    for track, time in zip(belief.tracks, last, strict=True):
        track[SensorTrack.LAST] = time
    belief.header[Entry.HEARD] = heard
    assert declared.vouched(belief, declared.sensors["a"], 10.0) == for_a
    assert declared.vouched(belief, None, 10.0) == for_all
    assert not Declared().vouched(Belief(1, 0), None, -0.95)


def test_a_sensor_is_doubted_for_what_happens_once_in_a_hundred_million_readings() -> None:
    declared, belief = three()
    for track, share, size in zip(belief.tracks, (0.99, 1.01, 0.5), (2, 3, 1), strict=True):
        track[SensorTrack.RUN] = share * chi2.isf(1e-8, size)
    found = declared.suspicion(belief)
    assert [found[name] for name in "abc"] == pytest.approx([0.99, 1.01, 0.5], rel=1e-6)
    assert declared.odd_one_out(belief) == "b"


def test_and_for_a_bias_five_deviations_from_nothing() -> None:
    declared, belief = three()
    belief.x[7:9] = [2.4, -10.1]  # of 0.5 and 2
    belief.x[9] = 14.9
    found = declared.suspicion(belief)
    assert [found[name] for name in "abc"] == pytest.approx([10.1 / 10.0, 0.0, 14.9 / 15.0])
    assert declared.odd_one_out(belief) == "a"


def test_who_is_wrong_is_told_by_majority() -> None:
    declared, belief = three()
    assert declared.odd_one_out(belief) is None
    runs = {"a": chi2.isf(1e-8, 2), "b": chi2.isf(1e-8, 3), "c": chi2.isf(1e-8, 1)}
    for shares, wrong in (
        ((0.9, 0.9, 0.99), None),
        ((1.2, 1.5, 0.9), "b"),
        ((1.2, 1.1, 0.9), "a"),
        ((2.0, 2.0, 2.0), "joints"),
    ):
        for track, share, run in zip(belief.tracks, shares, runs.values(), strict=True):
            track[SensorTrack.RUN] = share * run
        assert declared.odd_one_out(belief) == wrong
    single = Declared()
    single.add(Gauge("only", 2), 6, None)
    alone = Belief(2, 0, 0, single.sizes)
    alone.tracks[0][SensorTrack.RUN] = 2.0 * runs["a"]
    assert single.odd_one_out(alone) == "only"
    assert Declared().odd_one_out(Belief(1, 0)) is None


def test_a_record_averages_over_thirty_two_readings() -> None:
    belief = Belief(1, 0, 0, (2,))
    track = belief.tracks[0]
    track[SensorTrack.STREAK], track[SensorTrack.LAST] = 3.0, 8.0
    note(track, np.array([8.0, -2.0]), 68.0, 7.0, True)
    mean = np.array([6.0, -2.0]) / 32.0  # no reading counts for more than six deviations
    np.testing.assert_allclose(track[len(SensorTrack) :], mean)
    assert track[SensorTrack.RUN] == pytest.approx(float(mean @ mean) * 63.0)
    assert track[SensorTrack.NIS] == 68.0 and track[SensorTrack.NIS_MEAN] == pytest.approx(1.0 + (34.0 - 1.0) / 32.0)
    assert (track[SensorTrack.ACCEPTED], track[SensorTrack.REFUSED]) == (1.0, 0.0)
    assert track[SensorTrack.STREAK] == 0.0 and track[SensorTrack.LAST] == 8.0
    kept = float(track[SensorTrack.NIS_MEAN])
    note(track, np.array([-8.0, 0.0]), 64.0, 9.0, False)
    np.testing.assert_allclose(track[len(SensorTrack) :], mean + (np.array([-6.0, 0.0]) - mean) / 32.0)
    assert track[SensorTrack.NIS_MEAN] == kept and track[SensorTrack.LAST] == 8.0
    assert (track[SensorTrack.ACCEPTED], track[SensorTrack.REFUSED], track[SensorTrack.STREAK]) == (1.0, 1.0, 1.0)
    note(track, np.zeros(2), 0.0, 9.0, True)
    assert track[SensorTrack.LAST] == 9.0 and track[SensorTrack.NIS] == 0.0


def test_the_mean_innovation_of_a_sensor_that_agrees_is_chi_squared() -> None:
    """Its sum of squares over its variance averages its degrees of freedom."""
    rng, belief, found = np.random.default_rng(1321), Belief(1, 0, 0, (3,)), []
    for k in range(6000):
        white = rng.normal(size=3)
        note(belief.tracks[0], white, float(white @ white), 0.01 * k, True)
        found.append(float(belief.tracks[0][SensorTrack.RUN]))
    assert np.mean(found[300:]) == pytest.approx(3.0, rel=0.15)
