"""Torques that read a part of each other: found where they do, taken out, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.gap.made import ARM, effect, everywhere
from tests.gap.whole_robot.test_explain import noisy
from tests.gap.whole_robot.test_held_loads import LOAD, during
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot import cross_talk as module
from twin_diagram.gap.whole_robot import mended_logs
from twin_diagram.gap.whole_robot.cross_talk import cross_talk, without_cross_talk
from twin_diagram.gap.whole_robot.mended_logs import mended
from twin_diagram.logs import Log, fingerprint
from twin_diagram.signals.arrays import Array

SHARES = 0.02 * np.random.default_rng(5).normal(size=(6, 6)) * (1.0 - np.eye(6))
"""Of other joints' torques, with which sensors' own shares are as they should be."""


def measured(mixed: Array = SHARES, *held: tuple[float, float]) -> Records:
    """Of an arm with friction and a link that is off, whose sensors read a part of each other's torque.

    It may hold a load for some spans [s].
    """
    friction = [everywhere("viscous_friction", damping=2.0), everywhere("coulomb_friction", torque=1.0)]
    links = effect("inertial_parameters", links=["forearm_link"], mass=0.8, com=[0.01, 0.02, 0.01])
    records = noisy(ARM, ARM.with_effects([*friction, links]), 16.0)
    (record,) = records.records
    loaded = noisy(ARM, ARM.with_effects([*friction, links, LOAD]), 16.0).records[0].torque
    for begin, end in held:
        during_it = ((record.time >= begin) & (record.time < end))[:, None]
        record = replace(record, torque=np.where(during_it, loaded, record.torque))
    return replace(records, records=(replace(record, torque=record.torque + record.torque @ mixed.T),))


@pytest.mark.parametrize("held", [(), ((4.0, 9.0),)])
def test_what_sensors_read_of_each_other_is_found(held: tuple[tuple[float, float], ...]) -> None:
    """Also where a load that is held for a while hides it."""
    found = cross_talk(measured(SHARES, *held))
    assert found is not None and np.all(np.diag(found) == 0.0)
    undone = (np.eye(6) - found) @ (np.eye(6) + SHARES)
    heavy = slice(1, 3)  # shoulder and elbow bear most, and are read by all others
    assert np.max(np.abs((undone - np.diag(np.diag(undone)))[:, heavy])) < 0.1 * np.max(np.abs(SHARES))


@pytest.mark.parametrize(
    "made", [lambda: measured(0.0 * SHARES), lambda: during(LOAD, (4.0, 9.0))], ids=["links off", "a load held"]
)
def test_sensors_that_read_their_own_joint_alone_have_none(made: Callable[[], Records]) -> None:
    """Neither where links are off, nor where a load is held for a while, which all joints bear at once."""
    assert cross_talk(made()) is None


def test_torques_are_parted_in_all_logs_and_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "cross_talk", lambda records: SHARES)
    monkeypatch.setattr(mended_logs, "prepare", lambda given, logs: logs)
    records, notes = measured(), list[str]()
    time = np.linspace(0.0, 9.0, 40)
    own = np.sin(time[:, None] + np.arange(6.0))
    both = own @ np.linalg.inv(np.eye(6) - SHARES).T
    fit = Log(time=time, joints=ARM.joints, position=own, torque=both, torque_commanded=own, source="a.csv")
    held = Log(time=time, joints=ARM.joints, position=own, torque_commanded=both, source="b.csv")
    (one,), other, _ = mended(without_cross_talk, ARM, [fit], held, records, notes)
    assert one.torque is not None and other.torque_commanded is not None and other.torque is None
    np.testing.assert_allclose(one.torque, own, atol=1e-12)
    np.testing.assert_allclose(other.torque_commanded, own, atol=1e-12)
    np.testing.assert_array_equal(one.torque_commanded, own)  # what was commanded no sensor has read
    assert fingerprint(one) == fingerprint(fit)
    assert len(notes) == 1 and "cross-talk" in notes[0]
    monkeypatch.setattr(module, "cross_talk", lambda records: None)
    assert mended(without_cross_talk, ARM, [fit], held, records, notes)[0][0] is fit
    assert len(notes) == 1
