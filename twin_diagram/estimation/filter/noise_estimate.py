"""The filter finds out how noisy its sensors are, and how much torque its model lacks.

With u = S⁻¹ y, y the innovation of covariance S, the likelihood of R_ii rises where u_i² exceeds (S⁻¹)_ii, and both are
alike on average where R is right; for the white torque of joint j, of which a unit changes the reading by g_j, the same
holds of (g_jᵀ u)² and g_jᵀ S⁻¹ g_j. So each deviation takes a small step along its own likelihood after every reading,

    ln σ² ← ln σ² + ε w (min(u²/E[u²], cap) − 1),      ε = max(Δt / `Filter.noise_time`, eager / readings so far),

with w the share that σ² has in what is seen: what hardly shows is hardly moved. Δt is the time since the last reading,
of the arm's own the length of the newest prediction; cap and eager are those of `Tuning`. A sensor's first few hundred
readings count for more, so that its noise has settled before a drift monitor has learnt what is normal (the torque's do
not: what is yet to learn would pass for noise). Outliers are capped, and all stays within `WIDEST` of what was given.

**It stands still during an alarm**, lest the filter take a fault for noise: while one is reported from outside (see
`Ekf.hold_noise`), and by itself for `hold` after a refused message, a surprise or an opening. Where those go on, it is
the noise that is wrong: after each hold it is free as long as it was held, and follows as quickly as at first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram.estimation.filter.belief import Belief, Entry
from twin_diagram.estimation.filter.disturbance import TUNING as DISTURBANCE
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """How fast noise is learnt: chosen by hand.

    `tests/estimation/filter/test_noise_estimate.py` shows the noise found beside the noise put in.
    """

    cap: float = 9.0
    """A squared deviation counts as this many times its mean at most."""

    largest_step: float = 0.05
    """ε at most, at first and for sensors that read seldom."""

    eager: float = 4.0
    """ε is this over the readings so far while that is more. 1 would average them; but a variance that was given 25
    times too large must come down by its logarithm, 3, and a share w of a third still takes all readings for 1."""

    hold: float = 1.0
    """How long the adaptation stands still by itself [s]."""


TUNING = Tuning()
WIDEST: Final = 2.0 * np.log(10.0)
"""ln σ² moves no further than this from what was given: a tenth to ten times."""
_ENDS: Final = np.array([TUNING.cap, WIDEST])
"""Not to be changed."""


def held(belief: Belief, t: float, trouble: bool) -> bool:
    """Return whether the adaptation stands still at t [s]; trouble begins a hold where it was free as long."""
    last = float(belief.header[Entry.ALARM])
    if trouble and (last <= 0.0 or t >= last + TUNING.hold):
        belief.header[Entry.ALARM] = t + TUNING.hold
    return bool(t < belief.header[Entry.ALARM])


def gain(elapsed: float, span: float, readings: float) -> float:
    """Return ε of one reading.

    Args:
        elapsed: since the last one [s].
        span: `Filter.noise_time` [s].
        readings: of that sensor before this one.
    """
    return min(max(elapsed / span, TUNING.eager / (readings + TUNING.eager / TUNING.largest_step)), TUNING.largest_step)


def scaled(noise: Array, level: Array) -> Array:
    """Return R (m, m) with its deviations exp(level / 2) times as large.

    Args:
        noise: (m, m).
        level: (m,) ln of the variances' factors.
    """
    if not np.any(level):
        return noise
    factor = np.exp(0.5 * level)
    return noise * np.outer(factor, factor)


def follow_sensor(level: Array, noise: Array, inverse: Array, weighted: Array, step: Array | float) -> None:
    """Take one reading's word on a sensor's noise.

    Args:
        level: (m,) ln of the variances' factors, in place.
        noise: (m,) variances that they made.
        inverse: (m,) diagonal of S⁻¹.
        weighted: (m,) S⁻¹ y.
        step: ε, one or (m,).
    """
    share = noise * inverse
    surprise = np.minimum(weighted**2 / inverse, TUNING.cap) - 1.0
    level += step * share * surprise
    np.clip(level, -WIDEST, WIDEST, out=level)


def follow_torque(belief: Belief, by: Array, variance: Array, solved: Array, weighted: Array, step: float) -> None:
    """Take one message's word on the white torque that the model lacks; joints that creep or rest say nothing of it.

    Args:
        belief: `belief.noise[2]`, (n,), is changed.
        by: (m, n) of the message by a unit of torque on each joint.
        variance: (n,) of the white torque over the step [N²·m²].
        solved: (m, n) S⁻¹ by.
        weighted: (m,) S⁻¹ y.
        step: ε.
    """
    from twin_diagram.estimation.filter import noise_kernels  # compiled; not with every import

    moving = (belief.regime != 0.0) & (np.abs(belief.v) > 2.0 * DISTURBANCE.creep)
    by, solved = np.ascontiguousarray(by), np.ascontiguousarray(solved)
    noise_kernels.follow_torque(belief.noise[2], moving, by, variance, solved, weighted, step, _ENDS)
