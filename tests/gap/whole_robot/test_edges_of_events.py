"""What is told beside a push: its moments are found between samples, and what its ramps leave hides nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.gap.made import ARM, effect, everywhere
from tests.gap.whole_robot.test_explain import noisy
from twin_diagram.gap.findings import Estimate
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot.concluding import WholeRobot
from twin_diagram.gap.whole_robot.explain import begun, beside_its_events, explain, settled
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem
from twin_diagram.gap.whole_robot.pushes import TUNING, pushes
from twin_diagram.gap.whole_robot.torque_equations import equations
from twin_diagram.gap.whole_robot.unusual import terms_of
from twin_diagram.signals.arrays import Array

DAMPING = 2.0
PUSH = effect("external_force", links=["forearm_link"], wrench=[60.0, -30.0, 45.0, 0.0, 0.0, 0.0])


def pushed(begin: float, end: float, ramp: float) -> Records:
    """Of an arm with damping on all joints, pushed for a while by a force that rises and falls over a time."""
    true = ARM.with_effects([everywhere("viscous_friction", damping=DAMPING)])
    calm, hit = (noisy(ARM, one, 10.0) for one in (true, true.with_effects([*true.effects, PUSH])))
    (record,), (other,) = calm.records, hit.records
    share = np.interp(record.time, [begin, begin + ramp, end, end + ramp], [0.0, 1.0, 1.0, 0.0])[:, None]
    return replace(calm, records=(replace(record, torque=record.torque + share * (other.torque - record.torque)),))


def test_moments_are_found_between_the_samples_that_are_kept() -> None:
    """Among these alone they were 12 and 18 ms off."""
    records = pushed(4.013, 6.007, 1e-9)
    whole, start = settled(begun(records, equations(records)))
    (push,) = pushes(whole, start, terms_of(whole.sums, ARM))
    assert push.onset is not None and push.end is not None
    assert push.onset[1] == pytest.approx(4.013, abs=0.008)
    assert push.end[1] == pytest.approx(6.007, abs=0.008)


def damping(found: WholeRobot | None) -> dict[str, tuple[float, float]]:
    """Damping that is told, and its standard error."""
    assert found is not None
    (told,) = [one.parameters["damping"] for one in found.findings if one.name == "viscous_friction"]
    assert isinstance(told, dict) and all(isinstance(one, Estimate) for one in told.values())
    return {joint: (float(one.value), float(one.std)) for joint, one in told.items()}  # type: ignore[arg-type]


def test_what_a_pushs_ramps_leave_hides_no_friction(monkeypatch: pytest.MonkeyPatch) -> None:
    """They were counted as noise of the joints that it drives, whose errors were as large."""
    before: list[WholeRobot] = []

    def watched(found: WholeRobot, whole: RobotProblem) -> WholeRobot:
        before.append(found)
        return beside_its_events(found, whole)

    monkeypatch.setattr("twin_diagram.gap.whole_robot.explain.beside_its_events", watched)
    found = explain(pushed(4.0, 6.0, 0.15))
    assert found is not None and "external_force" in {one.name for one in found.findings}
    told, plain = damping(found), damping(before[0])
    assert sorted(told) == sorted(ARM.joints)
    values: Array = np.array([value for value, _ in told.values()])
    np.testing.assert_allclose(values, DAMPING, rtol=0.05)
    assert any(joint not in plain or plain[joint][1] > 3.0 * told[joint][1] for joint in told)


@pytest.mark.long
def test_what_brings_no_joint_a_tenth_of_its_friction_is_no_push(monkeypatch: pytest.MonkeyPatch) -> None:
    """Friction changes by as much as joints warm: 9 mN·m beside 160 for two seconds had a name."""
    true = ARM.with_effects([everywhere("viscous_friction", damping=2.0), everywhere("coulomb_friction", torque=40.0)])
    calm = noisy(ARM, true, 10.0)
    slight = effect("external_force", links=["forearm_link"], wrench=[4.0, 0.0, 3.0, 0.0, 0.0, 0.0])
    (record,), (other,) = calm.records, noisy(ARM, true.with_effects([*true.effects, slight]), 10.0).records
    during = ((record.time > 4.0) & (record.time < 6.0))[:, None]
    records = replace(calm, records=(replace(record, torque=np.where(during, other.torque, record.torque)),))
    whole, start = settled(begun(records, equations(records)))
    assert not pushes(whole, start, terms_of(whole.sums, ARM))
    monkeypatch.setattr("twin_diagram.gap.whole_robot.pushes.TUNING", replace(TUNING, drifts=0.0))
    assert pushes(whole, start, terms_of(whole.sums, ARM))


def test_what_begins_with_a_log_is_no_push() -> None:
    """An arm sets off there, and its friction builds up: half a newton was told of logs in which nobody pushes."""
    for begin, found in ((0.2, 0), (2.0, 1)):
        records = pushed(begin, begin + 1.2, 1e-9)
        whole, start = settled(begun(records, equations(records)))
        assert len(pushes(whole, start, terms_of(whole.sums, ARM))) == found
