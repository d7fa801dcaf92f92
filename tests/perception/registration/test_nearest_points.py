"""The nearest of a cloud's points, beside those of a search tree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from twin_diagram.perception.registration.cloud_kernels import within
from twin_diagram.perception.registration.nearest_points import NearestPoints
from twin_diagram.perception.registration.rotation import exp


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    count=st.integers(1, 400),
    spacing=st.floats(0.0005, 0.03),
    away=st.floats(0.0, 0.1),
    reach=st.floats(0.001, 0.08),
)
def test_the_nearest_are_those_of_a_tree(seed: int, count: int, spacing: float, away: float, reach: float) -> None:
    rng = np.random.default_rng(seed)
    cloud = rng.normal(size=(count, 3)) * [0.05, 0.02, 0.1] + [0.3, -0.2, 0.1]
    asked = cloud[rng.integers(0, count, 60)] + rng.normal(0.0, away, (60, 3))
    distance, index = NearestPoints.of(cloud, spacing).query(asked, reach)
    wanted, number = cKDTree(cloud).query(asked, distance_upper_bound=reach)
    hit = np.isfinite(wanted)
    np.testing.assert_array_equal(np.isfinite(distance), hit)
    np.testing.assert_allclose(distance[hit], wanted[hit], atol=1e-12)
    np.testing.assert_array_equal(index[hit], number[hit])
    assert (index[~hit] == -1).all()


@pytest.mark.parametrize("shift", [0.0, 5.0, -5.0])
def test_far_away_there_is_none(shift: float) -> None:
    cloud = NearestPoints.of(np.zeros((1, 3)), 0.002)
    distance, index = cloud.query(np.array([[shift, 0.0, 0.0]]), 0.02)
    assert (distance[0] == 0.0 and index[0] == 0) if shift == 0.0 else (np.isinf(distance[0]) and index[0] == -1)


@pytest.mark.parametrize("most", [-1, 40, 1000])
def test_points_within_reach_are_those_of_a_tree(most: int) -> None:
    rng = np.random.default_rng(8)
    cloud = rng.normal(size=(300, 3)) * [0.05, 0.02, 0.1]
    R, p, reach = exp(np.array([[0.3, -0.8, 0.5]]))[0], np.array([0.4, -0.1, 0.2]), 0.02
    points = p + rng.normal(0.0, 0.08, (2000, 3))
    radius = float(np.linalg.norm(cloud, axis=1).max())
    near = np.flatnonzero(np.linalg.norm(points - p, axis=1) < radius + reach)
    asked = near if most < 0 else near[:: max(1, len(near) // most)]
    wanted = asked[cKDTree(cloud).query((points[asked] - p) @ R)[0] < reach]
    assert 0 < len(wanted) < len(asked)
    found = within(points, (R, p), NearestPoints.of(cloud, 0.01).grid, radius, reach, most)
    np.testing.assert_array_equal(found, wanted)
