"""Dry friction that is learnt: of joints that slide, surely, and of others by what they have in common."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from tests.estimation_bench import COULOMB, HOME, twin_terms
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.estimation.filter.belief import Belief
from twin_diagram.estimation.filter.disturbance import SMALLEST, follow_disturbance, sure_to_slide
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.scenario import Filter

FRICTION = Filter(parameters=["viscous_friction", "coulomb_friction", "payload"])


@settings(max_examples=50, deadline=None)
@given(v=st.floats(-0.3, 0.3), std=st.floats(1e-4, 0.1))
def test_sureness_is_the_mean_of_the_sign(v: float, std: float) -> None:
    belief = Belief(2, 0)
    belief.v[:], belief.regime[:] = v, [1.0, 0.0]
    belief.P[2, 2] = belief.P[3, 3] = std**2
    np.testing.assert_allclose(sure_to_slide(belief), [abs(1.0 - 2.0 * norm.cdf(0.0, v, std)), 0.0], atol=1e-12)


def test_regressor_of_friction_alone_counts_by_sureness() -> None:
    terms = twin_terms()
    parameters = ParameterSet(terms, FRICTION)
    v, a, sure = np.linspace(-1.0, 1.0, 7), np.ones(7), np.linspace(0.0, 1.0, 7)
    plain = parameters.regressor(terms, HOME, v, a, a)
    part = parameters.regressor(terms, HOME, v, a, a, sure)
    np.testing.assert_array_equal(part[:, 14:], plain[:, 14:])
    np.testing.assert_allclose(part[:, :14], sure[:, None] * plain[:, :14])


def test_creeping_joint_teaches_no_friction() -> None:
    """Speeds that are mostly noise seem to slide now this way, now that: a level of friction was made of it, surely."""
    terms, rng = twin_terms(), np.random.default_rng(1401)
    ekf = Ekf(terms, Filter(encoder_std=1e-3, velocity_std=1e-2, parameters=["coulomb_friction"]))
    v = np.full(7, -0.008)  # slower than what tells sliding from noise
    for k in range(600):
        q = HOME + 0.005 * k * v
        tau = terms.inverse_dynamics(q, v, np.zeros(7)) - 0.3 * COULOMB
        speed = v if k == 0 else v + 1e-2 * rng.normal(size=7)
        ekf.observe(q + 1e-3 * rng.normal(size=7), speed, tau, 0.005 * k)
    off = ekf.belief.theta + 0.7 * COULOMB
    assert np.all(np.abs(off) < 3.0 * np.sqrt(ekf.belief.P.diagonal()[21:28]))
    assert np.all(np.abs(ekf.belief.theta) < 0.5 * ekf.parameters.scale)


def test_changes_of_friction_go_together() -> None:
    parameters = ParameterSet(twin_terms(), Filter(parameters=["coulomb_friction"]))
    opening, level = parameters.opening, COULOMB
    assert np.linalg.eigvalsh(opening).min() > 0.0
    # Six joints are found at a third: of the seventh, which rests, most of that is expected, and not for certain.
    known = np.arange(6)
    gain = np.linalg.solve(opening[np.ix_(known, known)], opening[known, 6])
    expected = gain @ (-2.0 / 3.0 * level[:6]) / level[6]
    assert -2.0 / 3.0 < expected < -0.5
    assert 0.5 < np.sqrt(opening[6, 6] - gain @ opening[known, 6]) / level[6] < 1.0


@pytest.mark.parametrize(("true", "least", "most"), [(0.02, 0.15, 0.55), (0.1, 0.7, 1.0), (0.5, 0.99, 1.0)])
def test_size_of_a_disturbance_is_learnt_and_never_grows(true: float, least: float, most: float) -> None:
    """Of a disturbance of the size given, a fifth of it, and five times it, watched well for 40 s; mean over joints."""
    rng, belief, params = np.random.default_rng(1402), Belief(7, 0), Filter(torque_drift_std=0.1)
    belief.regime[:], belief.v[:] = 1.0, 0.5
    d, dt = true * rng.normal(size=7), 0.005
    for _ in range(8000):
        keep = np.exp(-dt / params.torque_drift_time)
        d = keep * d + np.sqrt(1.0 - keep**2) * true * rng.normal(size=7)
        belief.disturbance[:] = d
        follow_disturbance(belief, params, np.full(7, 0.1**2), dt)
    factor = np.exp(0.5 * belief.steady)
    assert least <= factor.mean() <= most
    assert np.all((belief.steady >= SMALLEST) & (belief.steady <= 0.0))


def test_nothing_is_learnt_of_a_disturbance_that_does_not_show() -> None:
    belief, params = Belief(2, 0), Filter()
    belief.v[:], belief.regime[:] = 0.5, [1.0, 0.0]  # the first slides, but its d is not told; the second rests
    for _ in range(1000):
        belief.P[4, 4] = 0.3**2 * np.exp(belief.steady[0])
        belief.P[5, 5] = 1e-9
        follow_disturbance(belief, params, np.full(2, 0.3**2), 0.005)
    np.testing.assert_allclose(belief.steady, 0.0, atol=1e-12)
    assert belief.told[1] == 0.0
