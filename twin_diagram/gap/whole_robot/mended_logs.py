"""Logs whose torques are told otherwise than they were: what is wrong with them the fit logs alone say."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from twin_diagram.gap.residuals.prepared_logs import Records, prepare
from twin_diagram.logs import Log
from twin_diagram.model.model import Model


class Mend(NamedTuple):
    """What is wrong with logged torques.

    Attributes:
        note: that it was, and what was done.
        of: a log without it, as of the same run.
    """

    note: str
    of: Callable[[Log], Log]


def mended(
    find: Callable[[Records], Mend | None], given: Model, logs: list[Log], held: Log, records: Records, notes: list[str]
) -> tuple[list[Log], Log, Records]:
    """Return fit logs and the held-out one without what is found wrong with them, and the fit logs prepared.

    Args:
        find: what is wrong; None: nothing.
        given: the given model.
        logs: of the fit.
        held: held out.
        records: prepared of the fit logs.
        notes: of all logs; they grow where something is wrong.
    """
    mend = find(records)
    if mend is None:
        return logs, held, records
    notes.append(mend.note)
    logs = [mend.of(log) for log in logs]
    return logs, mend.of(held), prepare(given, logs)
