"""A torque that begins and stays: a likelihood ratio on whitened innovations, and what shape an alarm has.

With white innovations w_k ~ N(0, 1) of n joints, m ← λ m + w has variance 1/(1 − λ²), so (1 − λ²) |m|² is χ² of n
degrees of freedom; an unmodelled torque on a joint gives w a mean, and m grows to 1/(1 − λ) times that. Several λ run
side by side, as the windows of a generalised likelihood ratio test do, at the cost of one number per joint and λ.
The sum is taken over innovations of momentum, which makes it a momentum observer whose bandwidth is set by λ.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from typing import Final

import numpy as np

from twin_diagram.signals import chi_square
from twin_diagram.signals.arrays import Array

FORGETTING: Final = np.array([0.5, 0.8, 0.95])
"""λ: 2, 5 and 20 messages."""


@dataclass(frozen=True)
class Tuning:
    """Probabilities and caps of the change test: chosen by hand.

    `sims/benchmarks/false_alarms.py` shows what is left on a model that is a little wrong.
    """

    cap: float = 6.0
    """A message is shortened to this many standard deviations: a spike alone is no change."""

    false_rate: float = 1e-9
    """Probability that the claimed distribution exceeds its threshold in one message; 200 Hz bring 720 000 an hour."""

    spike_time: float = 0.06
    """An alarm that is over within this time was a spike [s]."""


TUNING = Tuning()


WIDER: Final = np.array([1.0, 1.0, 2.2])
"""No threshold is below so many times that of white innovations: what quick motion brings out of a model that is a
little wrong lasts for tens of messages."""


class AlarmShape(IntEnum):
    """What an alarm's statistic did."""

    NONE = 0
    SPIKE = 1
    """It rose and was gone at once: a collision, a slip, a bad message."""
    STEP = 2
    """It rose and stays: something changed."""
    TREND = 3
    """It grew before it crossed the threshold: wear, drift, a slow pull."""


def add_message(sums: Array, white: Array) -> Array:
    """Add a message.

    Args:
        sums: (L, n) m for each λ, in place.
        white: (n,) whitened innovation.

    Returns:
        (L,) statistics, each χ² of n degrees of freedom while nothing changes.
    """
    sums *= FORGETTING[:, None]
    sums += white * min(1.0, TUNING.cap / max(float(np.linalg.norm(white)), TUNING.cap))
    statistic: Array = (1.0 - FORGETTING**2) * np.einsum("ij,ij->i", sums, sums)
    return statistic


@cache
def threshold(n: int) -> float:
    """Return the threshold of `add_message`'s statistics for innovations that are as white as the filter claims."""
    return float(chi_square.quantile(1.0 - TUNING.false_rate, n))


def grows(before: Array) -> bool:
    """Return whether a statistic grew towards its threshold, rather than jumped over it.

    Args:
        before: (K,) its largest value, over its threshold, in each tenth of a second before the alarm, oldest first.
    """
    if len(before) < 6:
        return False
    near = before[-1] > 0.4 and before[-3:].mean() > 0.4
    return bool(near and before[-6:-3].mean() < before[-3:].mean())
