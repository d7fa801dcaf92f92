"""The wrench of a swung load: against a point's own motion, by differences and by drawing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw

from tests.estimation_bench import HOME, twin_terms
from twin_diagram.estimation.sensors import Instant, KnownTool, WristWrench
from twin_diagram.estimation.sensors.wrist_wrench import point_moment
from twin_diagram.signals.arrays import Array

X_LS = RigidTransform(RollPitchYaw(0.3, -0.2, 0.5), [0.02, -0.03, 0.08])
TOOL = KnownTool(0.7, np.array([0.01, 0.03, 0.06]))
PAYLOAD, OWN = slice(21, 25), slice(25, 31)
ARM = twin_terms()


def wrench(tool: KnownTool | None = TOOL, payload: bool = True) -> WristWrench:
    sensor = WristWrench(ARM, "panda_link7", X_LS, tool=tool)
    sensor.declare(OWN, PAYLOAD if payload else None)
    return sensor


def moving(seed: int, mass: float = 1.2) -> Instant:
    rng = np.random.default_rng([1380, seed])
    x = np.concatenate([HOME + rng.normal(0, 0.3, 7), rng.normal(size=7), np.zeros(7), np.zeros(10)])
    x[PAYLOAD] = mass * np.array([1.0, 0.05, -0.03, 0.2])
    x[OWN] = rng.normal(0, 0.1, 6)
    return Instant(x, 7, 4, 3.0 * rng.normal(size=7))


def by_points(now: Instant, tool: KnownTool | None, h: float = 1e-4) -> Array:
    """Newton's law for each point: its acceleration by differences of its place along the motion."""
    sensor = wrench(tool)
    loads = [] if tool is None else [(tool.mass, X_LS.multiply(tool.com))]
    mass = now.x[21]
    if mass > 0.0:
        loads.append((mass, now.x[22:25] / mass))
    R_WS, p_WS = sensor.frame.pose(now.q)
    total = np.zeros(6)
    for m, p_LC in loads:
        places = []
        for t in (-h, 0.0, h):
            R, p = sensor.frame.pose(now.q + t * now.v + 0.5 * t**2 * now.acceleration)
            X_SL = X_LS.inverse()
            places.append(p + R @ X_SL.multiply(p_LC))
        force = m * ((places[0] - 2.0 * places[1] + places[2]) / h**2 + [0.0, 0.0, 9.81])
        total += np.concatenate([R_WS.T @ np.cross(places[1] - p_WS, force), R_WS.T @ force])
    return total


@pytest.mark.parametrize("seed", range(3))
def test_it_is_what_moves_the_points_beyond_the_sensor(seed: int) -> None:
    now = moving(seed)
    for tool in (None, TOOL):
        reading = wrench(tool).linear(now).reading
        np.testing.assert_allclose(reading - now.x[OWN], by_points(now, tool), atol=2e-5)
    bare = replace(now, x=np.concatenate([now.x[:21], np.zeros(4), now.x[OWN]]))
    np.testing.assert_allclose(
        wrench(TOOL, payload=False).linear(now).reading - now.x[OWN], by_points(bare, TOOL), atol=2e-5
    )


def difference(now: Instant, index: int, by: Array | None = None) -> Array:
    """The reading's derivative by an entry of x, accelerations following by (7,)."""
    ends = []
    for step in (1e-5, -1e-5):
        x = now.x.copy()
        x[index] += step
        ends.append(
            wrench().linear(replace(now, x=x, acceleration=now.acceleration + (0.0 if by is None else step * by)))
        )
    return np.asarray((ends[0].reading - ends[1].reading) / 2e-5)


def test_its_derivatives_by_load_and_by_what_accelerates_the_arm() -> None:
    now, rng = moving(4), np.random.default_rng(1381)
    by_state = np.zeros((7, 31))
    by_state[:, 14:21] = rng.normal(size=(7, 7))
    by_state[:, PAYLOAD] = rng.normal(size=(7, 4))
    H = wrench().linear(replace(now, by_state=by_state)).jacobian
    for i in range(14, 31):
        np.testing.assert_allclose(H[:, i], difference(now, i, by_state[:, i]), atol=1e-5)
    noise = rng.normal(size=(7, 7))
    noise = noise @ noise.T
    at = wrench().linear(replace(now, acceleration_noise=noise))
    by_a = np.column_stack([difference(now, 14, unit) for unit in np.eye(7)])
    own = np.diag(np.square(np.repeat([0.01, 0.1], 3)))
    np.testing.assert_allclose(at.noise, own + by_a @ noise @ by_a.T, rtol=1e-6, atol=1e-6)


def test_what_is_learnt_of_a_load_comes_by_the_acceleration_observed() -> None:
    now, steady = moving(5), np.linspace(-2.0, 2.0, 7)
    H = wrench().linear(replace(now, steady=steady)).jacobian
    for i in range(21, 25):
        np.testing.assert_allclose(H[:, i], difference(replace(now, acceleration=steady), i), atol=1e-6)
    np.testing.assert_allclose(
        wrench().linear(replace(now, steady=steady)).reading, wrench().linear(now).reading, atol=1e-12
    )


def test_a_load_and_an_acceleration_that_are_both_unknown_make_a_product() -> None:
    """Mean and covariance of m (a − g) and mc × (a − g), α × mc, each about its mean: by 60 000 draws."""
    now, rng = moving(6), np.random.default_rng(1382)
    sensor = wrench()
    P = np.zeros((31, 31))
    A = rng.normal(size=(11, 11)) * np.concatenate([np.full(7, 0.5), [0.5, 0.1, 0.1, 0.1]])[:, None]
    P[14:25, 14:25] = A @ A.T
    by_state = np.zeros((7, 31))
    by_state[:, 14:21] = np.eye(7)
    B = rng.normal(size=(7, 7))
    white = 0.3 * B @ B.T
    whole = replace(now, by_state=by_state, acceleration_noise=white)
    first, both = sensor.linear(whole), sensor.linear(replace(whole, covariance=P))
    drawn = rng.multivariate_normal(np.zeros(31), P, 60_000)
    a = drawn[:, 14:21] + rng.multivariate_normal(np.zeros(7), white, 60_000)
    motion = sensor.frame.motion(now.q, now.v)
    lift, alpha = a @ (motion.R_WF.T @ motion.J_v).T, a @ (motion.R_WF.T @ motion.J_w).T
    R, p = X_LS.inverse().rotation().matrix(), X_LS.inverse().translation()
    mass = drawn[:, 21:22]
    moment = drawn[:, 22:25] @ R.T + mass * p
    wrenches = np.hstack([np.cross(moment, lift), mass * lift + np.cross(alpha, moment)])
    scale = wrenches.std(axis=0)
    np.testing.assert_allclose((both.reading - first.reading) / scale, wrenches.mean(axis=0) / scale, atol=0.02)
    found = (both.noise - first.noise) / np.outer(scale, scale)
    np.testing.assert_allclose(found, np.cov(wrenches.T) / np.outer(scale, scale), atol=0.06)
    np.testing.assert_array_equal(both.jacobian, first.jacobian)


@pytest.mark.parametrize(("mass", "counts"), [(0.04, 0.05), (0.06, 0.06), (0.0, 0.05), (-1.0, 0.05)])
def test_what_weighs_less_than_fifty_grams_has_no_centre_to_speak_of(mass: float, counts: float) -> None:
    moment, turning = np.array([0.01, -0.02, 0.03]), np.random.default_rng(1383).normal(size=(3, 3))
    centre = moment / counts
    found, by = point_moment(np.array([mass, *moment]), turning)
    np.testing.assert_allclose(found, counts * np.cross(centre, turning @ centre))
    assert bool(np.any(by[:, 0])) == (mass > 0.05)
    for k in range(3):
        step = 1e-6 * np.eye(3)[k]
        ends = [point_moment(np.array([mass, *(moment + sign * step)]), turning)[0] for sign in (1.0, -1.0)]
        np.testing.assert_allclose(by[:, 1 + k], (ends[0] - ends[1]) / 2e-6, atol=1e-6)
    if mass > 0.05:
        ends = [point_moment(np.array([mass + step, *moment]), turning)[0] for step in (1e-6, -1e-6)]
        np.testing.assert_allclose(by[:, 0], (ends[0] - ends[1]) / 2e-6, atol=1e-5)
