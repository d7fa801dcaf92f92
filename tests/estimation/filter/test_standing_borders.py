"""How a parameter stands: to the border."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.small_arms import gantry
from twin_diagram.estimation.dynamics.parameters import ParameterSet
from twin_diagram.estimation.filter.parameter_status import ParameterStatus, at_bound, standings
from twin_diagram.scenario import Filter

PARAMETERS = ParameterSet(gantry(), Filter(parameters=["torque_bias", "torque_constant"]))
SCALE = np.array([0.8, 0.4, 0.02, 0.02])
"""2 % of the efforts 40 and 20, which bound a bias at a fifth; a torque constant's tolerance, which lies in −1 … 1."""
NAMES = ("x", "y")


@pytest.mark.parametrize(
    ("value", "share", "status"),
    [
        (0.1, 0.499, ParameterStatus.SETTLED),
        (0.1, 0.501, ParameterStatus.NOT_EXCITED),
        (0.0, 1.0, ParameterStatus.NOT_EXCITED),
        (8.0, 0.1, ParameterStatus.AT_BOUND),
        (-8.0, 0.1, ParameterStatus.AT_BOUND),
        (7.99, 0.1, ParameterStatus.SETTLED),
    ],
)
def test_a_parameter_has_settled_below_half_of_its_prior_s_deviation(
    value: float, share: float, status: ParameterStatus
) -> None:
    theta = np.array([value, 0.0, 0.0, 0.0])
    found = standings(PARAMETERS, theta, np.diag((share * SCALE) ** 2), NAMES)[0]
    assert found.status is status and found.value == value and found.std == pytest.approx(share * 0.8)
    assert found.label == "torque_bias.x [N]"
    by_gradient = standings(PARAMETERS, theta, np.zeros((4, 4)), NAMES, "gradient")[0]
    assert by_gradient.status is (status if status is ParameterStatus.AT_BOUND else ParameterStatus.UNKNOWN)


def test_a_prior_that_begins_at_a_bound_is_no_finding() -> None:
    payload = ParameterSet(gantry(), Filter(parameters=["payload"]))
    untouched = standings(payload, payload.mean, payload.covariance, NAMES)[0]
    assert untouched.status is ParameterStatus.NOT_EXCITED
    touched = standings(payload, payload.mean, 0.01 * payload.covariance, NAMES)[0]
    assert touched.status is ParameterStatus.AT_BOUND
    moved = standings(payload, np.array([10.0, 0.0, 0.0, 0.0]), payload.covariance, NAMES)[0]
    assert moved.status is ParameterStatus.AT_BOUND
    negative = standings(payload, np.array([1.0, 0.0, 0.0, 0.0]), -payload.covariance, NAMES)[0]
    assert negative.std == 0.0


@pytest.mark.parametrize(("room", "held"), [(4.9e-4, True), (5.1e-4, False), (2e-3, False)])
def test_a_bound_gives_way_where_half_of_a_thousandth_is_left(room: float, held: bool) -> None:
    """In deviations of the prior, one way or the other."""
    bound = np.array([8.0, 4.0, 1.0, 1.0])
    for sign in (1.0, -1.0):
        np.testing.assert_array_equal(at_bound(PARAMETERS, sign * (bound - room * SCALE)), held)
        mixed = sign * np.array([bound[0] - room * SCALE[0], 0.0, 0.0, 0.0])
        np.testing.assert_array_equal(at_bound(PARAMETERS, mixed), [held, False, False, False])
