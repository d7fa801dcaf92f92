"""Contacts that are no steady force: which spans are told, and that steady forces and single joints are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.gap.made import ARM, effect, everywhere
from tests.gap.whole_robot.test_explain import noisy
from twin_diagram.gap.findings import Place, Verdict
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot import contacts as module
from twin_diagram.gap.whole_robot.contacts import Contact, beside_contacts, contacts, placed
from twin_diagram.logs import Log
from twin_diagram.signals.arrays import Array

WALL = effect("external_force", links=["forearm_link"], wrench=[60.0, -30.0, 45.0, 0.0, 0.0, 0.0])
BEGIN, END = 6.0, 7.0


def with_more(share: Array, *, joints: slice = slice(None)) -> Records:
    """Of an arm with damping on all joints, and a share (N,) of a force on its forearm."""
    true = ARM.with_effects([everywhere("viscous_friction", damping=2.0)])
    calm, hit = (noisy(ARM, one, 16.0) for one in (true, true.with_effects([*true.effects, WALL])))
    (record,), (other,) = calm.records, hit.records
    torque = record.torque.copy()
    torque[:, joints] += share[:, None] * (other.torque - record.torque)[:, joints]
    return replace(calm, records=(replace(record, torque=torque),))


def while_held(size: Array) -> Array:
    """A share (N,) of a force from `BEGIN` to `END` alone, as of times from 0 to 1 between."""
    time = np.arange(3200) / 200.0
    return np.where((time >= BEGIN) & (time < END), np.interp(time, np.linspace(BEGIN, END, len(size)), size), 0.0)


WAVES = np.sin(np.linspace(0.0, 3.0 * np.pi, 50))


def test_a_wall_that_gives_and_pushes_back_is_a_contact() -> None:
    (found,) = contacts(with_more(while_held(WAVES)))
    assert found.log == 0
    assert BEGIN - 0.4 < found.begin < BEGIN + 0.1
    assert END - 0.1 < found.end < END + 0.4
    assert np.all(found.share > 0.0)
    assert np.all(np.argsort(-found.share)[:2] < 3)
    assert 0.05 < np.sum(found.share) < 0.5  # damping is everywhere


def test_a_knock_is_a_contact_however_steady() -> None:
    """Forces that are over in a tenth of a second have no name; three of 60 N left an arm a quarter of its friction."""
    time = np.arange(3200) / 200.0
    (found,) = contacts(with_more(np.where((time >= BEGIN) & (time < BEGIN + 0.12), 3.0, 0.0)))
    assert found.begin < BEGIN + 0.05
    assert found.end > BEGIN + 0.1


@pytest.mark.parametrize(
    ("share", "joints"),
    [
        (np.zeros(3200), slice(None)),
        (while_held(np.ones(2)), slice(None)),  # a push, which has a name
        (while_held(WAVES), slice(2, 3)),  # one joint's own
        (np.where(np.arange(3200) < 200.0 * END, 0.0, 1.0), slice(None)),  # what stays is no event
    ],
)
def test_what_is_no_contact(share: Array, joints: slice) -> None:
    assert contacts(with_more(share, joints=joints)) == []


def log_of(seconds: float) -> Log:
    """Whatever moves."""
    time = np.arange(0.0, seconds, 0.01)
    q = np.tile(np.sin(time)[:, None], (1, len(ARM.joints)))
    return Log(time=time, joints=ARM.joints, position=q, torque=q, source="a.csv")


def test_the_rest_of_a_log_is_its_stretches_beside_contacts(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is too short goes; where too little would be left, nothing is left out."""
    share = np.full(len(ARM.joints), 0.1)
    spans = [Contact(1, 1.5, 2.0, share), Contact(1, 6.0, 6.5, share)]
    monkeypatch.setattr(module, "contacts", lambda records: spans)
    notes: list[str] = []
    first, second = log_of(5.0), log_of(10.0)
    logs, records, found = beside_contacts(ARM, [first, second], notes)
    spans_left = np.array([(log.time[0], log.time[-1]) for log in logs])
    np.testing.assert_allclose(spans_left, [(0.0, 4.99), (2.01, 5.99), (6.51, 9.99)])
    assert len(records.records) == 3
    assert [one.log for one in found] == [1, 1]
    (note,) = notes
    assert "1.50 to 2.00 s, 6.00 to 6.50 s" in note
    spans[:] = [Contact(1, 1.5, 8.5, share), Contact(0, 1.0, 4.0, share)]
    logs, _, found = beside_contacts(ARM, [first, second], notes)
    assert logs == [first, second]
    assert found == []
    assert len(notes) == 1


def test_a_verdict_says_where_contacts_were() -> None:
    """What is named leaves a remainder, and a description that explains all else is not all that there was."""
    share = np.array([0.6, 0.2, 0.0, 0.0, 0.0, 0.0])
    spans = [Contact(0, 6.0, 7.0, share)]
    before = (Place(ARM.joints[3], 0.5, "with speed", (0.0, 9.0)), Place(ARM.joints[4], 0.5, "with speed", (0.0, 9.0)))
    none = Verdict("none", False, (), before, (), np.ones(6))
    there = placed(none, ARM.joints, spans, fresh=True)
    assert there.verdict == "unknown"
    assert [(one.joint, one.condition) for one in there.where[:2]] == [
        (joint, "during a contact") for joint in ARM.joints[:2]
    ]
    assert sum(one.share for one in there.where) == pytest.approx(1.0)
    assert placed(none, ARM.joints, spans, fresh=False).verdict == "none"
    assert placed(replace(none, verdict="named"), ARM.joints, spans, fresh=True).remainder
    assert placed(none, ARM.joints, [], fresh=True) is none
