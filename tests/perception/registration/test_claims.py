"""What a pose is claimed to be worth: against errors drawn in fields like those of real cameras."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.registration_bench import frame, model, poses
from tests.registration_kernels import linearise, opposite_pairs
from twin_diagram.perception.depth_noise import DepthSigma
from twin_diagram.perception.registration import claims
from twin_diagram.perception.registration.claims import claim, field_covariance, spread
from twin_diagram.perception.registration.data_association import look
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.station.sim.camera_noise import correlated


def told(correlated_share: float, lasting: float) -> Any:
    sheet = DepthSigma(0.0, 0.004, 0.0, correlated_share, lasting)
    return replace(frame(), camera=replace(frame().camera, depth_noise=sheet))


def test_of_colours_that_weigh_more_more_is_error() -> None:
    assert claims.colours_alike(0.3) == pytest.approx(4.0)
    assert claims.colours_alike(1.2 / 1.9) == pytest.approx(8.0), "four times the odds, twice the error"


@pytest.mark.parametrize("sigma", [1.5, 2.5, 6.0])
def test_the_sum_over_pairs_is_that_of_a_gaussian_correlation(sigma: float) -> None:
    rng = np.random.default_rng(4)
    u, v, a = rng.uniform(30.0, 90.0, 300), rng.uniform(200.0, 240.0, 300), rng.normal(size=(300, 3)) + [1.0, 0.2, -0.5]
    squared = (u[:, None] - u) ** 2 + (v[:, None] - v) ** 2
    wanted = a.T @ np.exp(-squared / (4.0 * sigma**2)) @ a
    np.testing.assert_allclose(spread(a, u, v, sigma), wanted, rtol=0.06, atol=0.03 * np.abs(wanted).max())


def test_white_noise_is_shared_within_a_pixel_alone() -> None:
    a = np.array([[1.0], [2.0], [4.0]])
    assert spread(a, np.array([3.1, 2.9, 4.0]), np.array([7.0, 7.0, 7.0]), 0.0)[0, 0] == pytest.approx(9.0 + 16.0)


def test_the_noise_of_a_sum_is_what_drawn_fields_make_it() -> None:
    """An image 160 px wide: a Gaussian of 2.5 px of 640 is one of 0.6 px there, a wave of 15 one of 3.75."""
    rng = np.random.default_rng(6)
    u, v = (x.ravel().astype(float) for x in np.meshgrid(np.arange(20, 60, 2), np.arange(30, 80, 2)))
    a = np.stack([np.ones(len(u)), u - 40.0, (v - 55.0) * 0.5], axis=1) / len(u)
    row, column = v.astype(int), u.astype(int)
    drawn = []
    for _ in range(1500):
        field = np.sqrt(0.1) * rng.standard_normal((120, 160))
        field += np.sqrt(0.6) * correlated((120, 160), 0.625, rng) + np.sqrt(0.3) * correlated((120, 160), 3.75, rng)
        drawn.append(a.T @ field[row, column])
    wanted = np.cov(np.array(drawn).T)
    found = field_covariance(a, u, v, told(0.6, 0.3), 1.0)
    root = np.linalg.inv(np.linalg.cholesky(wanted))
    np.testing.assert_allclose(np.linalg.eigvalsh(root @ found @ root.T), 1.0, atol=0.25)
    # What no sheet tells of is shared out as real cameras' noise is; a sheet of white noise alone is not believed then.
    white = field_covariance(a, u, v, told(0.0, 0.0), 1.0)
    both = field_covariance(a, u, v, told(0.0, 0.0), 2.0)
    np.testing.assert_allclose(both - white, 3.0 * field_covariance(a, u, v, told(0.4, 0.6), 1.0), rtol=1e-6)


@pytest.mark.parametrize("colour", [0.0, 0.3])
@pytest.mark.parametrize("some", [True, False])
def test_a_claim_is_the_sandwich(some: bool, colour: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """White noise, a pixel to each pair: S is a sum over pairs."""
    image, cloud, at = told(0.0, 0.0), model(), poses()[np.array([2])]
    looked = look(cloud, image, at, 40, FINE)
    points = at.p[0] + 0.06 * np.random.default_rng(3).normal(size=(30, 3)) if some else None
    monkeypatch.setattr(claims, "spread", lambda a, u, v, sigma: a.T @ a)
    found, _ = claim(looked, image, cloud, at, points, 0.02, colour, 1.0)
    plain = linearise(looked, image, FINE, 0.02, 0.0)[0].H[0]
    Hc = linearise(looked, image, FINE, 0.02, colour)[0].H[0] - plain
    H, S = plain + Hc, 4.0 * Hc
    camera = image.camera
    pairs = []
    for i in range(40):
        x = looked.r[0, i] + at.p[0]
        sigma = np.hypot(0.004 * looked.z[0, i] ** 2 * max(looked.facing[0, i], 0.2), 0.0007)
        if looked.matched[0, i] and abs(looked.deeper[0, i]) < 0.04 and abs(looked.distance[0, i]) < 0.02:
            w = (1.0 - (looked.distance[0, i] / 0.02) ** 2) ** 2 / sigma**2
            pairs.append((x, looked.n[0, i], w, looked.r[0, i]))
    if points is not None:
        opposite = opposite_pairs(cloud, points, at, camera.p_WC, 0.02)
        H = H + opposite.H
        for y, J, w in zip(opposite.seen, opposite.J, opposite.w, strict=True):
            pairs.append((y, -J[3:], w, None))
            a = J * w * (-J[3:] @ (y - camera.p_WC)) * 0.004 * camera.project(y[None])[2][0]
            S = S + np.outer(a, a)
    assert len(pairs) > 5
    for x, n, w, r in pairs:
        if r is not None:
            J = -np.concatenate([np.cross(r, n), n])
            a = J * w * (n @ (x - camera.p_WC)) * 0.004 * camera.project(x[None])[2][0]
            S = S + np.outer(a, a)
    least = np.diag([1.0] * 3 + [400.0] * 3)
    inverse = np.linalg.inv(H + least)
    wanted = inverse @ (S + least) @ inverse + np.diag([0.0005**2] * 3 + [0.00005**2] * 3)
    np.testing.assert_allclose(found, wanted, rtol=1e-6)


def test_where_the_image_says_nothing_the_claim_is_bounded() -> None:
    away = poses()[np.array([0])]
    away = type(away)(away.R, away.p + [0.0, 5.0, 0.0])
    looked = look(model(), frame(), away, 40, FINE)
    found = np.sqrt(np.diag(claim(looked, frame(), model(), away, None, 0.02, 0.3, 1.0)[0]))
    np.testing.assert_allclose(found, [1.0] * 3 + [0.05] * 3, rtol=1e-3)
