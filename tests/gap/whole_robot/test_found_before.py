"""What a corrected model may leave of a later log of another motion, and that what has changed leaves more."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.gap.made import ARM, ELBOW, HOME, LIFT, effect, record, swing
from tests.gap.whole_robot.test_explain import LEVEL, lacking
from twin_diagram.gap.findings import Estimate
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot import found_before, taking_over
from twin_diagram.gap.whole_robot.concluding import concluded, every_beside
from twin_diagram.gap.whole_robot.estimates import covariance
from twin_diagram.gap.whole_robot.explain import begun, beside_what_was_found, explain, settled
from twin_diagram.gap.whole_robot.torque_equations import OWN, equations
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


def prior(rows: int | None = None) -> Array:
    """What was found of the arm before, as it draws later fits."""
    _, found = lacking()
    told = found_before.prior_of(found_before.told_of(standing(rows), found.model))
    assert told is not None
    return told


def test_a_folder_of_links_alone_draws_links_alone() -> None:
    assert len(prior()) == 14 * N and len(prior(10 * N)) == 10 * N


def with_load() -> Records:
    """A later log of the arm with 2 kg in its hand."""
    true, _ = lacking()
    load = effect("payload", links=["tool0"], mass=2.0, com=[0.0, 0.0, 0.05])
    return later(true.with_effects([*true.effects, load]))


def test_offsets_and_rotors_are_drawn_to_what_was_found_and_friction_is_not() -> None:
    records = with_load()
    whole = replace(begun(records, equations(records)), known=True, spread=0.005)
    wide, near = (replace(whole, told=told).own_deviation for told in (prior(10 * N), prior()))
    for term in ("bias", "rotor"):
        assert np.all(near[:, OWN.index(term)] < 0.5 * wide[:, OWN.index(term)])
    for term in ("viscous", "coulomb"):
        np.testing.assert_allclose(near[:, OWN.index(term)], wide[:, OWN.index(term)])


@pytest.mark.long
def test_a_heavier_last_link_with_offsets_is_a_payload_where_that_says_less() -> None:
    records = with_load()
    whole = replace(begun(records, equations(records)), known=True, told=prior(10 * N), spread=0.005, spreads=(0.005,))
    whole, _ = settled(whole)
    own = np.zeros_like(whole.own_free)
    own[:, OWN.index("bias")] = True
    found = concluded(replace(whole, links_free=np.arange(N) == N - 1, own_free=own))
    assert found is not None and "payload" not in [one.name for one in found.findings]
    loads = {one.name: one for one in beside_what_was_found(found, whole, prior()).findings}
    mass = loads["payload"].parameters["mass"]
    assert "inertial_parameters" not in loads and len(loads) <= len(found.findings)
    assert isinstance(mass, Estimate) and mass.value == pytest.approx(2.0, abs=3.0 * float(np.max(mass.std)))


def test_an_offset_that_has_changed_is_no_payload() -> None:
    true, _ = lacking()
    records = later(true.with_effects([*true.effects, effect("torque_bias", [ARM.joints[ELBOW]], torque=4.0)]))
    found = explain(records, known=True, told=prior())
    assert found is not None and [(one.name, one.joints) for one in found.findings] == [
        ("torque_bias", (ARM.joints[ELBOW],))
    ]
    torque = found.findings[0].parameters["torque"]
    assert isinstance(torque, dict) and torque[ARM.joints[ELBOW]].value == pytest.approx(4.0, abs=0.2)
