"""Loads that are held for a part of a log: found with mass, centre and spans, and told from pushes and from nothing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.gap.made import ARM, effect, everywhere
from tests.gap.whole_robot.test_explain import noisy
from twin_diagram.gap.candidates.candidate import Span
from twin_diagram.gap.findings import Estimate
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot.concluding import WholeRobot
from twin_diagram.gap.whole_robot.explain import begun, explain, settled
from twin_diagram.gap.whole_robot.few_or_whole import told_of_held
from twin_diagram.gap.whole_robot.held_loads import held_loads, spans_of
from twin_diagram.gap.whole_robot.torque_equations import equations
from twin_diagram.gap.whole_robot.unusual import terms_of, unusual
from twin_diagram.logs import Log
from twin_diagram.model.effects import Effect
from twin_diagram.signals.stretches import stretches

MASS, COM = 1.5, [0.02, 0.03, 0.08]
LOAD = effect("payload", links=["tool0"], mass=MASS, com=COM)
PUSH = effect("external_force", links=["wrist_3_link"], wrench=[15.0, -6.0, -9.0, 0.0, 0.0, 0.0])


def during(more: Effect, *spans: tuple[float, float], seconds: float = 16.0) -> Records:
    """Of an arm with friction on all joints, and something more within some spans [s]."""
    true = ARM.with_effects([everywhere("viscous_friction", damping=2.0), everywhere("coulomb_friction", torque=1.0)])
    plain, other = (noisy(ARM, one, seconds) for one in (true, true.with_effects([*true.effects, more])))
    (record,), (there,) = plain.records, other.records
    held = np.any([(record.time >= a) & (record.time < b) for a, b in spans], axis=0)[:, None]
    return replace(plain, records=(replace(record, torque=np.where(held, there.torque, record.torque)),))


@cache
def picked_twice() -> WholeRobot:
    """What is found of an arm that holds the same load in two spans."""
    found = explain(during(LOAD, (3.0, 6.5), (9.0, 13.0)))
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("spans", "told"),
    [
        ([(5.0, 9.0)], [((0, 5.0), (0, 9.0))]),
        ([(7.0, 17.0)], [((0, 7.0), None)]),
        ([(-1.0, 8.0)], [(None, (0, 8.0))]),
        ([(2.0, 14.0)], [((0, 2.0), (0, 14.0))]),  # most of the log
        ([(2.0, 4.5), (6.5, 9.0), (11.0, 14.0)], [((0, 11.0), (0, 14.0)), ((0, 2.0), (0, 4.5)), ((0, 6.5), (0, 9.0))]),
    ],
)
def test_a_load_is_found_with_its_spans(spans: list[tuple[float, float]], told: list[Span]) -> None:
    whole, start = settled(begun(*((records := during(LOAD, *spans)), equations(records))))
    (load,) = held_loads(whole, start, terms_of(whole.sums, ARM))
    assert load.name == "payload" and load.passing and len(load.spans) == len(told)
    assert (load.onset, load.end) == load.spans[0]
    for found, true in zip(sorted(load.spans[1:], key=str), told[1:], strict=True):
        alike(found, true)
    alike(load.spans[0], told[0])


def alike(found: Span, true: Span) -> None:
    """Fail where two spans begin or end more than two hundredths of a second apart."""
    for a, b in zip(found, true, strict=True):
        assert (a is None) == (b is None)
        assert a is None or b is None or (a[0] == b[0] and a[1] == pytest.approx(b[1], abs=0.02))


def test_a_load_that_is_picked_while_all_joints_rest_is_told_to_have_come_in_the_middle_of_that() -> None:
    rise = np.full(2000, -1.0)
    rise[800:1200] = 1.0
    rise[700:800] = 0.0
    ((begin, end),) = stretches(spans_of(rise, rise, 10.0))
    assert begin == pytest.approx(750, abs=2) and end == 1200


def test_what_is_no_load_has_no_spans() -> None:
    """Neither an arm that holds nothing, nor one that holds something all the time, nor one that is pushed aside."""
    calm, always = during(LOAD, (20.0, 21.0)), during(LOAD, (-1.0, 21.0))
    for records in (calm, always):
        whole, start = settled(begun(records, equations(records)))
        assert held_loads(whole, start, terms_of(whole.sums, ARM)) == []
    pushed = during(PUSH, (5.0, 9.0))
    whole, start = settled(begun(pushed, equations(pushed)))
    assert [c.name for c in unusual(whole, start, ARM).sums.further] == ["external_force"]


@pytest.mark.long
def test_a_load_that_is_picked_twice_is_one_payload_in_two_spans() -> None:
    """It passed for a push, and friction, rotors and links bent to what that left."""
    found = picked_twice()
    loads = [one for one in found.findings if one.name == "payload"]
    assert len(loads) == 2 and not [one for one in found.findings if one.name == "external_force"]
    assert loads[0].parameters == loads[1].parameters and loads[0].confidence > 0.9
    mass, com = loads[0].parameters["mass"], loads[0].parameters["com"]
    assert isinstance(mass, Estimate) and isinstance(com, Estimate)
    assert abs(float(mass.value) - MASS) < 2.0 * float(mass.std) < 0.05  # type: ignore[arg-type]
    assert np.all(np.abs(np.array(com.value) - COM) < 0.005)
    assert all(0.0 < one.onset.std < 0.05 for one in loads if one.onset is not None)
    assert [one.onset.time for one in loads if one.onset is not None] == pytest.approx([9.0, 3.0], abs=0.02)
    assert np.all(found.fitted < 0.06)  # noise is .1 before the low-pass


def test_the_corrected_model_has_the_load_while_it_is_held() -> None:
    found, records = picked_twice(), during(LOAD, (3.0, 6.5), (9.0, 13.0))
    (record,) = records.records
    told = found.model.for_run(record.mark).inverse_dynamics(record.q, record.v, record.a, time=record.time)
    assert np.all(np.sqrt(np.mean((record.torque - told) ** 2, axis=0)) < 0.2)
    elsewhere = found.model.for_run("another run").inverse_dynamics(record.q, record.v, record.a, time=record.time)
    weight = np.abs(told - elsewhere)[:, 1]
    held = ((record.time > 3.1) & (record.time < 6.4)) | ((record.time > 9.1) & (record.time < 12.9))
    free = (record.time < 2.9) | ((record.time > 6.6) & (record.time < 8.9)) | (record.time > 13.1)
    assert np.max(weight[free]) < 1e-9 < 1.0 < np.mean(weight[held])


def test_it_is_said_when_a_load_is_held() -> None:
    time = np.linspace(0.0, 16.0, 5)
    still = np.zeros((5, 6))
    log = Log(time=time, joints=ARM.joints, position=still, torque=still, source="a.csv")
    (note,) = told_of_held(picked_twice(), [log])
    assert "3.0" in note and "9.0" in note and "gone in other runs" in note


def test_spans_begin_and_end_where_it_is_likeliest_and_none_is_for_little() -> None:
    rng = np.random.default_rng(3)
    rise = rng.normal(size=2000) - 0.5
    rise[500:900] += 1.5
    rise[1300:1304] += 2.0
    held = spans_of(rise, rise, 10.0)
    assert np.all(held[520:880]) and not np.any(held[:480]) and not np.any(held[920:])
    rise[500:900] = 0.0
    assert not np.any(spans_of(rise, rise, 10.0))
