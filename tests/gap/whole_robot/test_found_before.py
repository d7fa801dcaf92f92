"""What a corrected model may leave of a later log of another motion, and that what has changed leaves more."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.gap.made import ARM, ELBOW, HOME, LIFT, effect, record, swing
from tests.gap.whole_robot.test_explain import LEVEL, lacking
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot import found_before, taking_over
from twin_diagram.gap.whole_robot.concluding import every_beside
from twin_diagram.gap.whole_robot.estimates import covariance
from twin_diagram.model.description.corrected_folder import CorrectedStanding
from twin_diagram.model.effects import Effect
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array

N = len(ARM.joints)


@cache
def standing(rows: int | None = None) -> CorrectedStanding:
    """What is known of the corrected arm; of its first rows alone."""
    _, found = lacking()
    left = np.maximum(found.fitted, found.left)
    return CorrectedStanding(
        remainder=dict(zip(ARM.joints, map(float, left), strict=True)), links=found_before.factor_of(found)[:rows]
    )


def later(true: Model, reach: float = 1.0) -> Records:
    """A log of a true arm on a motion that no fit has seen, for the corrected one."""
    _, found = lacking()
    time, q, v, a = swing(8.0, seed=77)
    q, v, a = HOME + reach * (q - HOME), reach * v, reach * a
    noise = 0.1 * np.random.default_rng(7).normal(size=q.shape)
    torque = true.inverse_dynamics(q, v, a, time=time) + noise
    made = record(found.model, time, q, v, a)
    return Records(found.model, (replace(made, torque=torque),))


def beyond(true: Model, reach: float = 1.0, rows: int | None = None) -> tuple[Array, Array]:
    known = standing(rows)
    recorded = np.array([known.remainder[joint] for joint in ARM.joints])
    _, found = lacking()
    return found_before.beyond_expected(later(true, reach), recorded, found_before.told_of(known, found.model))


def test_a_folder_holds_how_well_links_and_joints_were_found() -> None:
    _, found = lacking()
    told = found_before.told_of(standing(), found.model)
    assert told is not None
    spread = covariance(every_beside(found.problem), found.coordinates)
    heavy = np.concatenate([np.repeat(found.problem.links.heavy, 10), np.ones(4 * N, dtype=bool)])
    std, true = (np.sqrt(np.diag(x))[: 14 * N][heavy] for x in (told, spread))
    np.testing.assert_allclose(std, true, rtol=0.02, atol=1e-3)


def test_an_earlier_folder_tells_of_links_alone() -> None:
    _, found = lacking()
    told, whole = (found_before.told_of(standing(rows), found.model) for rows in (10 * N, None))
    assert told is not None and whole is not None
    np.testing.assert_allclose(told[: 10 * N, : 10 * N], whole[: 10 * N, : 10 * N])
    assert not np.any(told[10 * N :])
    assert found_before.told_of(standing(3), found.model) is None
    assert found_before.told_of(CorrectedStanding(), found.model) is None


def test_an_unchanged_arm_leaves_what_is_expected_of_any_motion() -> None:
    true, _ = lacking()
    for reach in (0.5, 1.0, 2.0):
        ratio, expected = beyond(true, reach)
        assert np.all(ratio < 1.25) and np.all(expected >= 1.0)


def test_what_was_hardly_told_may_leave_more_of_motion_that_asks_for_it() -> None:
    true, _ = lacking()
    small, large = (beyond(true, reach)[1] for reach in (0.5, 3.0))
    assert np.all(large >= small) and np.any(large > 1.15 * small)


@pytest.mark.parametrize(
    ("change", "joints"),
    [
        (effect("coulomb_friction", [ARM.joints[ELBOW]], torque=0.3 * LEVEL), [ELBOW]),
        (effect("payload", links=["tool0"], mass=0.5, com=[0.0, 0.0, 0.05]), [LIFT, ELBOW]),
    ],
)
def test_what_has_changed_leaves_more(change: Effect, joints: list[int]) -> None:
    true, _ = lacking()
    ratio, expected = beyond(true.with_effects([*true.effects, change]))
    assert np.all(ratio[joints] > 1.5 * taking_over.TUNING.known)
    assert not taking_over.no_news(ARM, [], None, ratio, expected)
