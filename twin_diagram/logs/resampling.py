"""Brings logs to other sample times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from twin_diagram.errors import LogError
from twin_diagram.logs.fingerprint import fingerprint
from twin_diagram.logs.measured_log import SIGNALS, Log
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    most: float = 20.0
    """Times its samples that a log's time may hold of its periods: what is silent for longer is several runs, or a
    clock that jumped, and even times would not fit in memory."""


TUNING = Tuning()


def resample(log: Log, times: Array) -> Log:
    """Return the log at other times: positions by cubic splines, torques and velocities linearly between samples.

    Nothing is filtered: low-pass a log before going to a much lower rate.

    Args:
        log: any.
        times: (M,) rising [s], within the log's.

    Raises:
        LogError: `times` does not rise, or leaves the log.
    """
    times = np.asarray(times, dtype=float)
    if np.any(np.diff(times) <= 0.0):
        raise LogError(f"{log.source}: resample: times must rise")
    if len(times) and (times[0] < log.time[0] or times[-1] > log.time[-1]):
        raise LogError(
            f"{log.source}: resample: {times[0]:g} to {times[-1]:g} s is not within "
            f"{log.time[0]:g} to {log.time[-1]:g} s"
        )
    signals: dict[str, Any] = {}
    for attribute in SIGNALS.values():
        values = getattr(log, attribute)
        if values is None:
            continue
        degree = 3 if attribute == "position" and len(log) > 3 else 1
        told = ~np.any(np.isnan(values), axis=0)  # what is not logged of a joint is not at other times, either
        signals[attribute] = np.full((len(times), values.shape[1]), np.nan)
        spline = scipy.interpolate.make_interp_spline(log.time, values[:, told], k=degree)
        signals[attribute][:, told] = spline(times)
    return replace(log, time=times, identity=fingerprint(log), **signals)


def uniform(log: Log, rate: float | None = None) -> Log:
    """Return the log at a constant rate [1/s].

    None: its own, and the log itself where its times are regular already.

    Raises:
        LogError: it is silent for nearly all of its time.
    """
    if is_silent(log):
        k = int(np.argmax(np.diff(log.time)))
        raise LogError(
            f"{log.source}: time: jumps from {log.time[k]:.13g} to {log.time[k + 1]:.13g} s, far more than all its "
            "samples last; cut the log there"
        )
    period = log.period if rate is None else 1.0 / rate
    if rate is None and is_regular(log.time):
        return log
    count = int(np.floor((log.time[-1] - log.time[0]) / period * (1.0 + 1e-12))) + 1
    return resample(log, np.minimum(log.time[0] + period * np.arange(count), log.time[-1]))


def is_silent(log: Log) -> bool:
    """Return whether a log says nothing for nearly all of its time."""
    return bool(log.time[-1] - log.time[0] > TUNING.most * len(log) * log.period)


def is_regular(time: Array, tolerance: float = 1e-3) -> bool:
    """Return whether all steps are the same up to a share `tolerance` of themselves."""
    steps = np.diff(time)
    return bool(np.all(np.abs(steps - np.median(steps)) <= tolerance * np.median(steps)))
