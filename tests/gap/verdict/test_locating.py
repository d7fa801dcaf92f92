"""Where a residual is said to be: its joint, its share, its time and its condition, against residuals made by hand."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.made import ARM, ELBOW, LIFT, PAN, record, swing, terms_of
from twin_diagram.gap.residuals.prepared_logs import Record, Records
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.residuals.whitening import Whitener
from twin_diagram.gap.verdict.locating import CONDITIONS, locate, said

Array = npt.NDArray[np.float64]

NOISE = 0.1


@cache
def base() -> tuple[Record, Record]:
    time, q, v, a = swing(12.0)
    one = record(ARM, time, q, v, a)
    return one, replace(one, index=1, time=time + 100.0)


def made(torque: Any, logs: int = 1) -> tuple[Terms, Whitener]:
    """Terms of logs with a torque of their own beside white noise."""
    rng = np.random.default_rng(0)
    runs = []
    for one in base()[:logs]:
        extra = torque(one) + NOISE * rng.normal(size=one.q.shape)
        runs.append(replace(one, torque=one.given + extra))
    terms = terms_of(Records(ARM, tuple(runs)))
    level = float(np.std(terms.records.residual - terms.records.reduce(torque)))
    return terms, Whitener(np.ones((6, 1)), np.full(6, level), terms.records.lengths)


def on(joint: int, law: Any) -> Any:
    def torque(one: Record) -> Array:
        result = np.zeros_like(one.q)
        result[:, joint] = law(one)
        return result

    return torque


@pytest.mark.parametrize(
    ("key", "law"),
    [
        ("everywhere", lambda r: 0.5 + 0.0 * r.time),
        ("reversal", lambda r: 0.5 * np.sign(r.v[:, ELBOW])),
        ("speed", lambda r: 0.5 * r.v[:, ELBOW]),
        ("load", lambda r: 0.3 * (r.given[:, ELBOW] - np.mean(r.given[:, ELBOW]))),
        ("acceleration", lambda r: 0.2 * r.a[:, ELBOW]),
        ("angle", lambda r: np.abs(3.0 * np.sin(6.0 * r.q[:, ELBOW]))),
        ("onset", lambda r: 1.0 * (r.time > 7.0)),
    ],
)
def test_the_condition_is_what_makes_the_residual(key: str, law: Any) -> None:
    terms, noise = made(on(ELBOW, law))
    (place,) = locate(terms.records, terms, noise)
    assert place.joint == ARM.joints[ELBOW] and place.condition == CONDITIONS[key]
    assert place.share == 1.0 and place.log == 0


@pytest.mark.parametrize("later", [0.0, 12.0, 86400.0])
def test_what_starts_in_one_log_and_stays_in_the_next_is_from_an_onset_on_whatever_their_clocks(later: float) -> None:
    """Two clocks that both began at 0 had it everywhere, and of one a day later it came with speed."""
    rng, runs = np.random.default_rng(0), []
    for k in range(2):
        one = replace(base()[0], index=k, time=base()[0].time + later * k)
        extra = on(ELBOW, lambda r, k=k: 1.0 * ((r.time > 6.0) | (k == 1)))(one)
        runs.append(replace(one, torque=one.given + extra + NOISE * rng.normal(size=one.q.shape)))
    terms = terms_of(Records(ARM, tuple(runs)))
    (place,) = locate(terms.records, terms, Whitener(np.ones((6, 1)), np.full(6, 0.03), terms.records.lengths))
    assert place.condition == CONDITIONS["onset"]


def test_shares_are_of_the_energy_above_the_noise() -> None:
    terms, noise = made(lambda r: on(PAN, lambda r: 1.0 * r.v[:, PAN])(r) + on(LIFT, lambda r: 0.5 * r.v[:, LIFT])(r))
    places = locate(terms.records, terms, noise)
    y = terms.records.residual / noise.sigma
    excess = np.sum(y**2, axis=0) - len(y)
    assert [p.joint for p in places] == [ARM.joints[PAN], ARM.joints[LIFT]]
    np.testing.assert_allclose([p.share for p in places], excess[[PAN, LIFT]] / np.sum(excess[[PAN, LIFT]]))


@pytest.mark.parametrize(("deviations", "there"), [(3.9, False), (4.1, True)])
def test_a_residual_counts_from_four_deviations_of_noise_on(deviations: float, there: bool) -> None:
    terms, noise = made(lambda r: np.zeros_like(r.q))
    count = len(terms.records.residual)
    level = np.sqrt(np.sum(terms.records.residual[:, PAN] ** 2) / (count + deviations * np.sqrt(2.0 * count)))
    sigma = np.full(6, 1e3)
    sigma[PAN] = level
    assert bool(locate(terms.records, terms, replace(noise, sigma=sigma))) == there


@pytest.mark.parametrize(("share", "there"), [(0.0093, False), (0.0108, True)])
def test_a_hundredth_of_the_whole_is_not_worth_a_word(share: float, there: bool) -> None:
    terms, noise = made(lambda r: np.zeros_like(r.q))
    count = len(terms.records.residual)
    energy = np.sum(terms.records.residual**2, axis=0)
    sigma = np.full(6, 1e3)
    excess = 100.0 * count
    sigma[PAN] = np.sqrt(energy[PAN] / (count + excess))
    sigma[LIFT] = np.sqrt(energy[LIFT] / (count + share * excess))
    assert len(locate(terms.records, terms, replace(noise, sigma=sigma))) == (2 if there else 1)


def test_times_hold_nearly_all_of_the_energy_in_the_log_that_has_most() -> None:
    """From its fiftieth to its last fiftieth."""

    def push(one: Record) -> Array:
        since = one.time - one.time[0]
        return 3.0 * ((since > 3.0) & (since < 8.0)) * (1.0 if one.index else 0.5)

    terms, noise = made(on(ELBOW, push), 2)
    (place,) = locate(terms.records, terms, noise)
    assert place.log == 1
    assert place.time == (pytest.approx(103.1, abs=0.06), pytest.approx(107.9, abs=0.06))


def test_words_of_a_condition_on_a_slide() -> None:
    assert said("angle", True) == "with position" and said("angle", False) == "with angle"
    assert said("speed", True) == CONDITIONS["speed"]
