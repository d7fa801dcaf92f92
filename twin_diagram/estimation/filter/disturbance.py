"""The torque that the model does not know of, and why a filter must not learn what the motion does not excite.

Besides white noise, each joint carries a disturbance torque d, above all the error of its friction model.

- A joint that **rests** may hold back any torque up to the level F of its stiction. Its d is one unknown constant of
  standard deviation F that follows whatever the controller does below stiction and is never drawn back: the resting arm
  tells its load to within stiction, once, and however long it rests nothing more is learnt, since nothing averages out.
- A joint that **slides** has a small d, a share of F and `Filter.torque_drift_std`, that is forgotten over
  `Filter.torque_drift_time`. Where it turns out to be smaller still, that is learnt: see `follow_disturbance`.
- When a joint starts, stops or turns round, d is drawn afresh and no longer correlated with anything.

A joint slides when its low-passed speed exceeds `Filter.excitation`, or what the velocity sensor's noise can make of
rest where that is more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import erf

from twin_diagram.estimation.filter.belief import Belief
from twin_diagram.model.effects.friction import CoulombFriction
from twin_diagram.scenario import Filter
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """How wrong a model of friction is, and when a joint slides: chosen by hand.

    `make hrt-tables` shows the filter's consistency, which hangs on them.
    """

    friction_share: float = 0.15
    """Standard deviation of a sliding joint's friction error, as a share of its dry friction."""

    learnt_share: float = 0.05
    """The same where its level is learnt: what is left is its dependence on speed, load and angle."""

    creep: float = 0.025
    """Below this speed dry friction may hold a joint or let it go at any moment [rad/s]."""

    creep_share: float = 1.0
    """Standard deviation of friction then, from one message to the next, as a share of its level."""

    unsure: float = 2.0
    """Deviations of a speed within which it may be none."""

    stiction_time: float = 0.1
    """In this time the torque on a resting joint may change by the level of its stiction [s]."""

    speed_time: float = 0.02
    """Time over which speeds and accelerations are low-passed [s]."""

    largest: float = 9.0
    """The square of d counts as this many times its mean at most."""

    memory: float = 30.0
    """Independent values of d over which its variance is averaged at most."""

    sure: float = 2.0
    """A joint slides when its low-passed speed is this many standard deviations of the velocity sensor. A resting joint
    that seemed to slide for a moment would tell its load as if friction were known, and falsely."""


TUNING = Tuning()


SMALLEST: Final = -2.0 * np.log(10.0)
"""ln of its variance's factor falls no lower."""
_ENDS: Final = np.array([TUNING.largest, TUNING.memory, SMALLEST])
"""Not to be changed."""


def disturbance_std(params: Filter, sliding: Array, level: Array) -> Array:
    """Return the standard deviation of d (n,) [N·m].

    Args:
        params: tuning.
        sliding: (n,) whether each joint slides.
        level: (n,) of its dry friction [N·m].
    """
    share = TUNING.learnt_share if CoulombFriction.name in params.parameters else TUNING.friction_share
    return np.hypot(params.torque_drift_std, np.where(sliding, share, 1.0) * level)


def follow_disturbance(belief: Belief, params: Filter, variance: Array, elapsed: float) -> None:
    """Learn how large d is on joints that slide: the mean of its posterior square, beside one value as was given.

    Where the readings say nothing of d its square is as large as was thought, and nothing is learnt. It is never
    thought larger than was given: a push that goes on must not become normal.

    Args:
        belief: `belief.steady` and `belief.told` are changed.
        params: tuning.
        variance: (n,) of d as given [N²·m²].
        elapsed: length of the newest prediction [s].
    """
    n = belief.n
    at = np.arange(2 * n, 3 * n)
    # Of a d that is told to be none nothing can be learnt.
    sliding = (belief.regime != 0.0) & (np.abs(belief.v) > 2.0 * TUNING.creep)
    square, fresh = belief.disturbance**2 + belief.P[at, at], elapsed / params.torque_drift_time
    from twin_diagram.estimation.filter import noise_kernels  # compiled; not with every import

    noise_kernels.follow_disturbance(belief.steady, belief.told, sliding, square, variance, fresh, _ENDS)


def creep_std(v: Array, level: Array, variance: Array | float = 0.0) -> Array:
    """Return the white torque (n,) of joints that creep, or may for all that is known, beside the unmodelled one [N·m].

    Args:
        v: (n,) [rad/s].
        level: (n,) of dry friction [N·m].
        variance: (n,) of v: without encoders the sign of a slow joint's friction is anybody's guess [rad²/s²].
    """
    return TUNING.creep_share * level * np.exp(-(v**2) / (TUNING.creep**2 + TUNING.unsure**2 * variance))


def sure_to_slide(belief: Belief) -> Array:
    """Return how sure it is (n,) that a joint slides, and which way: mean of its speed's sign, 0 for one that rests."""
    n = belief.n
    deviation = np.sqrt(2.0 * np.maximum(belief.P.diagonal()[n : 2 * n], np.finfo(float).tiny))
    return np.where(belief.regime != 0.0, erf(np.abs(belief.v) / deviation), 0.0)


def follow_regimes(belief: Belief, params: Filter, dt: float, level: Array) -> tuple[Array, Array, Array]:
    """Decide which joints slide, and which forget their d since they started, stopped or turned round.

    Args:
        belief: its speeds and regimes are brought up to date.
        params: tuning.
        dt: of the prediction to come [s].
        level: (n,) of dry friction [N·m].

    Returns:
        How much of d is kept over the prediction (n,), the variance that it gains (n,), and whether it is drawn afresh
        (n,), no longer correlated with anything.
    """
    belief.drift += min(dt / TUNING.speed_time, 1.0) * (belief.v - belief.drift)
    # Half as fast is still sliding for a joint that slides: noise must not toggle it.
    threshold = max(params.excitation, TUNING.sure * params.velocity_std) * np.where(belief.regime != 0.0, 0.5, 1.0)
    regime = np.where(np.abs(belief.drift) > threshold, np.sign(belief.drift), 0.0)
    changed = regime != belief.regime
    belief.regime[:] = regime
    sliding = regime != 0.0
    std = disturbance_std(params, sliding, level) * np.where(sliding, np.exp(0.5 * belief.steady), 1.0)
    forget = np.exp(-dt / params.torque_drift_time)
    keep = np.where(changed, 0.0, np.where(sliding, forget, 1.0))
    fresh = np.where(sliding, (1.0 - forget**2) * std**2, std**2 * (dt / TUNING.stiction_time))
    if changed.any():
        fresh[changed] = std[changed] ** 2
    return keep, fresh, changed
