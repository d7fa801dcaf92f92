"""Logged torques that all come after the motion that they belong to: shifted back before anything is fitted.

A drive's filter, or stamps of another clock, makes them late. The catalogue has no name for it, and links, rotors and
friction would bend to it: torque that is late by a few milliseconds looks like inertia that damps.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.whole_robot.explain import begun, settled
from twin_diagram.gap.whole_robot.late_torque import behind
from twin_diagram.gap.whole_robot.mended_logs import Mend
from twin_diagram.gap.whole_robot.torque_equations import equations
from twin_diagram.logs import Log, fingerprint
from twin_diagram.model.dynamics.onsets import shifted
from twin_diagram.signals.arrays import Array


def lag_of(records: Records) -> float:
    """Return by how much all logged torques come after their motion [s]; 0 where they do not, or nothing tells.

    Args:
        records: prepared with the given model.
    """
    try:
        return behind(*settled(begun(records, equations(records))))
    except np.linalg.LinAlgError:  # a log in which next to nothing moves
        return 0.0


def in_time(records: Records) -> Mend | None:
    """Return how logs are whose torques come with their motion; None where they do."""
    seconds = lag_of(records)
    if not seconds:
        return None
    note = (
        f"the logged torques come some {1e3 * seconds:.0f} ms after the motion that they belong to (a filter in the "
        "drives, or stamps of another clock): they were shifted by that before all else, also where the gap is shown; "
        "log them unfiltered"
    )
    return Mend(note, partial(_earlier, seconds=seconds))


def _earlier(log: Log, seconds: float) -> Log:
    """Return a log whose torques are so much earlier [s], as of the same run."""

    def moved(torque: Array | None) -> Array | None:
        return None if torque is None else shifted(torque, log.time, seconds)

    return replace(
        log,
        torque=moved(log.torque),
        torque_commanded=moved(log.torque_commanded),
        identity=fingerprint(log),
    )
