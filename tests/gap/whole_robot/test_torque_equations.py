"""Logs summed up: what is left in time is what the sums say, and repeats are of one kind."""

from __future__ import annotations

import numpy as np

from tests.gap.made import ARM, record, swing
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot.torque_equations import equations, kinds_of_motion


def test_sums_say_what_a_difference_leaves() -> None:
    rng = np.random.default_rng(4)
    time, q, v, a = swing(8.0)
    extra = 2.0 * v + 0.5 * a - 0.7
    sums = equations(Records(ARM, (record(ARM, time, q, v, a, extra=extra),)))
    difference = np.zeros((6, 64))
    np.testing.assert_allclose(sums.left(difference), sums.columns[:, :, -1] * sums.weights)
    difference[:, 60], difference[:, 62], difference[:, 63] = 2.0, 0.7, 0.5
    assert np.max(np.abs(sums.left(difference))) < 1e-6 * np.max(np.abs(extra))
    difference = rng.normal(size=(6, 64))
    full = np.concatenate([-difference, np.ones((6, 1))], axis=1)
    squares = np.einsum("jk,sjkl,jl->j", full, sums.sums, full)
    np.testing.assert_allclose(np.sum(sums.left(difference) ** 2, axis=0), squares, rtol=1e-9)
    np.testing.assert_allclose(np.sum(sums.counts, axis=0), np.sum(sums.weights, axis=0))


def test_a_motion_that_comes_back_is_of_the_same_kind() -> None:
    once = np.random.default_rng(5).normal(size=(20, 6))
    kinds = kinds_of_motion(np.vstack([once, once + 1e-6]))
    assert np.mean(kinds[:20] == kinds[20:]) > 0.85
    assert sorted(np.unique(kinds)) == [0, 1, 2, 3, 4]
    assert np.max(np.bincount(kinds)) <= 8
