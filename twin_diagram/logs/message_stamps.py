"""Stamps of messages, as they were received, brought into the order of a log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.errors import LogError
from twin_diagram.signals.arrays import Array

Index = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    back: int = 1_000_000_000
    """Messages overtake one another on a bus; a clock that goes back by more than this was set anew [ns]."""


TUNING = Tuning()


def in_order(stamps: Index, source: str, where: Callable[[int], str]) -> Index:
    """Return which messages to keep, in which order, so that their stamps rise: of those with one stamp, the first.

    Args:
        stamps: (N,) [ns], as received.
        source: what to call the log in errors.
        where: what to call a message.

    Raises:
        LogError: the clock goes back, as where a run started again.
    """
    latest = np.maximum.accumulate(stamps)
    back = np.flatnonzero(latest - stamps > TUNING.back)
    if len(back):
        k = int(back[0])
        raise LogError(
            f"{source}: {where(k)}: the clock goes back by {(latest[k] - stamps[k]) * 1e-9:.4g} s; "
            "it looks like several runs, a log holds one"
        )
    return np.asarray(np.unique(stamps, return_index=True)[1], dtype=np.int64)


def seconds(stamps: Index, begin: int) -> Array:
    """Return (N,) since a beginning, exact below what a sum of seconds since 1970 could hold [s]."""
    return np.asarray((stamps - begin) * 1e-9)
