"""The compiled sums of a calibration against the same written out with arrays."""

from __future__ import annotations

import numpy as np
from pydrake.math import RollPitchYaw

from twin_diagram.perception.calibration_kernels import distances, normal_equations, scatter, seen_at
from twin_diagram.perception.depth_noise import DepthSigma, excess_of
from twin_diagram.signals.calibration_error import point_shifts

RNG = np.random.default_rng(4)
R_WC, P_WC, LENS = RollPitchYaw(-2.2, 0.1, 1.4).ToRotationMatrix().matrix(), np.array([1.4, 0.1, 0.8]), (600.0, 610.0)
PIXELS, Z = RNG.uniform(0.0, 480.0, (50, 2)), RNG.uniform(0.7, 1.6, 50)
NORMALS = RNG.standard_normal((50, 3))
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)


def test_points_are_seen_where_a_pinhole_shows_them() -> None:
    points_C, points_W = seen_at(PIXELS, Z, np.array([*LENS, 318.0, 241.0]), R_WC, P_WC)
    x, y = (PIXELS - [318.0, 241.0]).T / np.array(LENS)[:, None]
    np.testing.assert_allclose(points_C, np.column_stack([x * Z, y * Z, Z]), atol=1e-12)
    np.testing.assert_allclose(points_W, points_C @ R_WC.T + P_WC, atol=1e-12)


def test_distances_are_along_the_normals_and_noise_along_the_sight() -> None:
    points_W, places = P_WC + RNG.standard_normal((50, 3)), RNG.standard_normal((50, 3))
    noise = DepthSigma(0.001, 0.003, 0.4)
    told = (noise.floor, noise.growth, noise.start)
    distance, sigma = distances(points_W, places, NORMALS, P_WC, Z, told, 1e-5)
    np.testing.assert_allclose(distance, np.sum(NORMALS * (points_W - places), axis=1), atol=1e-12)
    across = np.abs(np.sum(NORMALS * (points_W - P_WC), axis=1)) / Z
    np.testing.assert_allclose(sigma, np.maximum(noise(Z) * across, 1e-5), rtol=1e-12)
    for factor in (0.5, 3.0):
        size = excess_of(scatter(factor * distance, sigma), 50)
        assert size == excess_of(float(np.median(np.abs(factor * (distance - np.median(distance))) / sigma)), 50)


def test_normal_equations_are_those_of_the_shifts() -> None:
    points_C = np.column_stack([RNG.uniform(-0.6, 0.6, (50, 2)), Z])
    distance, weight = RNG.standard_normal(50), RNG.uniform(0.0, 2.0, 50) * (RNG.random(50) < 0.8)
    H, b, along, total, pull = normal_equations(points_C, NORMALS, distance, weight, R_WC, *LENS)
    J = np.einsum("ni,nij->nj", NORMALS, point_shifts(points_C, R_WC, *LENS))
    np.testing.assert_allclose(H, J.T @ (J * weight[:, None]), atol=1e-10)
    np.testing.assert_allclose(b, J.T @ (weight * distance), atol=1e-10)
    np.testing.assert_allclose(along, J.T @ weight, atol=1e-10)
    np.testing.assert_allclose([total, pull], [weight.sum(), weight @ distance], atol=1e-12)
