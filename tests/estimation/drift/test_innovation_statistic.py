"""NIS as an average, as Page's sum, in a row, and a torque that stays: against the same in plain numbers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from twin_diagram.estimation.drift import innovation_statistic
from twin_diagram.estimation.drift.state import DriftEntry, DriftState
from twin_diagram.signals.arrays import Array

N, DT, SIGMA = 3, 0.005, 6.0
DOF = 2 * N
WIDER = np.array([1.0, 1.0, 2.2])
WHITE = float(chi2.isf(1e-9, N))
"""What white sums exceed once in a billion messages."""


def monitor_state() -> DriftState:
    return DriftState(N, 0, 3, 4, 0, 0, 0)


class Plain:
    """What the module's docstring says, with a list of all that was learnt from."""

    def __init__(self) -> None:
        self.average = self.page = 0.0
        self.averages: list[float] = []
        self.squares = 0.0
        self.changes: list[Array] = []
        self.sums: Array = np.zeros((3, N))

    def take(self, nis: float, white: Array, dt: float, learning: bool, normal: float) -> float:
        blend = min(dt / 0.1, 1.0)
        mean = float(np.mean(self.averages)) if self.averages else 0.0
        usual = max(DOF, mean)
        capped = min(nis, usual + 0.5 * SIGMA * np.sqrt(DOF / blend))
        self.average = (1.0 - blend) * self.average + blend * capped
        self.sums = np.array([0.5, 0.8, 0.95])[:, None] * self.sums + white
        change = np.array([0.75, 0.36, 0.0975]) * np.sum(self.sums**2, axis=1)
        if learning:
            self.averages.append(self.average)
            self.squares += (capped - np.mean(self.averages)) ** 2
            self.changes.append(change)
            return 0.0
        widened = SIGMA * (1.0 + 2.0 / np.sqrt(max(normal / 0.1, 1.0)))
        claimed = 2.5 * DOF + SIGMA * np.sqrt(DOF * blend)
        threshold = max(mean + widened * np.std(self.averages), claimed)
        deviation = np.sqrt(max(self.squares / len(self.averages), 2.0 * DOF))
        self.page = max(0.0, self.page + min((nis - 2.5 * usual) / deviation, 0.5 * SIGMA) - 0.5)
        levels = [self.average / threshold, self.page / (2.0 * SIGMA)]
        self.page = min(self.page, 4.0 * SIGMA)
        learnt = np.mean(self.changes, axis=0) + widened * np.std(self.changes, axis=0)
        levels.append(float(np.max(change / np.maximum(learnt, WIDER * WHITE))))
        return max(levels)


@pytest.mark.parametrize(("seed", "scale"), [(0, 1.0), (1, 4.0), (2, 0.2), (3, 12.0)])
def test_is_what_plain_numbers_say(seed: int, scale: float) -> None:
    """A filter that claims too little noise, or too much; after 180 messages it gets worse and well again."""
    rng, state, plain = np.random.default_rng([1303, seed]), monitor_state(), Plain()
    state.header[DriftEntry.NIS] = plain.average = 5.0
    normal, found = 0.0, []
    for k in range(480):
        learning, dt = k < 180, DT * (1.0 + (k % 5 == 0))
        worse = 1.0 + 4.0 * np.clip((k - 200) / 150, 0.0, 1.0) * (k < 420)
        nis = scale * worse * float(rng.chisquare(DOF))
        white = 0.5 * np.sqrt(scale * worse) * rng.normal(size=N)
        white *= min(1.0, 5.9 / float(np.linalg.norm(white)))
        normal += dt * learning
        state.header[DriftEntry.NORMAL] = normal
        got = innovation_statistic.innovation_test(state, nis, white, dt, SIGMA, learning, not learning)
        found.append((got, plain.take(nis, white, dt, learning, normal)))
    np.testing.assert_allclose(*np.transpose(found), rtol=1e-6, atol=1e-9)
    header = state.header
    assert header[DriftEntry.NIS] == pytest.approx(plain.average)
    assert header[DriftEntry.SUM] == pytest.approx(plain.page)
    assert header[DriftEntry.MEAN] == pytest.approx(np.mean(plain.averages))
    assert header[DriftEntry.SQUARES] == pytest.approx(np.var(plain.averages) * len(plain.averages))
    assert header[DriftEntry.SPREAD] == pytest.approx(plain.squares)


def test_without_whitened_innovations_the_change_test_is_left_out() -> None:
    with_it, without = monitor_state(), monitor_state()
    for state, white in ((with_it, np.full(N, 9.0)), (without, None)):
        state.header[DriftEntry.NORMAL] = 10.0
        found = [innovation_statistic.innovation_test(state, DOF, white, DT, SIGMA, False, True) for _ in range(20)]
        assert (found[-1] > 1.0) == (white is not None)
    assert not without.sums.any() and without.header[DriftEntry.CHANGE] == 0.0


def test_nothing_is_said_before_it_is_armed() -> None:
    state = monitor_state()
    assert innovation_statistic.innovation_test(state, 1e4, np.full(N, 5.0), DT, SIGMA, False, False) == 0.0
    assert state.header[DriftEntry.SUM] == 0.0 and state.header[DriftEntry.COUNT] == 0.0


def test_messages_that_are_far_off_in_a_row() -> None:
    """Ten times what is normal is far; two in a row are over the threshold of one and a half, three count as two."""
    state = monitor_state()
    said = []
    for nis in (61.0, 59.0, 61.0, 61.0, 61.0, 61.0, 60.0, 61.0):
        innovation_statistic.innovation_test(state, nis, None, DT, SIGMA, False, False)
        said.append(innovation_statistic.in_a_row(state))
    np.testing.assert_allclose(said, [2 / 3, 0.0, 2 / 3, 4 / 3, 2.0, 2.0, 0.0, 2 / 3])


def test_another_model_forgets_what_was_measured_and_keeps_what_is_normal() -> None:
    entries = [DriftEntry.SUM, DriftEntry.CHANGE, DriftEntry.LOUD]
    for count, average, left in ((0.0, 50.0, 6.0), (10.0, 50.0, 8.0), (10.0, 3.0, 3.0)):
        state = monitor_state()
        h = state.header
        h[DriftEntry.COUNT], h[DriftEntry.MEAN], h[DriftEntry.NIS] = count, 8.0, average
        h[entries], state.sums[:] = 5.0, 1.0
        innovation_statistic.forget(state)
        assert h[DriftEntry.NIS] == left and h[DriftEntry.MEAN] == 8.0
        assert not h[entries].any() and not state.sums.any()
