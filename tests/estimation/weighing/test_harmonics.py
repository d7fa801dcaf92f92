"""Motions that start and end at rest."""

from __future__ import annotations

import numpy as np

from twin_diagram.estimation.weighing.harmonics import Harmonics

SERIES = Harmonics(10.0, 15)


def test_every_free_number_starts_and_ends_at_rest() -> None:
    for part in SERIES.at(np.array([0.0, 10.0])):
        assert part.shape == (2, SERIES.size) == (2, 27)
        np.testing.assert_allclose(part, 0.0, atol=1e-9)


def test_velocity_and_acceleration_are_derivatives() -> None:
    time, step = np.linspace(0.0, 10.0, 101), 1e-5
    _, v, a = SERIES.at(time)
    after, before = SERIES.at(time + step), SERIES.at(time - step)
    np.testing.assert_allclose((after[0] - before[0]) / (2 * step), v, atol=1e-7)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * step), a, atol=1e-6)


def test_no_frequency_beyond_the_last_and_all_up_to_it() -> None:
    count = 400
    q = SERIES.at(np.arange(count) * 10.0 / count)[0]
    power = np.abs(np.fft.rfft(q, axis=0)).sum(axis=1)
    assert np.all(power[1:16] > 1e-2 * power.max())
    assert np.all(power[16:] < 1e-9 * power.max())
    np.testing.assert_allclose(power[0], 0.0, atol=1e-9 * power.max())


def test_the_free_numbers_are_independent_and_of_the_order_of_one_in_speed() -> None:
    v = SERIES.at(np.linspace(0.0, 10.0, 500))[1]
    assert np.linalg.matrix_rank(v) == SERIES.size
    assert 0.3 < np.sqrt(np.mean(v**2)) < 1.5
