"""What a filter hands over to that of a corrected model, entry by entry."""

from __future__ import annotations

import numpy as np
import pytest

from tests.estimation.small_arms import begun, constant_friction
from twin_diagram.estimation.filter.belief import Entry
from twin_diagram.estimation.filter.model_swap import hand_over
from twin_diagram.estimation.filter.sensor_registry import FilterError
from twin_diagram.estimation.sensors import LinkImu
from twin_diagram.scenario import Filter

NAMES = ["torque_bias"]


@pytest.mark.parametrize("rule", ["covariance", "gradient"])
def test_what_is_about_the_arm_stays_and_what_was_learnt_begins_anew(rule: str) -> None:
    params = Filter(parameters=NAMES, rule=rule)
    laws = constant_friction(2.0, 1.0, backward=(4.0, 3.0))
    old, new = begun(params, laws), begun(params, laws, t=0.5)
    for ekf in (old, new):
        ekf.add(LinkImu(ekf.terms, "car"))
    belief, rng = old.belief, np.random.default_rng(1331)
    belief.vector[22:] = rng.normal(size=len(belief.vector) - 22)
    belief.regime[:] = [1.0, 0.0]
    belief.header[Entry.QUIET], belief.header[Entry.ALARM] = 9.0, 0.5
    belief.header[Entry.NIS], belief.header[Entry.NIS_MEAN] = 77.0, 5.0
    kept = belief.vector.copy()
    hand_over(belief, new)
    np.testing.assert_array_equal(belief.vector, kept)
    after, n = new.belief, 2
    assert after.time == 1.0
    np.testing.assert_array_equal(after.x[:4], belief.x[:4])
    np.testing.assert_array_equal(after.own, belief.own)
    assert not after.x[4:8].any() and not after.model.any()
    for name in ("gradient", "score", "freed", "innovation"):
        assert not getattr(after, name).any(), name
    for name in ("torque", "noise", "steady", "drift", "acceleration", "regime"):
        np.testing.assert_array_equal(getattr(after, name), getattr(belief, name))
    stays = np.r_[0:4, 8:14]
    np.testing.assert_array_equal(after.P[np.ix_(stays, stays)], belief.P[np.ix_(stays, stays)])
    assert not after.P[np.ix_(np.arange(4, 8), stays)].any() and not after.P[np.ix_(stays, np.arange(4, 8))].any()
    prior = np.square([0.02 * 40.0, 0.02 * 20.0]) if rule == "covariance" else np.zeros(2)
    sliding, resting = 0.1**2 + (0.15 * 3.0) ** 2, 0.1**2 + 2.0**2
    np.testing.assert_allclose(after.P[4:8, 4:8], np.diag([sliding, resting, *prior]))
    assert after.header[Entry.NIS] == 2.0 * n and after.header[Entry.NIS_MEAN] == 1.0
    assert after.header[Entry.QUIET] == 1.0 and after.header[Entry.ALARM] == 0.5
    assert new.history.count == 1 and new.history.state(0)[0] == 1.0
    np.testing.assert_array_equal(new.history.state(0)[1], after.x)


def test_filters_of_other_parameters_or_sensors_take_nothing_over() -> None:
    old = begun(Filter(parameters=NAMES))
    for other in (begun(Filter(parameters=[])), begun(Filter(parameters=["viscous_friction", "torque_bias"]))):
        before = other.belief.vector.copy()
        with pytest.raises(FilterError, match="2 joints and 2 parameters"):
            hand_over(old.belief, other)
        np.testing.assert_array_equal(other.belief.vector, before)
    seeing = begun(Filter(parameters=NAMES))
    seeing.add(LinkImu(seeing.terms, "car"))
    with pytest.raises(FilterError):
        hand_over(old.belief, seeing)


def test_before_the_first_message_there_is_nothing_to_settle() -> None:
    from tests.estimation.small_arms import gantry
    from twin_diagram.estimation.filter.ekf import Ekf

    old, new = Ekf(gantry(), Filter(parameters=NAMES)), Ekf(gantry(), Filter(parameters=NAMES))
    old.belief.header[Entry.QUIET] = 3.0
    hand_over(old.belief, new)
    assert not new.belief.valid and new.belief.header[Entry.QUIET] == 3.0 and new.history.count == 0
