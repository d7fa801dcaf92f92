"""What becomes of a message, a fresh start, and what is kept: to the border, on a gantry."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.small_arms import begun, constant_friction, gantry
from twin_diagram.estimation.filter.arm_messages import Course, count, course_of, heard, keep_record, within_own_gate
from twin_diagram.estimation.filter.belief import Entry
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.estimation.filter.noise_adaptation import Update
from twin_diagram.scenario import Filter

PARAMS = Filter(parameters=["torque_bias"])
Q, V, TAU = np.array([0.1, -0.2]), np.array([0.5, -0.4]), np.array([1.0, 2.0])


def test_a_fresh_state_is_three_times_as_uncertain_as_its_sensors() -> None:
    """Adapted deviations; its disturbance is that of joints at rest: friction of 3 and 2 N·m beside 0.1."""
    ekf = begun(PARAMS, constant_friction(2.0, 1.0, backward=(4.0, 3.0)))
    belief = ekf.belief
    belief.noise[0], belief.noise[1] = np.log([4.0, 1.0]), np.log([1.0, 9.0])
    belief.P[6:, 6:] = [[0.5, 0.1], [0.1, 0.4]]
    belief.theta[:], belief.header[[Entry.QUIET, Entry.STREAK, Entry.NIS_MEAN]] = [0.3, -0.2], [9.0, 5.0, 4.0]
    ekf.by_torque = np.ones((4, 2))
    ekf.start(Q, V, TAU, 2.0)
    std = [3.0 * 2e-5 * 2.0, 3.0 * 2e-5, 3.0 * 2e-3, 3.0 * 2e-3 * 3.0, np.hypot(0.1, 3.0), np.hypot(0.1, 2.0)]
    np.testing.assert_allclose(belief.P[:6, :6], np.diag(np.square(std)))
    np.testing.assert_array_equal(belief.P[6:, 6:], [[0.5, 0.1], [0.1, 0.4]])
    assert not belief.P[:6, 6:].any() and ekf.by_torque is None
    np.testing.assert_array_equal(belief.x, [*Q, *V, 0.0, 0.0, 0.3, -0.2])
    np.testing.assert_array_equal(belief.model, [0.3, -0.2])
    for name, value in (("torque", TAU), ("drift", V), ("before", V), ("regime", 0.0), ("acceleration", 0.0)):
        np.testing.assert_array_equal(getattr(belief, name), value if np.ndim(value) else np.zeros(2))
    h = belief.header
    assert h[Entry.TIME] == h[Entry.QUIET] == h[Entry.HEARD] == h[Entry.RELEASED] == 2.0
    assert h[Entry.NIS] == 4.0 and h[Entry.NIS_MEAN] == 1.0 and h[Entry.FRESH] == 1.0
    assert h[Entry.STREAK] == 0.0 and h[Entry.SPAN] == 0.0
    assert ekf.history.count == 1 and ekf.history.state(0)[0] == 2.0


@pytest.mark.parametrize("rule", ["covariance", "gradient"])
def test_the_first_state_has_the_prior_s_parameters(rule: str) -> None:
    ekf = begun(Filter(parameters=["torque_bias"], rule=rule))
    expected = np.diag(np.square([0.8, 0.4])) * (rule == "covariance")
    np.testing.assert_allclose(ekf.belief.P[6:, 6:], expected)


def moved(**entries: float) -> Ekf:
    """A filter whose history reaches from 1.0 to 1.1 s in steps of 5 ms."""
    ekf = begun(PARAMS)
    for _ in range(20):
        ekf.predict(np.zeros(2), 0.005)
    for name, value in {"MESSAGE": 1.1, **entries}.items():
        ekf.belief.header[Entry[name]] = value
    return ekf


@pytest.mark.parametrize(
    ("t", "streak", "course"),
    [
        (1.105, 0.0, Course.NEXT),
        (1.35 - 1e-6, 0.0, Course.NEXT),
        (1.351, 0.0, Course.RESTART),
        (1.105, 9.0, Course.NEXT),
        (1.105, 10.0, Course.RESTART),
        (1.1, 0.0, Course.STALE),
        (1.05, 0.0, Course.STALE),
        (1.0525, 0.0, Course.LATE),
        (1.0525, 8.0, Course.LATE),
        (1.0525, 9.0, Course.RESTART),
        (0.99, 0.0, Course.TOO_OLD),
        (0.99, 8.0, Course.TOO_OLD),
        (0.99, 9.0, Course.RESTART),
        (0.0, 0.0, Course.TOO_OLD),
        (-1e-3, 0.0, Course.NONE),
        (np.nan, 0.0, Course.INVALID),
        (np.inf, 0.0, Course.INVALID),
    ],
)
def test_what_becomes_of_a_message(t: float, streak: float, course: Course) -> None:
    assert course_of(moved(STREAK=streak), Q, V, t, True) is course


@pytest.mark.parametrize(("t", "course"), [(1.1, Course.LATE), (1.05, Course.STALE), (1.055, Course.LATE)])
def test_a_message_is_seen_again_only_where_it_is_no_newer_than_the_arm_s_own(t: float, course: Course) -> None:
    """The steps after 1.05 s were made for another sensor."""
    assert course_of(moved(MESSAGE=1.05), Q, V, t, True) is course


@pytest.mark.parametrize(
    ("value", "usable"), [(9999.0, True), (-9999.0, True), (1e4, False), (-1e4, False), (np.nan, False)]
)
def test_no_angle_or_speed_is_absurd(value: float, usable: bool) -> None:
    ekf, odd = moved(), np.array([0.0, value])
    for q, v in ((odd, V), (Q, odd)):
        assert (course_of(ekf, q, v, 1.105, True) is Course.NEXT) == usable
        assert (course_of(Ekf(gantry(), PARAMS), q, v, 0.0, True) is Course.FIRST) == usable
    assert heard(np.array([0.99e4 * 40.0, 0.0]), np.array([40.0, 20.0]))
    assert not heard(np.array([0.0, -1.01e4 * 20.0]), np.array([40.0, 20.0]))
    assert course_of(ekf, Q, V, 1.105, False) is Course.NEXT
    assert course_of(Ekf(gantry(), PARAMS), Q, V, 1.0, False) is Course.INVALID


def test_what_is_counted_of_each() -> None:
    counted = {
        (Course.INVALID, True): [Entry.INVALID],
        (Course.INVALID, False): [Entry.INVALID],
        (Course.NEXT, False): [Entry.INVALID],
        (Course.NEXT, True): [],
        (Course.FIRST, False): [],
        (Course.RESTART, False): [Entry.INVALID, Entry.RESTARTS],
        (Course.RESTART, True): [Entry.RESTARTS],
        (Course.STALE, True): [Entry.STALE],
        (Course.TOO_OLD, True): [Entry.STALE, Entry.STREAK],
        (Course.LATE, True): [Entry.STREAK],
        (Course.NONE, True): [],
    }
    for (course, known), entries in counted.items():
        belief = begun(PARAMS).belief
        before = belief.header.copy()
        count(belief, course, known)
        changed = np.zeros(len(before))
        changed[entries] = 1.0
        np.testing.assert_array_equal(belief.header - before, changed)


def refused(y: list[float]) -> Update:
    """Of a message: unit variances, but the first position's are tied to its speed's."""
    S = np.eye(4)
    S[0, 2] = S[2, 0] = 0.9
    return Update(False, False, 99.0, np.array(y), S)


def test_half_a_message_may_do_where_the_other_half_contradicts_it() -> None:
    ekf = begun(PARAMS)
    gate = np.sqrt(ekf.encoder.gate)
    for y, which in (
        ([9.0, 0.0, 0.5, 0.0], ekf.velocity),
        ([0.0, 0.5, 0.0, 9.0], ekf.encoder),
        ([0.99 * gate, 0.0, 0.0, 1.01 * gate], ekf.encoder),
        ([0.0, 1.01 * gate, 0.99 * gate, 0.0], ekf.velocity),
        ([9.0, 0.0, 9.0, 0.0], None),
        ([3.0, 0.0, -3.0, 0.0], None),  # either alone would do: they contradict each other
    ):
        found = within_own_gate(ekf, refused(y), Q, V)
        assert (found is None) if which is None else (found is not None and found[0] is which)
        if found is not None:
            assert found[1] is (Q if which is ekf.encoder else V)


def test_the_record_of_a_message() -> None:
    """NIS over its degrees of freedom, averaged over a tenth of a second; torque by momentum, whitened; the score."""
    ekf, rng = begun(PARAMS), np.random.default_rng(1332)
    ekf.step_mass = np.array([[5.0, 0.3], [0.3, 2.0]])
    ekf.F[:] = rng.normal(size=(8, 8))
    A = rng.normal(size=(4, 4))
    S, y = A @ A.T + np.eye(4), rng.normal(size=4)
    h = ekf.belief.header
    h[[Entry.STREAK, Entry.NIS_MEAN]] = 2.0, 3.0
    keep_record(ekf, Update(True, True, 20.0, y, S), 0.005, True)
    factor = np.linalg.cholesky(ekf.step_mass @ S[2:, 2:] @ ekf.step_mass.T)
    white = np.linalg.solve(factor, ekf.step_mass @ y[2:])
    W = np.linalg.solve(factor, ekf.step_mass @ ekf.F[2:4, 6:8])
    np.testing.assert_allclose(ekf.belief.innovation, white)
    np.testing.assert_allclose(ekf.belief.score, np.column_stack([W.T @ W, W.T @ white]))
    assert h[Entry.NIS] == 20.0 and h[Entry.NIS_MEAN] == pytest.approx(3.0 + 0.05 * (5.0 - 3.0))
    assert (h[Entry.ACCEPTED], h[Entry.REFUSED], h[Entry.STREAK], h[Entry.SURPRISES]) == (1.0, 0.0, 0.0, 1.0)
    kept, score = float(h[Entry.NIS_MEAN]), ekf.belief.score.copy()
    keep_record(ekf, Update(False, False, 30.0, y, S), 0.005, False)
    assert h[Entry.NIS_MEAN] == kept and h[Entry.NIS] == 30.0
    assert (h[Entry.ACCEPTED], h[Entry.REFUSED], h[Entry.STREAK], h[Entry.SURPRISES]) == (1.0, 1.0, 1.0, 1.0)
    np.testing.assert_array_equal(ekf.belief.score, score)
    keep_record(ekf, Update(True, False, 1e6, y, S), 0.5, True)
    assert h[Entry.NIS_MEAN] == pytest.approx(50.0)
