"""Runs of refused messages: encoders that turn noisy are told from such that jumped and from arms that are thrown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.estimation.filter.test_noise_estimate import POSITION, SPEED, VISIBLE, noisy, terms
from twin_diagram.estimation.filter.belief import Belief, Entry
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.filter.noise_estimate import WIDEST
from twin_diagram.estimation.filter.outlier_streaks import TUNING as OUTLIER_STREAKS
from twin_diagram.estimation.filter.outlier_streaks import forget, gather, take_for_noise
from twin_diagram.scenario import Filter

PARAMS = Filter(encoder_std=POSITION, velocity_std=SPEED)

EXPECTED = np.repeat([POSITION**2, SPEED**2], 3)


def run_of(innovations: np.ndarray) -> Belief:
    belief = Belief(innovations.shape[1] // 2, 0)
    belief.P[:] = 1e-12 * np.eye(belief.size)
    belief.header[Entry.TIME], belief.header[Entry.STREAK], belief.header[Entry.ACCEPTED] = (
        1.0,
        len(innovations),
        OUTLIER_STREAKS.known,
    )
    for innovation in innovations:
        gather(belief, innovation, True)
    return belief


def scatter(seed: int, factor: float, count: int = 10, n: int = 3) -> np.ndarray:
    rng = np.random.default_rng([seed, 1301])
    return rng.normal(size=(count, 2 * n)) * np.repeat([factor * POSITION, SPEED], n)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), factor=st.floats(4.0, 9.0))
def test_noise_is_found_from_its_scatter(seed: int, factor: float) -> None:
    belief = run_of(scatter(seed, factor, 40))
    assert take_for_noise(belief, PARAMS, EXPECTED)
    np.testing.assert_allclose(np.exp(0.5 * belief.noise[0]), factor, rtol=0.6)
    np.testing.assert_array_equal(belief.noise[1:], 0.0)  # speeds are as they were
    assert belief.header[Entry.GATHERED] == 0.0
    assert belief.header[Entry.STREAK] == 0.0


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), joint=st.integers(0, 5), size=st.floats(8.0, 1e4), ramp=st.booleans())
def test_jumps_and_ramps_are_no_noise(seed: int, joint: int, size: float, ramp: bool) -> None:
    innovations = scatter(seed, 1.0)
    innovations[:, joint] += size * (POSITION if joint < 3 else SPEED) * (np.linspace(0.0, 1.0, 10) if ramp else 1.0)
    belief = run_of(innovations)
    before = belief.noise.copy()
    assert not take_for_noise(belief, PARAMS, EXPECTED)
    np.testing.assert_array_equal(belief.noise, before)


def test_too_few_messages_no_adaptation_and_the_widest() -> None:
    assert not take_for_noise(run_of(scatter(1, 8.0, 2)), PARAMS, EXPECTED)
    assert not take_for_noise(run_of(scatter(1, 8.0)), replace(PARAMS, noise_time=0.0), EXPECTED)
    belief = run_of(scatter(1, 1e3))
    assert take_for_noise(belief, PARAMS, EXPECTED)
    np.testing.assert_array_equal(belief.noise[0], WIDEST)
    for innovation in scatter(2, 1e3):
        gather(belief, innovation, True)
    assert not take_for_noise(belief, PARAMS, EXPECTED)  # nothing more to give: a message must help
    forget(belief)
    assert not np.any(belief.troubled)


def told_wrong(factor: float, jump: float) -> tuple[Ekf, np.ndarray, np.ndarray]:
    """A swinging arm whose encoders are noisier by a factor, or whose second one jumps, from 3 s on."""
    run, ekf = noisy(), Ekf(terms(), PARAMS)
    rng = np.random.default_rng(1302)
    off, sure = [], []
    for k in np.flatnonzero(run.time < 6.0):
        q = run.q[k].copy()
        if run.time[k] >= 3.0:
            q += POSITION * np.sqrt(factor**2 - 1.0) * rng.normal(size=7)
            q[1] += jump
        ekf.observe(q, run.v[k], run.tau[k], run.time[k])
        off.append(ekf.belief.q - run.q_true[k])
        sure.append(ekf.belief.P[:7, :7].copy())
    return ekf, np.array(off), np.array(sure)


@pytest.mark.long
@pytest.mark.parametrize("factor", [5.0, 10.0])
def test_noisy_encoders_neither_throw_the_state_nor_its_covariance(factor: float) -> None:
    """NEES per joint of the positions stays near 1 from the first noisy message on; a restart made it 60.

    Of joints whose encoders' noise shows beside the torque's.
    """
    ekf, off, sure = told_wrong(factor, 0.0)
    assert ekf.belief.header[Entry.RESTARTS] == 0.0
    part = [(d[VISIBLE], P[VISIBLE, VISIBLE]) for d, P in zip(off, sure, strict=True)]
    nees = np.array([d @ np.linalg.solve(P, d) for d, P in part]) / 3.0
    assert nees[300:600].mean() < 1.2
    assert nees[600:1200].mean() < 1.6
    np.testing.assert_allclose(ekf.noise()["encoder"][:3], factor, rtol=0.35)


@pytest.mark.long
def test_a_jump_still_begins_anew() -> None:
    ekf, off, _ = told_wrong(1.0, 0.02)
    assert ekf.belief.header[Entry.RESTARTS] == 1.0
    assert np.all(ekf.noise()["encoder"] < 2.0)
    assert abs(off[-1][1] - 0.02) < 1e-3  # one encoder alone is believed in the end
