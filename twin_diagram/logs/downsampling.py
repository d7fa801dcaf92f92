"""Downsamples long and fast logs to a rate that tells all that an arm does: ten minutes at 5 kHz fit in memory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin_diagram.logs.differentiation import smooth
from twin_diagram.logs.fingerprint import fingerprint
from twin_diagram.logs.measured_log import SIGNALS, Log
from twin_diagram.logs.resampling import uniform


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    long: int = 250_000
    """Samples up to which a log is taken as it is: a minute at 4 kHz."""

    rate: float = 1000.0
    """Samples per second that are enough: ten times what is ever looked at of motion or torque [1/s]."""

    edge: float = 0.4
    """Signals are low-passed at this share of the new rate: beyond half of it, they would pass for something else."""


TUNING = Tuning()


def downsampled(log: Log) -> Log:
    """Return a log that is long and fast at some 1 kHz, low-passed without phase; any other as it is.

    Args:
        log: checked.
    """
    every = int((len(log) - 1) / float(log.time[-1] - log.time[0]) / TUNING.rate + 1e-6)
    if len(log) <= TUNING.long or every < 2:
        return log
    mark = fingerprint(log)
    log = uniform(log)
    rate = (len(log) - 1) / float(log.time[-1] - log.time[0])
    signals: dict[str, Any] = {
        name: np.ascontiguousarray(smooth(values, rate, TUNING.edge * rate / every)[::every])
        for name in SIGNALS.values()
        if (values := getattr(log, name)) is not None
    }
    return replace(log, time=log.time[::every], identity=mark, **signals)
