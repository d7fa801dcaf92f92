"""The begin of a log, at which no event is told to begin: the arm sets off from rest, and laws are roughest.

Friction builds up as joints turn for the first time, and controllers take the load over. What is left of that begins
with the log, and lasts for a while, as a push would.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.residuals.prepared_logs import Records


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    calm: float = 0.4
    """For which a log must show the arm without an event before it [s]: as long as the shortest push lasts."""


TUNING = Tuning()


def with_the_log(event: Candidate, records: Records) -> bool:
    """Return whether an event begins as its log does, as far as samples are left of it.

    Args:
        event: any; what is always there begins with nothing.
        records: whose samples it is told of.
    """
    if event.onset is None:
        return False
    log, time = event.onset
    return bool(time - np.min(records.times[records.owner == log]) < TUNING.calm)
