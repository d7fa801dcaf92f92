"""How far each test's threshold must be widened so that false alarms stay as rare as was asked for.

A threshold of μ + kσ says nothing of how often it is crossed: statistics are correlated in time, there are many of
them, and what a model gets wrong makes their tails heavier than a Gaussian's. So each test's statistic, over its
threshold, is watched for as long as nothing is wrong: its largest value in each `block` is one witness, alike in time
or not. Of N blocks n were above `high`, by β on average; with an exponential tail beyond, the rate of peaks over
threshold is

    rate(u) = (n / N) exp(−(u − high) / β) / block,

and the margin u is where that is this test's share of the rate that was asked for. A statistic counts over its margin.
Peaks over threshold: Pickands, "Statistical inference using extreme order statistics", Ann. Statist. 1975; the
exponential is the tail of squared Gaussians, and heavier than that of Gaussians.

Before much was seen, a prior worth `prior_blocks` speaks. A block is learnt from only `delay` blocks later, and not at
all where an alarm came in between, or what grows slowly would teach its own threshold.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.errors import ScenarioError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """The prior of each test's tail and how it is learnt: chosen by hand.

    `sims/benchmarks/false_alarms.py` counts the alarms that are left beside the rate that was asked for.
    """

    block: float = 1.0
    """Over this time the largest statistic is taken [s]."""

    high: float = 0.7
    """Peaks above this share of a threshold tell its tail."""

    delay: int = 16
    """Blocks after which one is learnt from."""

    prior_blocks: float = 30.0
    """Blocks that the prior is worth: half a minute of normal operation outweighs it."""

    prior_peaks: float = 3.0
    """Peaks that those had."""

    prior_margin: float = 1.0
    """The margin before anything is known [thresholds]."""

    widest: float = 2.0
    """No margin is wider: a test that needs more is not worth its name, and its false alarms say so."""

    memory: float = 20_000.0
    """Blocks over which the tail is averaged."""

    head: int = 5  # largest in this block, blocks, peaks, sum of what peaks were above `high`, the margin

    none: float = -1.0
    """Stands for a block that is not there, among those that wait."""


TUNING = Tuning()


class FalseRate:
    """The margins of several tests; what it remembers is a flat vector that its caller keeps.

    Attributes:
        size: of that vector.
    """

    def __init__(self, tests: int, rate: float) -> None:
        """Lay the vector out.

        Args:
            tests: how many.
            rate: false alarms of all together that are accepted [1/h].

        Raises:
            ScenarioError: a rate that is not positive and finite; none at all would take no alarm at all.
        """
        if not 0.0 < rate < np.inf:
            raise ScenarioError("twin.drift.false_alarms", f"{rate} per hour: it must be positive and finite")
        self.tests = tests
        self.size = 1 + tests * (TUNING.head + TUNING.delay)
        self._per_hour = 3600.0 / TUNING.block * tests / rate
        expected = max(TUNING.prior_peaks / TUNING.prior_blocks * self._per_hour, np.e)
        self._prior = np.array(
            [
                TUNING.prior_blocks,
                TUNING.prior_peaks,
                TUNING.prior_peaks * (TUNING.prior_margin - TUNING.high) / np.log(expected),
            ]
        )

    def _views(self, vector: Array) -> tuple[Array, Array]:
        """Head (tests, 5) and blocks that wait (tests, delay), oldest first, `Tuning.none` where there is none."""
        table = vector[1:].reshape(self.tests, TUNING.head + TUNING.delay)
        return table[:, : TUNING.head], table[:, TUNING.head :]

    def begin(self, vector: Array) -> None:
        """Forget all: nothing is known yet."""
        vector[:] = 0.0
        head, waiting = self._views(vector)
        waiting[:] = TUNING.none
        head[:, 4] = self._margins(head)

    def _margins(self, head: Array) -> Array:
        blocks, peaks, beyond = (head[:, 1:4] + self._prior).T
        wanted = np.log(np.maximum(peaks / blocks * self._per_hour, 1.0))
        return np.asarray(np.clip(TUNING.high + beyond / peaks * wanted, 1.0, TUNING.widest))

    def take(self, vector: Array, test: int, statistic: float) -> float:
        """Take in a test's statistic over its threshold; answer it over its margin as well."""
        largest = 1 + test * (TUNING.head + TUNING.delay)
        vector[largest] = max(vector[largest], min(statistic, TUNING.widest))
        return statistic / float(vector[largest + 4])

    def margin(self, vector: Array, test: int) -> float:
        """Return by how much a test's threshold is widened, 1 to `Tuning.widest`."""
        return float(self._views(vector)[0][test, 4])

    def turn_over(self, vector: Array, t: float, calm: bool) -> None:
        """End the block where it is time to.

        Args:
            vector: (size,) in place.
            t: now [s].
            calm: whether tests are armed and no alarm stands; what was seen of late counts for nothing otherwise.
        """
        if calm and 0.0 <= t - vector[0] < TUNING.block:
            return
        head, waiting = self._views(vector)
        if not calm:
            head[:, 0], waiting[:], vector[0] = 0.0, TUNING.none, t
            return
        vector[0] = t
        learnt = waiting[:, 0].copy()
        waiting[:, :-1] = waiting[:, 1:]
        waiting[:, -1] = head[:, 0]
        head[:, 0] = 0.0
        if learnt[0] < 0.0:
            return
        above = np.maximum(learnt - TUNING.high, 0.0)
        head[:, 1:4] *= np.where(head[:, 1:2] >= TUNING.memory, 1.0 - 1.0 / TUNING.memory, 1.0)
        head[:, 1] += 1.0
        head[:, 2] += above > 0.0
        head[:, 3] += above
        head[:, 4] = self._margins(head)
