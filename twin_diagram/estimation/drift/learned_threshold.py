"""The threshold μ + kσ where μ and σ themselves were learnt, and from how much."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """How much wider a threshold learnt from little is: by hand, after how well a sample tells mean and deviation.

    `sims/benchmarks/false_alarms.py` shows the first minutes, where it counts.
    """

    few: float = 2.0
    """The threshold is wider by this many times 1/√N of its kσ: N witnesses know σ of what has a heavy tail to about
    √(2/N) of itself, and μ to 1/√N of σ."""

    witness: float = 0.1
    """What is measured over this time is one witness: quick motion strains a model for as long [s]."""


TUNING = Tuning()


def threshold(mean: Array | float, variance: Array | float, sigma: float, witnesses: Array | float) -> Array | float:
    """Return μ + k (1 + 2/√N) σ.

    Args:
        mean: μ as learnt.
        variance: σ² as learnt.
        sigma: k.
        witnesses: N independent of one another that it was learnt from; less than one counts as one.
    """
    return mean + sigma * (1.0 + TUNING.few / np.sqrt(np.maximum(witnesses, 1.0))) * np.sqrt(variance)
