"""When the parameters are taken over by the physics, and when an abrupt change makes them uncertain again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram.estimation.filter.base import Core
from twin_diagram.estimation.filter.belief import Entry
from twin_diagram.estimation.filter.fault_isolation import suspects
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """When θ is taken over, opened and given up: chosen by hand.

    `sims/benchmarks/adaptation.py` and `make hrt-tables` show how it is learnt.
    """

    quiet_time: float = 0.2
    """No second opening within this time [s]; so long a load may take to come or go. A can of 1 kg leaves opening
    fingers within 0.04 s, closing ones bear it after 0.1 to 0.15 s, and the arm swings as long."""

    refuted: float = 3.5
    """A parameter so many deviations of its prior from the prior's mean refutes it."""

    farthest: float = 0.05
    """Share of its prior's deviation by which a parameter may part from what the physics holds: beyond, the physics
    takes it over at once. Kilograms that are learnt within a few messages do not wait: linearised about no load at
    all, arm and wrench would seem to say more of it than they do, and falsely."""


TUNING = Tuning()

CHANGING: Final = 2.0
"""In `Belief.freed`, of what was opened and is to be opened once more when its change is over."""


def release(core: Core, t: float) -> None:
    """Let the physics take over what has been learnt, at the parameters' own rate, or at once where that is much.

    Args:
        core: its belief is changed.
        t: now [s].
    """
    belief, header, params = core.belief, core.belief.header, core.params
    far = bool(np.any(np.abs(belief.theta - belief.model) > TUNING.farthest * core.parameters.scale))
    if t < header[Entry.RELEASED] + 1.0 / params.parameter_rate - 1e-9 and not far:
        return
    header[Entry.RELEASED] = t
    if params.rule == "gradient":
        # θ ← θ − η ∇ of the squared innovation, in units of the prior: section 3.2, step 3.
        belief.theta += params.learning_rate * core.parameters.scale**2 * belief.gradient
        belief.gradient[:] = 0.0
        core.parameters.clip(belief.theta)
    belief.model[:] = belief.theta


def gather(core: Core, H: Array, weighted: Array) -> None:
    """Add a reading's share to the gradient: how the step that led to it depends on θ, times S⁻¹ y.

    Args:
        core: its belief is changed.
        H: (m, N) of the reading.
        weighted: (m,) S⁻¹ y.
    """
    n = core.terms.n
    by_theta = H[:, : 2 * n] @ core.F[: 2 * n, 3 * n : 3 * n + core.belief.p]
    core.belief.gradient += by_theta.T @ weighted


def open_up(core: Core, t: float) -> None:
    """Open after an abrupt change what recent innovations speak for: it may be anything again that `opening` allows.

    Args:
        core: its belief is changed.
        t: now [s].
    """
    belief = core.belief
    belief.header[Entry.OPENINGS] += 1
    belief.header[Entry.QUIET] = t + TUNING.quiet_time
    if core.params.rule == "gradient" or not belief.p:
        return
    changed = suspects(belief.score, core.parameters.groups)
    belief.freed[changed] = 1.0
    load = core.parameters.payload
    if load is not None:
        belief.freed[load] = np.where(changed[load], CHANGING, belief.freed[load])
    _open(core, changed)


def open_again(core: Core) -> None:
    """Open once more, when its time is over, what does not change at once: a load.

    What was learnt meanwhile is of a load on its way, and surely wrong of the one that is left: fingers that let go of
    1 kg told 0.1 kg too much within some messages, and for good, since nothing seemed to change any more.

    Args:
        core: its belief is changed.
    """
    belief, changing = core.belief, core.belief.freed == CHANGING
    if changing.any():
        belief.freed[changing] = 1.0
        belief.score[:] = 0.0  # what spoke for it is answered by this; `NIS_MEAN` also tells of noise, and goes on
        _open(core, changing)


def _open(core: Core, changed: np.ndarray) -> None:
    """Open the parameters (p,) that have changed."""
    belief, n = core.belief, core.terms.n
    at = slice(3 * n, 3 * n + belief.p)
    now, prior = belief.P[at, at], core.parameters.opening
    # Openings do not add up: none makes a parameter less certain than twice its prior.
    room = np.where(changed, np.sqrt(np.clip(2.0 - now.diagonal() / prior.diagonal(), 0.0, 1.0)), 0.0)
    now += prior * np.outer(room, room)
    # Before it was noticed, part of the change went into the disturbance: no joint that slides is in the regime that
    # was any more, so that the next prediction draws its own afresh.
    belief.regime *= 1.5
    belief.told[:] = 0.0
    core.history.opened(room)
    core.history.settle(belief.x, belief.P)


def refute(core: Core, t: float) -> None:
    """Give up a prior that readings have refuted; what was learnt beside it is learnt again.

    A parameter that lies many of its prior's deviations from the prior's mean is not as the prior says; but held by it,
    it leaves to others what it cannot explain itself, and they settle far from the truth and look sure. So it is opened
    as after an abrupt change, and the others begin anew at their prior; only a payload's mean is kept.

    Args:
        core: its belief is changed.
        t: now [s].
    """
    belief, parameters, n = core.belief, core.parameters, core.terms.n
    if core.params.rule == "gradient" or not parameters.freeable.any():
        return
    far = np.abs(belief.theta - parameters.mean) > TUNING.refuted * parameters.scale
    far &= parameters.freeable & (belief.freed == 0.0)
    if not far.any():
        return
    belief.header[Entry.OPENINGS] += 1
    belief.header[Entry.QUIET] = t + TUNING.quiet_time
    belief.freed[far] = 1.0
    at = slice(3 * n, 3 * n + belief.p)
    free = belief.freed > 0.0
    reset = ~free
    if parameters.payload is not None:
        reset[parameters.payload] = False
    belief.theta[reset] = parameters.mean[reset]
    belief.P[at, :], belief.P[:, at] = 0.0, 0.0
    belief.P[at, at] = np.where(np.outer(free, free), parameters.opening, 0.0)
    belief.P[at, at] += np.where(np.outer(~free, ~free), parameters.covariance, 0.0)
    belief.score[:] = 0.0
    belief.regime *= 1.5
    core.history.begin(belief.time, belief.x, belief.P)
