"""Tests at the filter's rate: NIS as an average, as Page's sum and in a row, and a torque that began and stays.

A threshold is μ + kσ of normal operation (Hybrid Reality Twins, section 3.4), wider where that was learnt from little
(`learned_threshold`), and never within what the filter itself claims: an innovation that its covariance allows is no
drift.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.estimation.drift import learned_threshold, likelihood_ratio
from twin_diagram.estimation.drift.state import DriftEntry, DriftState
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """How far innovations may stray: chosen by hand.

    `sims/benchmarks/false_alarms.py` shows what it costs in false alarms, `make hrt-tables` what it finds and how
    soon.
    """

    window: float = 0.1
    """Time over which NIS is averaged [s]."""

    spike: float = 0.5
    """One message moves the average by no more than this share of the way to its threshold: a spike alone is no
    drift."""

    far: float = 10.0
    """A message whose NIS is this many times what is normal is far off."""

    in_a_row: float = 1.5
    """More messages in a row that are far off are no spike: an encoder jumped, say."""

    tolerance: float = 2.5
    """NIS may be this many times what the filter claims, or what it was in the little time in which normal operation
    was learnt: a covariance is hardly ever better known, and quick motion strains every model. An arm that sped up
    in all its joints at once was seen at 2.1 for a third of a second."""

    slack: float = 0.5
    """The cumulative sum forgives this many standard deviations per message."""

    jump: float = 2.0
    """It alarms at this many k standard deviations."""


TUNING = Tuning()


def innovation_test(
    state: DriftState, nis: float, white: Array | None, dt: float, sigma: float, learning: bool, armed: bool
) -> float:
    """Take in a message; answer the largest statistic over its threshold, 0 before normal operation is known.

    Messages in a row that are far off are another test: see `in_a_row`.

    Args:
        state: of the monitor.
        nis: of the message, 2n degrees of freedom.
        white: (n,) whitened innovation of the joints' torques; None: no change test.
        dt: since the message before [s].
        sigma: k.
        learning: whether this is normal operation, to be learnt.
        armed: whether it is known.
    """
    h = state.header
    n = state.sums.shape[1]
    dof = 2.0 * n
    blend = min(dt / TUNING.window, 1.0)
    usual = max(dof, h[DriftEntry.MEAN])
    capped = min(nis, usual + TUNING.spike * sigma * np.sqrt(dof / blend))
    h[DriftEntry.LOUD] = h[DriftEntry.LOUD] + 1.0 if nis > TUNING.far * usual else 0.0
    h[DriftEntry.NIS] += blend * (capped - h[DriftEntry.NIS])
    changes = None if white is None else likelihood_ratio.add_message(state.sums, white)
    mean, squares = state.change
    if learning:
        h[DriftEntry.COUNT] += 1
        before = h[DriftEntry.NIS] - h[DriftEntry.MEAN]
        h[DriftEntry.MEAN] += before / h[DriftEntry.COUNT]
        h[DriftEntry.SQUARES] += before * (h[DriftEntry.NIS] - h[DriftEntry.MEAN])
        h[DriftEntry.SPREAD] += (capped - h[DriftEntry.MEAN]) ** 2
        if changes is not None:
            beyond = changes - mean
            mean += beyond / h[DriftEntry.COUNT]
            squares += beyond * (changes - mean)
        return 0.0
    if not armed:
        return 0.0
    count = max(h[DriftEntry.COUNT], 1.0)
    # Averaging over a window of W messages leaves 1/(2W) of the variance; white innovations of the claimed
    # covariance have mean 2n and variance 4n.
    claimed = TUNING.tolerance * dof + sigma * np.sqrt(2.0 * dof * 0.5 * blend)
    witnesses = h[DriftEntry.NORMAL] / learned_threshold.TUNING.witness
    threshold = max(
        learned_threshold.threshold(h[DriftEntry.MEAN], h[DriftEntry.SQUARES] / count, sigma, witnesses), claimed
    )
    level = TUNING.tolerance * usual
    spread = np.sqrt(max(h[DriftEntry.SPREAD] / count, 2.0 * dof))
    h[DriftEntry.SUM] = max(0.0, h[DriftEntry.SUM] + min((nis - level) / spread, 0.5 * sigma) - TUNING.slack)
    if changes is not None:
        usual_change = learned_threshold.threshold(mean, squares / count, sigma, witnesses)
        h[DriftEntry.CHANGE] = float(
            np.max(changes / np.maximum(usual_change, likelihood_ratio.WIDER * likelihood_ratio.threshold(n)))
        )
    statistic = max(h[DriftEntry.NIS] / threshold, h[DriftEntry.SUM] / (TUNING.jump * sigma), h[DriftEntry.CHANGE])
    h[DriftEntry.SUM] = min(h[DriftEntry.SUM], 2.0 * TUNING.jump * sigma)
    return float(statistic)


def in_a_row(state: DriftState) -> float:
    """Return how many messages in a row are far off, over how many may be."""
    return float(min(state.header[DriftEntry.LOUD] / TUNING.in_a_row, 2.0))


def forget(state: DriftState) -> None:
    """Forget what was measured against another model; what is normal stays as it was learnt."""
    h = state.header
    h[DriftEntry.NIS] = min(h[DriftEntry.NIS], h[DriftEntry.MEAN] if h[DriftEntry.COUNT] else 2.0 * state.sums.shape[1])
    h[[DriftEntry.SUM, DriftEntry.CHANGE, DriftEntry.LOUD]] = 0.0
    state.sums[:] = 0.0
