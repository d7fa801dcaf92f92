"""Times at which an effect starts and ends, and how surely they are told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.made import ARM, ELBOW, effect, record, swing
from twin_diagram.gap.correction.onset_times import When, _least, retimed
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.whitening import Whitener

Array = npt.NDArray[np.float64]


@pytest.mark.parametrize("width", [0.02, 0.06, 0.15])
def test_a_time_and_its_error_are_those_of_its_likelihood(width: float) -> None:
    """Beside a rough time that is known to a quarter of a second."""
    at, rough = 5.07, 5.0
    time, std = _least(lambda t: 0.5 * ((t - at) / width) ** 2, rough, 0.0, 10.0)
    weight = width**-2.0 + 0.25**-2.0
    assert time == pytest.approx((at / width**2 + rough / 0.0625) / weight, abs=2e-3)
    assert std == pytest.approx(weight**-0.5, rel=0.05)


def test_where_the_data_do_not_care_a_time_stays_what_it_was() -> None:
    time, std = _least(lambda t: 0.0, 5.0, 0.0, 10.0)
    assert time == pytest.approx(5.0, abs=2e-3)
    grid = np.arange(-0.5, 0.5001, 0.025)
    likelihood = np.exp(-0.5 * (grid / 0.25) ** 2)
    assert std == pytest.approx(np.sqrt(np.sum(grid**2 * likelihood) / np.sum(likelihood)), rel=0.03)


def test_no_time_is_known_better_than_filters_let_it() -> None:
    time, std = _least(lambda t: 0.5 * ((t - 5.013) / 1e-4) ** 2, 5.0, 0.0, 10.0)
    assert std == 0.005 and time == pytest.approx(5.013, abs=2e-3)


def test_half_a_second_to_each_side_is_tried_within_the_run() -> None:
    asked: list[float] = []

    def law(t: float) -> float:
        asked.append(t)
        return abs(t - 5.0)

    _least(law, 5.0, 0.0, 10.0)
    np.testing.assert_allclose(asked[:41], 5.0 + np.arange(-20, 21) * 0.025)
    near = np.array(asked[41:])
    assert len(near) == 9 and np.all(np.abs(near - 5.0) <= 0.025 + 1e-9)
    for first, last, count in ((4.79, 10.0, 29), (0.0, 5.21, 29), (4.99, 5.01, 1)):
        asked.clear()
        _least(law, 5.0, first, last)
        assert len(asked) == count + 9
    assert _least(law, 5.0, 7.0, 8.0) == (5.0, 0.5)


def test_of_two_leasts_the_lower_is_found() -> None:
    time, _ = _least(
        lambda t: -30.0 * np.exp(-(((t - 5.3) / 0.03) ** 2)) - 20.0 * np.exp(-(((t - 4.9) / 0.03) ** 2)), 5.0, 0.0, 9.0
    )
    assert time == pytest.approx(5.3, abs=3e-3)


def acting(first: float, last: float | None, index: int) -> tuple[Records, Whitener, Array]:
    """Two runs; in one of them a bias of the elbow acts for a while."""
    time, q, v, a = swing(3.5)
    acts = (time >= first) & (time < (np.inf if last is None else last))
    rng = np.random.default_rng(3)
    extra = 0.2 * rng.normal(size=(2, *q.shape))
    extra[index][:, ELBOW] -= 2.0 * acts
    runs = tuple(record(ARM, time, q, v, a, extra=extra[k], index=k) for k in range(2))
    records = Records(ARM, runs)
    noise = Whitener(np.ones((6, 1)), np.full(6, 0.1), records.lengths)
    return records, noise, np.ones((6, sum(records.lengths)))


@pytest.mark.parametrize(("first", "last", "index"), [(1.5, None, 0), (1.2, 2.3, 1)])
def test_switching_times_are_found_in_their_run(first: float, last: float | None, index: int) -> None:
    records, noise, weights = acting(first, last, index)
    biased = ARM.with_effects([effect("torque_bias", [ARM.joints[ELBOW]], torque=2.0)])
    rough = When(first + 0.2, None if last is None else last - 0.2)
    found = retimed(rough, biased, ARM, records.records[index], records, noise, weights)
    assert found.onset == pytest.approx(first, abs=0.02) and 0.0 < found.onset_std < 0.05
    if last is None:
        assert found.end is None and found.end_std == 0.0
        ended = retimed(When(None, first + 0.1), ARM, biased, records.records[index], records, noise, weights)
        assert ended.onset is None and ended.end == pytest.approx(first, abs=0.02) and ended.end_std > 0.0
    else:
        assert found.end == pytest.approx(last, abs=0.02) and 0.0 < found.end_std < 0.05
    none = retimed(rough, ARM, ARM, records.records[index], records, noise, weights)
    assert none == rough
    deaf = retimed(rough, biased, ARM, records.records[index], records, noise, 0.0 * weights)
    assert deaf.onset == pytest.approx(rough.onset, abs=2e-3) and deaf.onset_std > 0.2
    louder = retimed(
        rough, biased, ARM, records.records[index], records, replace(noise, sigma=20.0 * noise.sigma), weights
    )
    assert louder.onset_std > found.onset_std


def test_an_end_comes_after_its_onset() -> None:
    """By twice the spacing of the times that are tried."""
    records, noise, weights = acting(1.5, 1.51, 0)
    biased = ARM.with_effects([effect("torque_bias", [ARM.joints[ELBOW]], torque=-2.0)])
    found = retimed(When(1.3, 1.6), biased, ARM, records.records[0], records, noise, weights)
    assert found.onset is not None and found.end is not None and found.end - found.onset > 0.024
