"""Takes single samples that leap away and back for what they are: a message that was garbled, and no motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from twin_diagram.logs.checking import LogWarning
from twin_diagram.logs.fingerprint import fingerprint
from twin_diagram.logs.measured_log import SIGNALS, Log
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand: no arm does that from one sample to the next."""

    usual: float = 0.99
    """Share of a signal's samples that say how far one is from the middle of its neighbours as a rule. One that leaps
    puts three off it: where more than a third of the rest (0.3 %) leap, that is what the signal does."""

    beyond: float = 20.0
    """Times that, by which a sample leaps away and back."""

    share: float = 0.002
    """The same over what the signal does at all, from its lowest to its highest hundredth: an encoder at rest flips."""


TUNING = Tuning()


def unspiked(log: Log) -> tuple[Log, list[LogWarning]]:
    """Return the log with what its neighbours say in the place of such samples, and what was done; or itself.

    Args:
        log: checked.
    """
    signals: dict[str, Any] = {}
    warnings = []
    for called, name in SIGNALS.items():
        values = getattr(log, name)
        if values is None or name == "position_commanded" or not np.any(there := spikes(values)):
            continue
        signals[name] = mended(log.time, values, there)
        while np.any(more := spikes(signals[name]) & ~there):  # of two that stand close, the farther one is found first
            there |= more
            signals[name] = mended(log.time, values, there)
        joints = ", ".join(joint for joint, some in zip(log.joints, np.any(there, axis=0), strict=True) if some)
        message = (
            f"{log.source}: {int(np.sum(there))} sample(s) of {called} of {joints} leap away and back; they are taken "
            "as lost"
        )
        warnings.append(LogWarning("spike", message))
    return (replace(log, identity=fingerprint(log), **signals) if signals else log), warnings


def spikes(values: Array) -> npt.NDArray[np.bool_]:
    """Return (N, n) which samples of signals (N, n) leap away from both neighbours, farther than anything else does.

    Where dry friction turns, a torque is off the middle of its neighbours, too, but does not come back.
    """
    steps = np.diff(values, axis=0)
    before, after = steps[:-1], steps[1:]
    off = np.abs(0.5 * (before - after))
    low, high = np.quantile(values, (1.0 - TUNING.usual, TUNING.usual), axis=0)
    far = np.maximum(TUNING.beyond * np.quantile(off, TUNING.usual, axis=0), TUNING.share * (high - low))
    leaps = (before * after < 0.0) & (np.minimum(np.abs(before), np.abs(after)) > far)
    beside = np.pad(off, ((1, 1), (0, 0)))
    leaps &= (off >= beside[:-2]) & (off >= beside[2:])  # its neighbours are off theirs because of it
    return np.concatenate([np.zeros_like(leaps[:1]), leaps, np.zeros_like(leaps[:1])])


def mended(time: Array, values: Array, there: npt.NDArray[np.bool_]) -> Array:
    """Return signals (N, n) with what lies between their neighbours in the place of some samples (N, n)."""
    return np.stack([np.interp(time, time[~bad], x[~bad]) for x, bad in zip(values.T, there.T, strict=True)], axis=1)
