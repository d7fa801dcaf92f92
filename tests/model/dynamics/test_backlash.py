"""Gears with play among others: closed forms, and the laws of their impulses."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from twin_diagram.model.dynamics.backlash import play, play_alone

Array = NDArray[np.float64]

PERIOD = 0.001
SAMPLES = 3000
TIME = PERIOD * np.arange(SAMPLES)
NO_LOSS = np.zeros(2)


def _loads(seed: int, s: int = 2) -> Array:
    rng = np.random.default_rng(seed)
    load = 5.0 * np.sin(np.outer(TIME, 2.0 + 8.0 * rng.random(s)) + 6.0 * rng.random(s))
    return np.asarray(load + 0.5 * rng.normal(size=s))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("other", [np.inf, 900.0], ids=["beside play", "beside a spring"])
def test_a_gear_moves_as_if_alone_where_no_inertia_couples_it(seed: int, other: float) -> None:
    load = _loads(seed)
    mass = np.tile(np.diag([0.7, 0.3]), (SAMPLES, 1, 1))
    half = np.array([0.01, 0.02 if np.isinf(other) else 0.0])
    angle, rate, acceleration = play(mass, load, np.array([np.inf, other]), half, NO_LOSS, PERIOD)
    alone = play_alone(mass[:, 0, 0], load[:, 0], 0.01, PERIOD)
    for found, known in zip((angle, rate, acceleration), alone, strict=True):
        np.testing.assert_allclose(found[:, 0], known, rtol=0.0, atol=1e-9 * np.max(np.abs(known)))


@pytest.mark.parametrize("load", [4.0, -4.0])
def test_a_spring_behind_play_rests_where_it_carries_its_load(load: float) -> None:
    mass = np.tile(np.array([[0.5, 0.1], [0.1, 0.2]]), (SAMPLES, 1, 1))
    stiffness, half = np.array([400.0, 250.0]), np.array([0.02, 0.0])
    push = np.tile([load, 0.5 * load], (SAMPLES, 1))
    push[0] *= -1.0  # so that it begins elsewhere
    angle, rate, _ = play(mass, push, stiffness, half, np.array([0.01, 0.01]), PERIOD)
    expected = -np.sign(load) * (np.abs([load, 0.5 * load]) / stiffness + half)
    np.testing.assert_allclose(angle[-1], expected, rtol=1e-3)
    assert np.max(np.abs(rate[-1])) < 1e-3


@pytest.mark.parametrize("loss", [0.0, 1e-3])
def test_a_spring_beside_play_swings_as_long_as_its_loss_lets_it(loss: float) -> None:
    """Two kilograms' metres squared on 800 N·m/rad: 3.2 Hz, for three seconds."""
    mass = np.tile(np.diag([2.0, 0.3]), (SAMPLES, 1, 1))
    begin = np.array([[0.01, np.nan], [0.0, np.nan]])
    load = np.zeros((SAMPLES, 2))
    angle, *_ = play(mass, load, np.array([800.0, np.inf]), np.array([0.0, 0.01]), np.full(2, loss), PERIOD, begin)
    decay, swing = 0.5 * loss * 400.0, np.sqrt(400.0 - (0.5 * loss * 400.0) ** 2)
    known = 0.01 * np.exp(-decay * TIME) * (np.cos(swing * TIME) + decay / swing * np.sin(swing * TIME))
    np.testing.assert_allclose(angle[:, 0], known, rtol=0.0, atol=3e-5)


@pytest.mark.parametrize("seed", range(3))
def test_coupled_gears_pass_on_impulses_at_the_ends_of_their_play_alone(seed: int) -> None:
    load = _loads(seed)
    swing = 0.3 * np.sin(3.0 * TIME)
    mass = np.stack([np.array([[0.7, 0.3 + 0.1 * x], [0.3 + 0.1 * x, 0.3]]) for x in swing])
    half = np.array([0.01, 0.02])
    angle, rate, _ = play(mass, load, np.array([np.inf, np.inf]), half, NO_LOSS, PERIOD)
    assert np.all(np.abs(angle) <= half * (1.0 + 1e-9))
    np.testing.assert_allclose(angle[1:], angle[:-1] + PERIOD * rate[1:], rtol=0.0, atol=1e-15)
    impulse = np.einsum("kij,kj->ki", mass[1:], np.diff(rate, axis=0)) + 0.5 * PERIOD * (load[1:] + load[:-1])
    size = PERIOD * np.max(np.abs(load))
    inside = np.abs(angle[1:]) < half * (1.0 - 1e-9)
    assert 0.02 < np.mean(inside) < 0.98  # they both fly and rest
    assert np.max(np.abs(impulse[inside])) < 1e-9 * size
    assert np.all(impulse[~inside] * np.sign(angle[1:][~inside]) < 1e-6 * size)  # ends push back, they do not pull
