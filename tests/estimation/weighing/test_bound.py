"""The Cramér–Rao bound against brute force and against what estimates do."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.math import RigidTransform

from twin_diagram.estimation.weighing import Excitation, Shape, WeighingError, crlb
from twin_diagram.estimation.weighing.bound import Bound, friction_columns, information, wanted
from twin_diagram.estimation.weighing.held import Held
from twin_diagram.model import Model
from twin_diagram.model.rigid_body.mass_properties import about_centre


def derived(parameters: np.ndarray) -> np.ndarray:
    mass, centre, inertia = about_centre(parameters)
    return np.array([mass, *centre, *np.linalg.eigvalsh(inertia)])


def test_what_is_wanted_is_the_derivative(off_centre: np.ndarray) -> None:
    scale = np.concatenate([[1 / off_centre[0]], np.ones(3), 1 / derived(off_centre)[4:]])
    for k in range(10):
        step = 1e-7 * np.eye(10)[k]
        numeric = (derived(off_centre + step) - derived(off_centre - step)) / 2e-7
        np.testing.assert_allclose(wanted(off_centre)[:, k], numeric * scale, rtol=2e-4, atol=1e-3)


def test_the_bound_is_that_of_all_unknowns_at_once(
    iiwa: Model, X_TO: RigidTransform, plain: Excitation, off_centre: np.ndarray
) -> None:
    q, v, a = plain.sampled(50.0)[1]
    Y = Held.in_tool(iiwa, X_TO).regressor(iiwa, q, v, a)
    gain = 0.01
    tau = iiwa.tree.inverse_dynamics(q, v, a) + Y @ off_centre
    columns, rows = 10 + 4 * 7, []
    for j in range(7):
        block = np.zeros((len(q), columns))
        block[:, :10] = Y[:, j]
        block[:, 10 + 4 * j : 13 + 4 * j] = friction_columns(v[:, j])
        block[:, 13 + 4 * j] = tau[:, j] * gain
        rows.append(block / 0.05)
    known = np.zeros(columns)
    known[13::4] = 1.0
    A = np.vstack(rows)
    whole = A.T @ A + np.diag(known)
    scale = 1 / np.sqrt(np.diag(whole))
    covariance = scale[:, None] * np.linalg.inv(whole * np.outer(scale, scale)) * scale
    found = crlb(iiwa, X_TO, off_centre, (q, v, a), 0.05, gain)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), np.sqrt(np.diag(covariance)[:10]), rtol=1e-5)
    without = crlb(iiwa, X_TO, off_centre, (q, v, a), 0.05)
    assert np.all(found.moments > without.moments)
    assert found.mass > without.mass


def test_noise_and_length_scale_it(
    iiwa: Model, X_TO: RigidTransform, plain: Excitation, off_centre: np.ndarray
) -> None:
    motion = plain.sampled(50.0)[1]
    one = crlb(iiwa, X_TO, off_centre, motion, 0.05)
    loud = crlb(iiwa, X_TO, off_centre, motion, 0.2)
    twice = crlb(iiwa, X_TO, off_centre, tuple(np.vstack([x, x]) for x in motion), 0.05)
    for name in ("mass", "centre", "moments"):
        np.testing.assert_allclose(getattr(loud, name), 4.0 * getattr(one, name), rtol=1e-6)
        np.testing.assert_allclose(getattr(twice, name), getattr(one, name) / np.sqrt(2.0), rtol=1e-6)


def test_information_does_not_count_what_frictions_explain() -> None:
    random = np.random.default_rng(0)
    v = random.normal(size=(100, 1))
    Y = random.normal(size=(100, 1, 10))
    Y[:, 0, 3] = 2.0 + 3.0 * v[:, 0] - np.tanh(v[:, 0] / 0.02)
    matrix = information(Y, v, np.array([0.1]))
    np.testing.assert_allclose(matrix[3], 0.0, atol=1e-8)
    assert matrix[0, 0] == pytest.approx(100 / 0.01, rel=0.4)


def test_told_errors_are_those_of_the_covariance(off_centre: np.ndarray) -> None:
    bound = Bound.of(np.diag([1e-4, *9 * [0.0]]), off_centre)
    mass, centre, _ = about_centre(off_centre)
    assert bound.mass == pytest.approx(0.01 / mass)
    np.testing.assert_allclose(bound.centre, 0.01 * np.abs(centre) / mass, rtol=1e-9)


def test_bad_input_is_refused(iiwa: Model, X_TO: RigidTransform, plain: Excitation, box: Shape) -> None:
    q, v, a = plain.sampled(20.0)[1]
    body = box.even(0.5)
    with pytest.raises(WeighingError, match="7 joints"):
        crlb(iiwa, X_TO, body, (q[:, :6], v, a))
    with pytest.raises(WeighingError, match="finite"):
        crlb(iiwa, X_TO, body, (q, v, np.full_like(a, np.nan)))
    with pytest.raises(WeighingError, match="not those of a body"):
        crlb(iiwa, X_TO, -body, (q, v, a))
    with pytest.raises(WeighingError, match="does not tell all ten"):
        crlb(iiwa, X_TO, body, (q[:1].repeat(50, 0), 0 * v[:50], 0 * a[:50]))
    with pytest.raises(WeighingError, match="X_TO is not finite"):
        crlb(iiwa, RigidTransform([np.nan, 0.0, 0.0]), body, (q, v, a))
