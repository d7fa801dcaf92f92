"""What a run of refused or surprising messages was: noise that has grown, or a fault.

An encoder that jumped is off by the same from one message to the next, and an arm that is thrown leaves its model
smoothly; an encoder that has turned noisy differs from itself. So where the innovations since trouble began have a mean
within what their own differences make of it, and these are beyond the noise as known, it is the noise that is wrong: it
is found anew from them (half their mean square, von Neumann's estimate), and the state, which nothing contradicts,
stays. Else the state is taken anew from a message. Speeds alone do not tell: torque that nobody knows of makes them
scatter as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.estimation.filter.belief import Belief, Entry
from twin_diagram.estimation.filter.noise_estimate import WIDEST
from twin_diagram.scenario import Filter
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """When a run of refusals is noise and when a fault: chosen by hand.

    `tests/estimation/filter/test_outlier_streaks.py` shows both.
    """

    shifted: float = 4.0
    """Deviations of its mean by which a reading has jumped, and not just scattered."""

    grown: float = 3.0
    """A variance that is no longer that of the noise as known, over that."""

    fewest: float = 3.0
    """Messages that tell noise."""

    over: float = 5.0
    """After so many messages without it in a row trouble is over."""

    known: float = 200.0
    """Messages used before the noise counts as known; until then `noise_adaptation` finds it, quickly."""

    longest: float = 40.0
    """Messages after which its sums begin anew."""


TUNING = Tuning()


def gather(belief: Belief, innovation: Array, trouble: bool) -> None:
    """Add a message, once trouble has begun.

    Args:
        belief: `belief.troubled` is changed.
        innovation: (2n,) of positions and speeds.
        trouble: whether the message was refused or a surprise.
    """
    header = belief.header
    if not trouble and not header[Entry.GATHERED]:
        return
    header[Entry.CALM] = 0.0 if trouble else header[Entry.CALM] + 1.0
    if header[Entry.CALM] >= TUNING.over or header[Entry.GATHERED] >= TUNING.longest:
        forget(belief)
        return
    total, differences, last = belief.troubled
    total += innovation
    if header[Entry.GATHERED]:
        differences += (innovation - last) ** 2
    last[:] = innovation
    header[Entry.GATHERED] += 1.0


def forget(belief: Belief) -> None:
    """Forget trouble: it is over, explained, or the state was taken anew."""
    belief.header[[Entry.GATHERED, Entry.CALM]] = 0.0
    belief.troubled[:] = 0.0


def take_for_noise(belief: Belief, params: Filter, expected: Array) -> bool:
    """Find the arm's own noise anew from the messages since trouble began, where it explains them.

    Args:
        belief: its noise is changed where it does; where a message was believed for better than it was, its positions
            become as uncertain.
        params: tuning.
        expected: (2n,) variances of the newest message's innovation.

    Returns:
        Whether it does.
    """
    header, n = belief.header, belief.n
    count = float(header[Entry.GATHERED])
    if count < TUNING.fewest or header[Entry.ACCEPTED] < TUNING.known or params.noise_time <= 0.0:
        return False
    mean, scatter = belief.troubled[0] / count, belief.troubled[1] / (2.0 * (count - 1.0))
    level = belief.noise[:2].reshape(-1)
    known = np.square(np.repeat([params.encoder_std, params.velocity_std], n)) * np.exp(level)
    state = belief.P.diagonal()[: 2 * n]
    if np.any(mean**2 > TUNING.shifted**2 * (np.maximum(scatter, known) / count + state)):
        return False
    grown = (scatter > TUNING.grown * expected) & (level < WIDEST)
    if not grown[:n].any():
        return False
    found = np.maximum(scatter - (expected - known), known)
    level[grown] = np.minimum(level[grown] + np.log(found[grown] / known[grown]), WIDEST)
    if header[Entry.STREAK] < count:  # some were used
        at = np.flatnonzero(grown)
        belief.P[at, at] += (found - known)[grown]
    header[[Entry.COUNTED, Entry.STREAK]] = 0.0
    header[Entry.ALARM] = min(header[Entry.ALARM], belief.time)  # what held the noise was noise
    forget(belief)
    return True
