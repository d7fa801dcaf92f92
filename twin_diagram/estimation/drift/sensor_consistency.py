"""Whether a further sensor parts ways with all that the filter holds: a slip, a contact, a bias, a slow pull.

The whitened innovations of a sensor are summed with exponential forgetting over some 2 to 100 readings, three numbers
at a time (a rotation, a position, a force), as `likelihood_ratio` does for the joints' torques. While a sensor agrees
with the rest, a sum's square is χ² of three degrees of freedom. Where sensor or model err a little and for long, sums
grow: the threshold is μ + kσ of their size in normal operation, but never within what the filter claims. Normal
operation is learnt on for as long as no alarm stands and nothing comes near one, or a slow pull would teach its own
threshold. While
little has been seen, μ and σ are drawn towards those of white innovations: a wide guess instead would let a pull that
begins early pass for good.

Readings that the gate refused are counted apart: as many in a row as outliers alone would not bring in years are no
outliers. Their share is learnt, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram.estimation.drift.likelihood_ratio import TUNING as LIKELIHOOD_RATIO
from twin_diagram.estimation.filter.belief import SensorTrack
from twin_diagram.estimation.filter.sensor_registry import TUNING as SENSOR_REGISTRY
from twin_diagram.signals import chi_square
from twin_diagram.signals.arrays import Array

FORGETTING: Final = np.array([0.5, 0.8, 0.95, 0.99])
"""λ: 2, 5, 20 and 100 readings."""
WIDER: Final = np.array([1.0, 1.0, 1.5, 2.0])
"""No threshold is below so many times that of white innovations: what the model gets wrong lasts, so that the longer a
sum goes back, the less it is like one of white noise."""


@dataclass(frozen=True)
class Tuning:
    """What is normal of a further sensor: chosen by hand.

    `sims/benchmarks/false_alarms.py` with `--sensors all` shows what it costs in false alarms.
    """

    block: int = 3
    """Numbers of a reading that are tested together."""

    settling: float = 2.0
    """A sensor's own bias is found in this time; nothing is learnt or tested before [s]."""

    memory: float = 60_000.0
    """Readings over which normal operation is averaged."""

    near: float = 0.5
    """What is beyond this share of its threshold is no lesson."""

    believed: float = 3.0
    """What white innovations would do counts as much as this many independent sums."""

    outliers: tuple[float, ...] = (2.0, 40.0)
    """Refused readings, of so many, that are taken for granted before any has come."""


TUNING = Tuning()


def newest(before: Array, after: Array) -> tuple[Array, bool] | None:
    """Return the reading that came between two looks at a sensor's track record, None where there was not exactly one.

    Args:
        before: (len(SensorTrack) + m,) `belief.SensorTrack`, then the mean whitened innovation.
        after: the same, later.

    Returns:
        Its whitened innovation (m,), within six deviations, and whether the filter used it.
    """
    accepted, refused = (after - before)[[SensorTrack.ACCEPTED, SensorTrack.REFUSED]]
    if {accepted, refused} != {0.0, 1.0}:
        return None
    old, new = before[len(SensorTrack) :], after[len(SensorTrack) :]
    return old + SENSOR_REGISTRY.memory * (new - old), bool(accepted)


class CrossCheck:
    """The test of several sensors; what it remembers is a flat vector that its caller keeps.

    Attributes:
        size: of that vector.
        sizes: degrees of freedom of each sensor.
    """

    def __init__(self, sizes: Sequence[int], sigma: float, learning_time: float) -> None:
        """Lay the vector out.

        Args:
            sizes: degrees of freedom of each sensor.
            sigma: k.
            learning_time: normal operation before the first alarm [s].
        """
        self.sizes, self._sigma, self._learning_time = tuple(sizes), sigma, learning_time
        blocks = [-(-size // TUNING.block) for size in sizes]
        counts = [4 + len(FORGETTING) * (size + 2 * block) for size, block in zip(sizes, blocks, strict=True)]
        self._starts = np.concatenate([[0], np.cumsum(counts)]).astype(int)
        self._blocks = [np.arange(0, size, TUNING.block) for size in sizes]
        claimed = chi_square.quantile(1.0 - LIKELIHOOD_RATIO.false_rate, np.arange(TUNING.block + 1)[1:])
        dofs = [np.minimum(size - at, TUNING.block) for size, at in zip(sizes, self._blocks, strict=True)]
        self._claimed = [claimed[dof - 1] for dof in dofs]
        # Mean and variance of white sums' size, over what is claimed of it.
        self._white = [
            (chi_square.mean_of_root(dof) / np.sqrt(limit), chi_square.variance_of_root(dof) / limit)
            for dof, limit in zip(dofs, self._claimed, strict=True)
        ]
        self._narrow = (1.0 - FORGETTING**2)[:, None]
        self.size = int(self._starts[-1])

    def begin(self, vector: Array) -> None:
        """Forget what was measured against another model; what is normal stays as it was learnt."""
        for index in range(len(self.sizes)):
            head, sums, _, _ = self._views(vector, index)
            head[3] = 0.0
            sums[:] = 0.0

    def follow(self, vector: Array, index: int, white: Array, accepted: bool, t: float, quiet: bool) -> float:
        """Take in a reading; answer the largest statistic over its threshold, 0 before normal operation is known.

        Args:
            vector: (size,) in place.
            index: which sensor.
            white: (m,) whitened innovation.
            accepted: whether the filter used it.
            t: of the filter [s], positive.
            quiet: whether no alarm stands.
        """
        head, sums, mean, squares = self._views(vector, index)
        if head[0] == 0.0 or t < head[0]:  # the first, or a clock that was set back
            head[0] = t
        if t < head[0] + TUNING.settling or not np.all(np.isfinite(white)):
            return 0.0
        armed = t >= head[0] + TUNING.settling + self._learning_time
        if not accepted:
            head[3] += 1.0
            if quiet:
                head[2] = min(head[2] + 1.0, 0.5 * TUNING.memory)
            share = (head[2] - head[3] * quiet + TUNING.outliers[0]) / (head[1] + head[2] + TUNING.outliers[1])
            run = np.log(LIKELIHOOD_RATIO.false_rate) / np.log(min(max(share, 1e-3), 0.5))
            return float(head[3] / run) if armed else 0.0
        head[3] = 0.0
        sums *= FORGETTING[:, None]
        sums += white * min(1.0, LIKELIHOOD_RATIO.cap / max(float(np.linalg.norm(white)), LIKELIHOOD_RATIO.cap))
        statistic = np.add.reduceat(self._narrow * sums * sums, self._blocks[index], axis=1) / self._claimed[index]
        level = np.sqrt(statistic)
        count = max(head[1], 1.0)
        if not armed:
            found = 0.0
        else:
            seen = (count * (1.0 - FORGETTING))[:, None]
            share = seen / (seen + TUNING.believed)
            white_mean, white_squares = self._white[index]
            beyond = mean - white_mean
            spread = share * squares + (1.0 - share) * (white_squares + share * beyond**2)
            usual = white_mean + share * beyond
            found = float(np.max(level / np.maximum(usual + self._sigma * np.sqrt(spread), WIDER[:, None])))
        if quiet and found < TUNING.near:
            head[1] = min(head[1] + 1.0, TUNING.memory)
            before = level - mean
            mean += before / head[1]
            squares += (before * (level - mean) - squares) / head[1]
        return found

    def _views(self, vector: Array, index: int) -> tuple[Array, Array, Array, Array]:
        """Head (first time, readings learnt from, refused, refused in a row), sums, mean and variance of their size."""
        part = vector[self._starts[index] : self._starts[index + 1]]
        L, size, blocks = len(FORGETTING), self.sizes[index], len(self._blocks[index])
        sums, mean, squares = np.split(part[4:], [L * size, L * (size + blocks)])
        return part[:4], sums.reshape(L, size), mean.reshape(L, blocks), squares.reshape(L, blocks)
