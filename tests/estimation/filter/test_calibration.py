"""What the filter claims against what it is: gates at their stated probability, noise as drawn torque makes it."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.stats import chi2

from tests.estimation_bench import COULOMB, HOME, twin_terms
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.process_model import jacobians, step
from twin_diagram.estimation.filter.belief import SensorTrack
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.filter.fault_isolation import alarming
from twin_diagram.estimation.filter.sensor_registry import note
from twin_diagram.estimation.sensors import BodyPose
from twin_diagram.scenario import Filter
from twin_diagram.signals.arrays import Array

PASSES = 1.0 - 1e-6
"""Probability with which a good reading passes its gate."""
SPEED = np.array([0.5, -0.4, 0.6, 0.3, -0.5, 0.4, 0.7])
"""All joints slide [rad/s]."""


@functools.cache
def terms() -> ArmTerms:
    return twin_terms()


def moving() -> tuple[Ekf, Array]:
    """A filter whose arm is known to move, and the torque that keeps it moving."""
    ekf = Ekf(terms(), Filter())
    terms().set_payload(np.zeros(4))
    tau = terms().inverse_dynamics(HOME, SPEED, 0.0) + np.sign(SPEED) * COULOMB
    ekf.start(HOME, SPEED, tau, 0.0)
    return ekf, tau


@pytest.mark.parametrize(("share", "accepted"), [(0.97, True), (1.03, False)])
def test_a_gate_lets_pass_what_it_says(share: float, accepted: bool) -> None:
    """A reading is refused just beyond the χ² quantile of its own degrees of freedom, now and late."""
    rng = np.random.default_rng(4)
    for size, name in ((7, "encoder"), (7, "velocity"), (14, "joints")):
        ekf, _ = moving()
        part = slice(0, 7) if name == "encoder" else slice(7, 14) if name == "velocity" else slice(0, 14)
        std = np.repeat([ekf.params.encoder_std, ekf.params.velocity_std], 7)[part]
        S = ekf.belief.P[part, part] + np.diag(std**2)
        way = np.linalg.cholesky(S) @ rng.normal(size=size)
        way *= np.sqrt(share * chi2.ppf(PASSES, size) / (way @ np.linalg.solve(S, way)))
        assert ekf.update(name, ekf.belief.x[part] + way, explain=False).accepted is accepted


@pytest.mark.parametrize(("share", "accepted"), [(0.97, True), (1.03, False)])
def test_a_late_reading_meets_the_same_gate(share: float, accepted: bool) -> None:
    ekf, tau = moving()
    camera = BodyPose(ekf.terms, "panda_hand")
    ekf.add(camera)
    before = ekf.belief.x.copy(), ekf.belief.P.copy()
    for _ in range(3):
        ekf.predict(tau, 0.005)
    H = camera.jacobian(before[0])
    S = H @ before[1] @ H.T + camera.noise(before[0])
    z = camera.reading(before[0])
    z[4] += np.sqrt(share * chi2.ppf(PASSES, 6) / np.linalg.inv(S)[3, 3])
    result = ekf.update(camera, z, 0.0)
    assert result.accepted is accepted
    assert result.late or not accepted


@pytest.mark.parametrize("size", [1, 4])
def test_a_change_alarms_at_its_quantile(size: int) -> None:
    """With forgetting λ = 0.9 the gradient's variance is I / (1 + λ): so the statistic is χ²."""
    rng = np.random.default_rng(5)
    A = rng.normal(size=(size, size))
    information = A @ A.T + np.eye(size)
    g = rng.normal(size=size)
    g *= np.sqrt(chi2.ppf(1.0 - 1e-9, size) / (1.9 * (g @ np.linalg.solve(information, g))))
    for factor, found in ((0.98, False), (1.02, True)):
        score = np.column_stack([information, factor * g])
        assert alarming(score, [slice(0, size)]) is found


def test_a_sensor_that_agrees_has_the_record_of_white_noise() -> None:
    """The run's sum is as large as the reading has degrees of freedom, NIS over them 1."""
    rng = np.random.default_rng(6)
    track, runs, means = np.zeros(len(SensorTrack) + 3), [], []
    for k in range(6000):
        white = rng.normal(size=3)
        note(track, white, float(white @ white), 0.01 * k, True)
        if k > 200:
            runs.append(track[SensorTrack.RUN])
            means.append(track[SensorTrack.NIS_MEAN])
    assert np.mean(runs) == pytest.approx(3.0, rel=0.15)
    assert np.mean(means) == pytest.approx(1.0, rel=0.05)
    assert track[SensorTrack.ACCEPTED] == 6000


@pytest.mark.parametrize("dt", [0.005, 0.0025])
def test_white_torque_spreads_speeds_as_drawn_torque_does(dt: float) -> None:
    """σ is of white noise over one period: over half of one its mean is √2 times as uncertain."""
    found = []
    for torque_std in (0.0, 0.3):
        ekf, tau = moving()
        ekf.predict(tau, dt, torque_std)
        found.append(ekf.belief.P[7:14, 7:14].copy())
    ekf, tau = moving()
    still = step(terms(), ekf.parameters, HOME, SPEED, np.zeros(4), tau, np.zeros(7), dt)
    by = np.empty((7, 7))
    for i, unit in enumerate(1e-3 * np.eye(7)):
        by[:, i] = (step(terms(), ekf.parameters, HOME, SPEED, np.zeros(4), tau, unit, dt).v - still.v) / 1e-3
    expected = 0.3**2 * (0.005 / dt) * by @ by.T
    scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
    # The slope of friction that the filter takes is that of its secant, which shows at the light wrist.
    np.testing.assert_allclose((found[1] - found[0]) / scale, expected / scale, atol=0.12)


def test_what_was_just_learnt_moves_the_prediction() -> None:
    """θ that the physics has not taken over yet acts through its derivative, on angles and on speeds."""
    learnt, found = np.array([0.03, 0.0005, -0.001, 0.004]), []
    for theta in (np.zeros(4), learnt):
        ekf, tau = moving()
        ekf.belief.theta[:] = theta
        ekf.predict(tau, 0.005)
        np.testing.assert_array_equal(ekf.belief.model, 0.0)  # not taken over
        found.append(ekf.belief.x[:14].copy())
    moved = step(terms(), ekf.parameters, HOME, SPEED, np.zeros(4), tau, np.zeros(7), 0.005)
    by = jacobians(terms(), ekf.parameters, moved, SPEED, np.zeros(4), 0.005, np.zeros(7), tau)
    expected = by.parameters @ learnt
    for part in (slice(0, 7), slice(7, 14)):
        size = np.abs(expected[part]).max()
        np.testing.assert_allclose((found[1] - found[0])[part], expected[part], atol=0.02 * size)
