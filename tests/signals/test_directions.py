"""Directions are even, and cover the sphere."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.signals.directions import fibonacci_sphere


def test_fibonacci_directions_are_even() -> None:
    d = fibonacci_sphere(1000)
    np.testing.assert_allclose(np.linalg.norm(d, axis=1), 1.0)
    np.testing.assert_allclose(d.mean(axis=0), 0.0, atol=2e-3)
    np.testing.assert_allclose(d.T @ d / 1000, np.eye(3) / 3, atol=2e-3)
    cosine = d @ d.T - 2 * np.eye(1000)
    nearest = np.degrees(np.arccos(cosine.max(axis=1)))
    assert nearest.min() > 0.6 * nearest.max()
    assert d[0, 2] == pytest.approx(1 - 2 * 0.5 / 1000)


def test_directions_are_spread_evenly_from_pole_to_pole() -> None:
    found = fibonacci_sphere(200)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)
    np.testing.assert_allclose(found[:, 2], 1.0 - (2.0 * np.arange(200) + 1.0) / 200.0)
    apart = np.sort(found @ found.T, axis=1)[:, -2]
    nearest = np.degrees(np.arccos(apart))
    assert 11.0 < nearest.min() and nearest.max() < 15.0  # 14.4° were 200 on a lattice of equal areas
    turn = np.diff(np.unwrap(np.arctan2(found[:, 1], found[:, 0])))
    np.testing.assert_allclose(np.abs(turn), np.pi * (3.0 - np.sqrt(5.0)), atol=1e-9)
