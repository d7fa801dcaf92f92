"""Profiles along paths against closed forms, and against phase planes that are searched by brute force."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.planning.paths.time_optimal import TUNING, profile
from twin_diagram.signals.arrays import Array

V, A = np.array([1.0, 0.5, 2.0]), np.array([4.0, 3.0, 10.0])
CORNERS = np.array([[0.0, 0, 0], [1.0, 0.2, -0.3], [1.2, 0.9, 0.4], [0.5, 1.0, 2.0]])


def by_grid(points: Array, begin: float, count: int = 4000) -> float:
    """Duration by integrating speeds² forwards and backwards over a fine grid along the path."""
    step = np.diff(points, axis=0)
    length = np.linalg.norm(step, axis=1)
    d = step / length[:, None]
    ends = np.concatenate([[0.0], np.cumsum(length)])
    s = np.linspace(0.0, ends[-1], count)
    of = np.minimum(np.searchsorted(ends, (s[1:] + s[:-1]) / 2) - 1, len(length) - 1)
    most, strong = np.min(V / np.abs(d), axis=1)[of], np.min(A / np.abs(d), axis=1)[of]
    square = np.minimum(np.append(most, np.inf), np.append(np.inf, most)) ** 2
    for i in range(1, len(length)):
        turn = np.abs(d[i] - d[i - 1])
        at = np.abs(s - ends[i]).argmin()
        square[at] = min(square[at], 8 * TUNING.rounding / (turn.max() * (turn / A).max()))
    square[0], square[-1] = begin**2, 0.0
    ds = s[1] - s[0]
    for i in range(count - 1):
        square[i + 1] = min(square[i + 1], square[i] + 2 * strong[i] * ds)
    for i in range(count - 2, -1, -1):
        square[i] = min(square[i], square[i + 1] + 2 * strong[i] * ds)
    speed = np.sqrt(square)
    return float((2 * ds / (speed[1:] + speed[:-1])).sum())


def test_a_straight_line_from_rest_to_rest_is_a_trapezoid_or_a_triangle() -> None:
    far = profile(np.array([[0.0, 0, 0], [2.0, 0, 0]]), V, A)
    assert far.duration == pytest.approx(2.0 / 1.0 + 1.0 / 4.0)
    np.testing.assert_allclose(far.at(np.array([0.0, 0.125, 0.25, 1.25, 9.0]))[:, 0], [0, 0.03125, 0.125, 1.125, 2.0])
    near = profile(np.array([[0.0, 0, 0], [0.1, 0, 0]]), V, A)
    assert near.duration == pytest.approx(2 * np.sqrt(0.1 / 4.0))
    # The slower joint sets the pace.
    both = profile(np.array([[0.0, 0, 0], [1.0, 1.0, 0]]), V, A)
    assert both.duration == pytest.approx(1.0 / 0.5 + 0.5 / 3.0)


def test_who_moves_already_goes_on_and_who_is_too_fast_brakes_harder() -> None:
    line = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    moving = profile(line, V, A, np.array([0.6, 0.3, 0.0]))
    assert moving.speeds[0] == pytest.approx(0.6)
    assert moving.duration == pytest.approx(0.4 / 4 + 1.0 / 4 + (1.0 - (1 - 0.36) / 8 - 1 / 8) / 1.0)
    assert profile(line, V, A, np.array([-0.6, 0, 0])).speeds[0] == 0.0
    assert profile(line, V, A, np.array([3.0, 0, 0])).speeds[0] == 1.0
    short = profile(line * 0.05, V, A, np.array([1.0, 0, 0]))
    assert short.duration == pytest.approx(0.1)  # 5 cm from 1 m/s, evenly
    np.testing.assert_allclose(short.at(np.array([0.05]))[:, 0], 0.0375)


@pytest.mark.parametrize("begin", [0.0, 0.3])
def test_no_profile_within_the_limits_is_quicker(begin: float) -> None:
    direction = (CORNERS[1] - CORNERS[0]) / np.linalg.norm(CORNERS[1] - CORNERS[0])
    way = profile(CORNERS, V, A, begin * direction)
    assert way.duration == pytest.approx(by_grid(CORNERS, begin), rel=2e-3)
    times = np.linspace(0.0, way.duration, 20001)
    q = way.at(times)
    np.testing.assert_allclose(q[[0, -1]], CORNERS[[0, -1]], atol=1e-9)
    h = times[1]
    v = np.diff(q, axis=0) / h
    assert (np.abs(v) <= V + 1e-6).all() and (np.abs(v) > 0.99 * V).any()
    a = np.abs(np.diff(v, axis=0)) / h
    # But for the corners themselves, which a motion rounds off.
    smooth = (a <= A + 1e-3).all(axis=1)
    assert smooth.sum() >= len(a) - 2 * (len(CORNERS) - 2)


def test_a_corner_is_passed_as_fast_as_it_can_be_rounded() -> None:
    corner = np.array([[0.0, 0, 0], [1.0, 0, 0], [1.0, 1.0, 0]])
    way = profile(corner, V, A)
    u = float(way.speeds[np.flatnonzero(np.isclose(way.places, 1.0))[0]])
    # Within T joint 1 loses u at 4 rad/s² and joint 2 gains it at 3; the corner is missed by u T / 8.
    T = u / 3.0
    assert u * T / 8 == pytest.approx(TUNING.rounding) or u == pytest.approx(0.5)
    straight = profile(np.array([[0.0, 0, 0], [0.5, 0, 0], [1.0, 0, 0]]), V, A)
    assert straight.duration == pytest.approx(1.0 + 0.25)
    back = profile(np.array([[0.0, 0, 0], [0.5, 0, 0], [0.0, 0, 0]]), V, A)
    turned = float(back.speeds[np.flatnonzero(np.isclose(back.places, 0.5))[0]])
    assert turned == pytest.approx(np.sqrt(8 * TUNING.rounding / (2.0 * 2.0 / 4.0)))


def test_without_a_way_or_a_limit_it_is_as_it_was() -> None:
    still = profile(np.zeros((1, 3)), V, A)
    assert still.duration == 0.0 and not still.at(np.array([0.0, 1.0])).any()
    twice = profile(np.array([[0.2, 0, 0], [0.2, 0, 0]]), V, A)
    np.testing.assert_allclose(twice.at(np.array([0.5])), [[0.2, 0, 0]])
    free = profile(CORNERS, V, np.full(3, np.inf))
    assert free.duration == pytest.approx((np.abs(np.diff(CORNERS, axis=0)) / V).max(axis=1).sum())


def test_who_brakes_gently_passes_corners_slowly_enough_for_it() -> None:
    """The last stretch is too short to come to rest on at half the deceleration from what the whole would allow."""
    found = profile(np.array([[0.0], [1.0], [1.05]]), np.array([10.0]), np.array([2.0]), gentle=0.5)
    rates = np.diff(found.speeds) / np.maximum(np.diff(found.times), 1e-12)
    assert rates.min() == pytest.approx(-1.0) and rates.max() == pytest.approx(2.0)
