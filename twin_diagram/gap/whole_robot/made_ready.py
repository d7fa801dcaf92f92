"""Logs made ready for all that is fitted: without contacts that no law describes, torques in time and of one joint."""

from __future__ import annotations

from typing import NamedTuple

from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot.contacts import Contact, beside_contacts
from twin_diagram.gap.whole_robot.cross_talk import without_cross_talk
from twin_diagram.gap.whole_robot.lagging_torque import in_time
from twin_diagram.gap.whole_robot.mended_logs import mended
from twin_diagram.logs import Log
from twin_diagram.logs.parting import longest
from twin_diagram.model.model import Model


class ReadyLogs(NamedTuple):
    """What is fitted and held out.

    Attributes:
        logs: of the fit, or stretches of them.
        held: held out.
        records: prepared of the fit logs.
        spans: contacts that are left out of those.
    """

    logs: list[Log]
    held: Log
    records: Records
    spans: list[Contact]


def made_ready(given: Model, logs: list[Log], held: Log, notes: list[str]) -> ReadyLogs:
    """Leave contacts out of logs, shift torques that lag, and part those that read each other; `notes` grow.

    Args:
        given: the given model.
        logs: of the fit, checked.
        held: held out, checked.
        notes: of all logs.
    """
    logs, records, spans = beside_contacts(given, logs, notes)
    held = longest(beside_contacts(given, [held], notes, "; the longest stretch is held out")[0])
    for find in (in_time, without_cross_talk):
        logs, held, records = mended(find, given, logs, held, records, notes)
    return ReadyLogs(logs, held, records, spans)
