"""How errors of torque and of rollouts are thinned, weighed and told, and which of two estimates is believed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from tests.gap.made import ARM, BAND, RATE, record, swing
from twin_diagram.gap.correction.add_effects import chosen, may_be_surer
from twin_diagram.gap.correction.equation_error import Hypothesis, _scanned, coarser, left_by
from twin_diagram.gap.correction.gauss_newton import Solution
from twin_diagram.gap.correction.output_error import _Shots, _whiteners
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.logs import Log
from twin_diagram.logs.differentiation import motion
from twin_diagram.scenario import EffectSpec

Array = npt.NDArray[np.float64]


def hypothesis(*specs: EffectSpec) -> Hypothesis:
    return Hypothesis.of(ARM, list(specs))


LEVEL = EffectSpec("coulomb_friction", [ARM.joints[0]], [], {"torque": [2.0]})
MASS = EffectSpec("payload", [], [ARM.last_link], {"mass": [1.0], "com": [0.0, 0.0, 0.1]})


def estimates(apart: float, torque: float, moved: float) -> tuple[Array, Array, list[str]]:
    """Of a level by torques and by motion, so far apart and so sure each; of a payload alike."""
    a = Solution(
        np.array([2.0, 1.0, 0.0, 0.0, 0.1]),
        np.diag([torque**2, *[1.0] * 4]) + 0.01 * torque * (np.ones((5, 5)) - np.eye(5)),
        0.0,
    )
    b = Solution(a.vector + [apart, 0.0, 0.0, 0.0, 0.0], np.diag([moved**2, *[1.0] * 4]), 0.0)
    return chosen(hypothesis(LEVEL, MASS), (a, b))


@pytest.mark.parametrize(("moved", "motions"), [(0.032, True), (0.034, False)])
def test_of_two_estimates_the_surer_is_taken(moved: float, motions: bool) -> None:
    """Errors of simulated motion count three times."""
    vector, covariance, notes = estimates(0.01, 0.1, moved)
    assert vector[0] == pytest.approx(2.01 if motions else 2.0) and not notes
    assert np.sqrt(covariance[0, 0]) == pytest.approx(3.0 * moved if motions else 0.1)
    assert (covariance[0, 1] == 0.0) == (covariance[1, 0] == 0.0) == motions
    assert covariance[1, 1] == 1.0 and covariance[1, 2] != 0.0


@pytest.mark.parametrize(("errors", "alike"), [(2.45, True), (2.55, False)])
def test_estimates_that_disagree_do_not_speak_of_the_same(errors: float, alike: bool) -> None:
    """Beyond two and a half of their common standard errors, torques decide."""
    apart = errors * np.sqrt(0.1**2 + (3.0 * 0.01) ** 2)
    vector, _, notes = estimates(apart, 0.1, 0.01)
    assert (vector[0] > 2.0) == alike and bool(notes) != alike


@pytest.mark.parametrize(("moved", "may"), [(0.06, True), (0.07, False)])
def test_simulated_motion_is_not_gone_on_with_where_it_cannot_be_the_surer(moved: float, may: bool) -> None:
    """On the way its errors shrink to a half at most, and count three times. One effect's are enough."""
    there = hypothesis(LEVEL, MASS)
    torques = Solution(there.start(), np.diag([0.1**2, *[1.0] * 4]), 0.0)
    assert may_be_surer(there, torques, np.diag([moved**2, *[1.0] * 4])) == may
    assert may_be_surer(there, torques, np.diag([1.0, *[0.6**2] * 4]))


def test_a_hypothesis_stacks_its_parts() -> None:
    both = hypothesis(LEVEL, MASS)
    assert both.slices() == [slice(0, 1), slice(1, 5)]
    np.testing.assert_allclose(both.start(), [2.0, 1.0, 0.0, 0.0, 0.1])
    np.testing.assert_allclose(both.steps(), 1e-3 * np.array([2.0, 1.0, 1e-2, 1e-2, 0.1]))
    mean, spread = both.prior()
    np.testing.assert_allclose(mean, both.start())
    assert spread[0] == 20.0 and len(spread) == 5
    moved = both.at(np.array([3.0, 2.0, 0.0, 0.0, 0.2]))
    np.testing.assert_allclose(moved.start(), [3.0, 2.0, 0.0, 0.0, 0.2])
    assert {e.name for e in both.model(both.start()).effects} == {"coulomb_friction", "payload"}


@pytest.mark.parametrize(
    ("rate", "stride", "every"), [(1000.0, 20, 4), (500.0, 10, 2), (480.0, 8, 2), (1000.0, 7, 1), (200.0, 4, 1)]
)
def test_laws_are_worked_out_at_240_samples_a_second_at_least(rate: float, stride: int, every: int) -> None:
    time, q, v, a = swing(3.0)
    one = replace(record(ARM, time, q, v, a), rate=rate, kept=np.arange(61, 540, stride))
    (found,) = coarser(Records(ARM, (one,))).records
    assert found.rate == pytest.approx(rate / every)
    np.testing.assert_array_equal(found.time[found.kept], one.time[one.kept])
    np.testing.assert_array_equal(found.q[found.kept], one.q[one.kept])
    np.testing.assert_array_equal(found.given[found.kept], one.given[one.kept])
    assert (found is one) == (every == 1)


def test_thinned_torques_keep_what_is_in_the_band() -> None:
    rng = np.random.default_rng(0)
    time = np.arange(4000) / 1000.0
    slow = np.sin(2.0 * np.pi * 6.0 * time)[:, None] * np.ones(6)
    _, q, v, a = swing(20.0)
    one = replace(
        record(ARM, np.arange(4000) / RATE, q, v, a),
        rate=1000.0,
        time=time,
        torque=slow + 0.0 * rng.normal(size=slow.shape),
        kept=np.arange(300, 3700, 20),
    )
    fast = replace(one, torque=slow + np.sin(2.0 * np.pi * 240.0 * time)[:, None])
    (found,) = coarser(Records(ARM, (fast,))).records
    np.testing.assert_allclose(found.torque[found.kept], slow[one.kept], atol=5e-3)
    assert one.band == BAND


def test_what_a_model_leaves_is_low_passed_alike() -> None:
    time, q, v, a = swing(3.0)
    one = record(ARM, time, q, v, a, extra=1.5)
    np.testing.assert_allclose(left_by(ARM, Records(ARM, (one,))), 1.5, atol=1e-6)


@pytest.mark.parametrize(("truth", "found"), [(0.1, 0.1), (0.06, 0.06), (0.17, 0.17), (0.1131, 0.113), (0.3, 0.17)])
def test_a_rough_value_on_which_torques_depend_steeply_is_scanned(truth: float, found: float) -> None:
    dip = EffectSpec(
        "stribeck_friction", [ARM.joints[0]], [], {"coulomb": [2.0], "static": [3.0], "stribeck_velocity": [0.1]}
    )
    both = hypothesis(LEVEL, dip)
    start = _scanned(both, both.start(), lambda vector: np.array([vector[3] - np.log(truth)]))
    np.testing.assert_allclose(start, [2.0, 2.0, 3.0, np.log(found)])
    play = hypothesis(EffectSpec("backlash", [ARM.joints[0]], [], {"gap": [0.02], "rotor_inertia": [0.1]}))
    linear = _scanned(play, play.start(), lambda vector: np.array([vector[0] - 0.2 * truth]))
    np.testing.assert_allclose(linear, [0.2 * found, 0.1])


def test_rollouts_errors_are_whitened_along_their_course() -> None:
    """With a twentieth of their mean variance added to all."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(2, 4, 4))
    errors = np.einsum("jab,wbj->waj", root, rng.normal(size=(30_000, 4, 2)))
    W = _whiteners(errors)
    for j in range(2):
        covariance = root[j] @ root[j].T
        ridged = covariance + 0.05 * np.trace(covariance) / 4.0 * np.eye(4)
        np.testing.assert_allclose(W[j] @ ridged @ W[j].T, np.eye(4), atol=0.05)
        np.testing.assert_allclose(W[j], W[j].T, atol=1e-12)


def smooth_of(seconds: float) -> Any:
    time, q, v, a = swing(seconds)
    return motion(Log(time, ARM.joints, q, torque=ARM.inverse_dynamics(q, v, a)))


def test_windows_are_a_quarter_of_a_second_and_at_most_160() -> None:
    shots = _Shots.of(smooth_of(6.0), 1)
    assert shots.steps == 50 and set(np.diff(shots.starts)) == {50} and shots.every in (2, 3)
    assert shots.starts[0] in (60, 61) and 6.0 * RATE - 60 - 51 - 50 <= shots.starts[-1] < 6.0 * RATE - 60 - 50
    many = _Shots.of(smooth_of(6.0), 100)
    assert len(many.starts) == min(20, len(shots.starts)) == 20
    assert many.starts[0] == shots.starts[0] and many.starts[-1] == shots.starts[-1]


def test_a_true_models_rollouts_leave_nothing_and_a_heavier_ones_a_curve() -> None:
    """Beside start and speed, which are free in each window."""
    smooth = smooth_of(2.0)
    shots = _Shots.of(smooth, 1)
    assert np.max(np.abs(shots.errors(ARM))) < 2e-5
    errors = shots.errors(hypothesis(LEVEL).model(np.array([2.0])))
    assert errors.shape == (len(shots.starts), 25, 6) and np.max(np.abs(errors[:, :, 0])) > 2e-4
    times = np.arange(1, 26) * 2.0 / RATE
    for k in range(len(errors)):
        np.testing.assert_allclose(np.stack([np.ones(25), times]) @ errors[k], 0.0, atol=1e-9)
