"""What is summed of a run of refusals, and where it is taken for noise: borders and figures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twin_diagram.estimation.filter.belief import Belief, Entry
from twin_diagram.estimation.filter.outlier_streaks import gather, take_for_noise
from twin_diagram.scenario import Filter
from twin_diagram.signals.arrays import Array

PARAMS = Filter(encoder_std=0.1, velocity_std=0.5)
EXPECTED = np.array([0.02, 0.3])
"""Variances of the innovation: 0.01 and 0.25 of them are the sensors' noise."""


def test_sums_begin_with_trouble_and_end_when_it_is_over() -> None:
    belief, rng = Belief(1, 0), np.random.default_rng(1320)
    h = belief.header
    gather(belief, np.ones(2), False)
    assert not h[Entry.GATHERED] and not belief.troubled.any()
    rows = []
    for k in range(12):
        rows.append(rng.normal(size=2))
        gather(belief, rows[-1], k in (0, 3, 7))
        if k < 12 - 1:
            assert h[Entry.GATHERED] == k + 1
        if k == 6:
            assert h[Entry.CALM] == 3.0
            np.testing.assert_allclose(belief.troubled[0], np.sum(rows, axis=0))
            np.testing.assert_allclose(belief.troubled[1], np.sum(np.diff(rows, axis=0) ** 2, axis=0))
            np.testing.assert_array_equal(belief.troubled[2], rows[-1])
    assert h[Entry.CALM] == 4.0
    gather(belief, rows[0], False)  # the fifth calm message in a row
    assert not h[Entry.GATHERED] and not h[Entry.CALM] and not belief.troubled.any()


def test_sums_begin_anew_after_forty_messages() -> None:
    belief = Belief(1, 0)
    for k in range(41):
        assert belief.header[Entry.GATHERED] == k
        gather(belief, np.ones(2), True)
    assert belief.header[Entry.GATHERED] == 0.0 and not belief.troubled.any()


def troubled(
    mean: tuple[float, float] = (0.0, 0.0),
    scatter: tuple[float, float] = (0.5, 0.1),
    count: float = 10.0,
    accepted: float = 1000.0,
    level: tuple[float, float] = (0.0, 0.0),
    state: tuple[float, float] = (1e-4, 1e-3),
) -> Belief:
    """Messages of these means, half their mean squared difference this scatter."""
    belief = Belief(1, 0)
    h = belief.header
    h[[Entry.GATHERED, Entry.ACCEPTED, Entry.STREAK, Entry.COUNTED]] = count, accepted, count, 300.0
    h[[Entry.TIME, Entry.ALARM]] = 5.0, 6.0
    belief.troubled[0], belief.troubled[1] = count * np.array(mean), 2.0 * (count - 1.0) * np.array(scatter)
    belief.noise[:2, 0] = level
    belief.P[[0, 1], [0, 1]] = state
    return belief


def taken(**what: Any) -> bool:
    return take_for_noise(troubled(**what), PARAMS, EXPECTED)


@pytest.mark.parametrize(
    ("what", "noise"),
    [
        ({}, True),
        ({"count": 3.0}, True),
        ({"count": 2.0}, False),  # too few tell noise
        ({"accepted": 200.0}, True),
        ({"accepted": 199.0}, False),  # it is not known yet
        ({"scatter": (0.061, 0.1)}, True),  # three times what was expected of it
        ({"scatter": (0.059, 0.1)}, False),
        ({"scatter": (0.059, 99.0)}, False),  # speeds alone do not tell
        ({"level": (np.log(99.9), 0.0)}, True),
        ({"level": (np.log(100.1), 0.0)}, False),  # it is as wide as it may be
    ],
)
def test_it_is_noise_where_it_scatters_enough(what: dict[str, Any], noise: bool) -> None:
    assert taken(**what) == noise
    assert not take_for_noise(troubled(**what), Filter(noise_time=0.0), EXPECTED)


@pytest.mark.parametrize("which", [0, 1])
def test_what_jumped_is_no_noise(which: int) -> None:
    """Four deviations of the mean: of the scatter over ten messages, or the noise as known, and of the state."""
    for scatter, known in (((0.5, 0.4), False), ((0.5, 0.1), which == 1)):
        variance = (0.5, 0.25 if known else 0.4)[which] / 10.0 + (1e-4, 1e-3)[which]
        for share, noise in ((0.99, True), (1.01, False), (-1.01, False)):
            mean = [0.0, 0.0]
            mean[which] = share * 4.0 * np.sqrt(variance)
            assert taken(mean=tuple(mean), scatter=scatter) == noise


def found(scatter: tuple[float, float], **what: Any) -> Array:
    belief = troubled(scatter=scatter, **what)
    assert take_for_noise(belief, PARAMS, EXPECTED)
    return np.asarray(belief.noise[:2, 0].copy())


def test_the_noise_found_is_the_scatter_without_the_state_s() -> None:
    np.testing.assert_allclose(found((0.5, 0.1)), [np.log((0.5 - 0.01) / 0.01), 0.0])
    np.testing.assert_allclose(found((0.5, 1.3)), np.log([0.49 / 0.01, 1.25 / 0.25]))
    np.testing.assert_allclose(found((5.0, 0.1)), [np.log(100.0), 0.0])  # ten times at most
    level = np.log(2.0)  # known is twice what was given, then
    np.testing.assert_allclose(found((0.5, 0.1), level=(level, 0.0)), [np.log((0.5 - 0.0) / 0.01), 0.0], atol=1e-9)
    # A scatter that the state alone would explain is no reason to believe more of the sensor than before.
    belief = troubled(scatter=(0.061, 0.1))
    assert take_for_noise(belief, PARAMS, np.array([0.02, 0.3]))
    assert belief.noise[0, 0] == pytest.approx(np.log(0.051 / 0.01))


def test_what_it_leaves_behind() -> None:
    for streak, wider in ((10.0, 0.0), (9.0, 0.48)):
        belief = troubled()
        belief.header[Entry.STREAK] = streak
        before = belief.P.copy()
        assert take_for_noise(belief, PARAMS, EXPECTED)
        h = belief.header
        assert not h[[Entry.GATHERED, Entry.CALM, Entry.COUNTED, Entry.STREAK]].any() and not belief.troubled.any()
        assert h[Entry.ALARM] == 5.0
        np.testing.assert_allclose(belief.P - before, np.diag([wider, 0.0, 0.0]))
    belief = troubled()
    belief.header[Entry.ALARM] = 2.0
    assert take_for_noise(belief, PARAMS, EXPECTED) and belief.header[Entry.ALARM] == 2.0
