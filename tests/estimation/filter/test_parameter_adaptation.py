"""When learnt parameters are taken over, opened and given up: borders and figures, on a gantry."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.small_arms import begun
from twin_diagram.estimation.filter.belief import Entry
from twin_diagram.estimation.filter.parameter_adaptation import CHANGING, gather, open_again, open_up, refute, release
from twin_diagram.scenario import Filter

PARAMS = Filter(parameters=["torque_bias", "torque_constant"])
"""Two biases, known to 2 % of the efforts 40 and 20; two motors, to 2 %, that may fail by half."""
SCALE = np.array([0.8, 0.4, 0.02, 0.02])
AT = slice(6, 10)


@pytest.mark.parametrize(
    ("t", "share", "taken"),
    [(1.019, 0.0499, False), (1.02, 0.01, True), (1.001, 0.0501, True), (1.001, -0.0501, True), (1.001, 0.0, False)],
)
def test_the_physics_takes_over_at_its_own_rate_or_at_once_what_is_much(t: float, share: float, taken: bool) -> None:
    """Every fiftieth of a second; a twentieth of its prior's deviation is much."""
    for index in range(4):
        ekf = begun(PARAMS)
        ekf.belief.theta[index] = share * SCALE[index]
        ekf.belief.header[Entry.RELEASED] = 1.0
        release(ekf, t)
        assert ekf.belief.model[index] == (share * SCALE[index] if taken else 0.0)
        assert ekf.belief.header[Entry.RELEASED] == (t if taken else 1.0)


def test_the_gradient_rule_takes_a_step_in_units_of_the_prior() -> None:
    ekf = begun(Filter(parameters=PARAMS.parameters, rule="gradient", learning_rate=0.03))
    ekf.belief.theta[0] = 0.01
    ekf.belief.gradient[:] = [0.5, -2.0, 3.0, 1e9]
    release(ekf, 2.0)
    expected = np.array([0.01, 0.0, 0.0, 0.0]) + 0.03 * SCALE**2 * [0.5, -2.0, 3.0, 0.0]
    expected[3] = 1.0  # no motor is more than twice as strong as its data sheet says
    np.testing.assert_allclose(ekf.belief.theta, expected)
    np.testing.assert_allclose(ekf.belief.model, expected)
    assert not ekf.belief.gradient.any()
    covariance = begun(PARAMS)
    covariance.belief.gradient[:] = 1.0
    release(covariance, 2.0)
    assert not covariance.belief.theta.any() and covariance.belief.gradient.all()


def test_a_reading_s_gradient_goes_through_the_step_that_led_to_it() -> None:
    ekf, rng = begun(PARAMS), np.random.default_rng(1330)
    ekf.F[:] = rng.normal(size=(10, 10))
    H, weighted = rng.normal(size=(3, 10)), rng.normal(size=3)
    gather(ekf, H, weighted)
    gather(ekf, H, 2.0 * weighted)
    expected = [sum(weighted[m] * H[m, k] * ekf.F[k, j] for m in range(3) for k in range(4)) for j in range(6, 10)]
    np.testing.assert_allclose(ekf.belief.gradient, 3.0 * np.array(expected))


def test_what_innovations_speak_for_is_opened_once() -> None:
    """The second motor: by half of its torque, fully below its prior's variance and not at all above twice it."""
    for before, room in ((1e-4, 1.0), (0.25, 1.0), (0.375, np.sqrt(0.5)), (0.5, 0.0), (0.6, 0.0)):
        ekf = begun(PARAMS)
        belief = ekf.belief
        belief.P[9, 9] = before
        belief.score[:, :4] = 100.0 * np.eye(4)
        belief.score[3, 4] = 200.0
        belief.regime[:], belief.told[:] = [1.0, -1.0], 7.0
        kept = belief.P.copy()
        open_up(ekf, 3.0)
        expected = np.zeros((10, 10))
        expected[9, 9] = 0.25 * room**2
        np.testing.assert_allclose(belief.P - kept, expected, atol=1e-15)
        np.testing.assert_array_equal(belief.freed, [0.0, 0.0, 0.0, 1.0])
        np.testing.assert_array_equal(belief.regime, [1.5, -1.5])  # neither is a regime: the next is drawn afresh
        assert not belief.told.any() and belief.header[Entry.OPENINGS] == 1.0
        assert belief.header[Entry.QUIET] == pytest.approx(3.2)
        np.testing.assert_allclose(ekf.history._room[int(ekf.history._at[0])], [0.0, 0.0, 0.0, room])
        np.testing.assert_array_equal(ekf.history.state(0)[2], belief.P)
        open_up(ekf, 4.0)
        assert belief.P[9, 9] <= max(0.5, before) + 1e-12


def test_a_load_is_opened_once_more_when_its_change_is_over() -> None:
    """What was learnt of it meanwhile was of a load on its way; a motor fails at once."""
    ekf = begun(Filter(parameters=["payload", *PARAMS.parameters]))
    belief, load, motor = ekf.belief, slice(6, 10), 13
    for changed, freed in ((slice(0, 4), CHANGING), (slice(7, 8), 1.0)):
        belief.score[:, :8] = 100.0 * np.eye(8)
        belief.score[:, 8] = 0.0
        belief.score[changed, 8] = 200.0
        belief.freed[:] = 0.0
        open_up(ekf, 3.0)
        assert (belief.freed[changed] == freed).all() and np.count_nonzero(belief.freed) == changed.stop - changed.start
    belief.freed[:4] = CHANGING
    belief.P[load, load] = 1e-6 * np.eye(4)
    belief.P[motor, motor] = 1e-6
    belief.regime[:], belief.score[:], belief.header[Entry.NIS_MEAN] = 1.0, 5.0, 7.0
    kept = belief.P.copy()
    open_again(ekf)
    assert not belief.score.any()
    assert belief.header[Entry.NIS_MEAN] == 7.0, "what surprises for another reason goes on to"
    expected = np.zeros_like(kept)
    expected[load, load] = ekf.parameters.opening[:4, :4]
    np.testing.assert_allclose(belief.P - kept, expected, atol=1e-15)
    np.testing.assert_array_equal(belief.freed, [1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0])
    np.testing.assert_array_equal(belief.regime, 1.5)
    np.testing.assert_array_equal(ekf.history.state(0)[2], belief.P)
    assert belief.header[Entry.OPENINGS] == 2.0, "it is the same change"
    before = belief.vector.copy()
    open_again(ekf)
    np.testing.assert_array_equal(belief.vector, before)


def test_without_a_covariance_nothing_is_opened() -> None:
    for params in (Filter(parameters=PARAMS.parameters, rule="gradient"), Filter(parameters=[])):
        ekf = begun(params)
        kept = ekf.belief.P.copy()
        open_up(ekf, 3.0)
        np.testing.assert_array_equal(ekf.belief.P, kept)
        assert ekf.belief.header[Entry.OPENINGS] == 1.0 and ekf.belief.header[Entry.QUIET] == pytest.approx(3.2)


@pytest.mark.parametrize(("share", "refuted"), [(3.4, False), (3.6, True), (-3.6, True)])
def test_a_prior_is_given_up_beyond_three_and_a_half_deviations(share: float, refuted: bool) -> None:
    ekf = begun(Filter(parameters=["payload", *PARAMS.parameters]))
    belief = ekf.belief
    belief.theta[:] = [0.5, 0.01, 0.02, 0.03, 0.3, -0.2, share * 0.02, 0.01]
    belief.P[6:, 6:] += 0.01
    belief.P[:6, 6:] = belief.P[6:, :6].T
    belief.P[0, 8] = belief.P[8, 0] = 1e-6
    belief.score[:], belief.regime[:] = 1.0, 1.0
    before = belief.vector.copy()
    refute(ekf, 3.0)
    if not refuted:
        np.testing.assert_array_equal(belief.vector, before)
        return
    prior, opening = ekf.parameters.covariance, ekf.parameters.opening
    expected = prior.copy()
    expected[6, :] = expected[:, 6] = 0.0
    expected[6, 6] = opening[6, 6]
    np.testing.assert_allclose(belief.P[6:14, 6:14], expected)
    assert not belief.P[:6, 6:].any() and not belief.P[6:, :6].any()
    # The payload's mean and what was refuted are kept; all else begins anew.
    np.testing.assert_allclose(belief.theta, [0.5, 0.01, 0.02, 0.03, 0.0, 0.0, share * 0.02, 0.0])
    np.testing.assert_array_equal(belief.freed, np.eye(8)[6])
    np.testing.assert_array_equal(belief.regime, 1.5)
    assert not belief.score.any() and belief.header[Entry.OPENINGS] == 1.0
    assert belief.header[Entry.QUIET] == pytest.approx(3.2) and ekf.history.count == 1
    refute(ekf, 4.0)  # what was given up already refutes nothing any more
    assert belief.header[Entry.OPENINGS] == 1.0


def test_what_cannot_be_far_off_refutes_nothing() -> None:
    """A bias may not be opened beyond its prior; the gradient rule knows no deviation."""
    for params, index in ((PARAMS, 0), (Filter(parameters=PARAMS.parameters, rule="gradient"), 2)):
        ekf = begun(params)
        ekf.belief.theta[index] = 9.0 * SCALE[index]
        refute(ekf, 3.0)
        assert ekf.belief.header[Entry.OPENINGS] == 0.0
