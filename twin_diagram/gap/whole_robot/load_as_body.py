"""A payload as a body of its own, found by a last link that may be anything: mass, centre and moment of inertia.

A load is no point. On the last joint's axis a point has no inertia about it: where that joint's torque is quiet, what a
load of a decimetre has there moves a point off the axis, and makes it as much lighter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.payload import TUNING as PAYLOAD
from twin_diagram.gap.candidates.payload import payload_about, solid_about
from twin_diagram.gap.candidates.whole_arm import last_body, reach
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, known_spreads, solve
from twin_diagram.gap.whole_robot.physical_links import parameters
from twin_diagram.gap.whole_robot.unusual import with_candidate
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand on loads of 1.5 and 2.2 kg at a UR10-like arm's last axis."""

    usual: float = 0.06
    """Spread of the other links meanwhile, as in `loads`."""

    loose: float = 20.0
    """Times by which the last link may be further off than the others: a load is some times its mass."""

    rounds: int = 4
    """Times that each is fitted again from where it was: a step is bounded, and a centre's inertia linear about it."""

    solid: float = 2.0
    """Fall of the cost that a moment of inertia of its own must bring beside a last link as described [nats]."""


TUNING = Tuning()


def as_a_body(whole: RobotProblem, start: Array, terms: Terms) -> Candidate | None:
    """Return a payload about the centre that a loose last link has, solid where that matters; None where it cannot be.

    Args:
        whole: everything usual free, with its noise.
        start: its coordinates (Z,).
        terms: of the same samples.
    """
    near = replace(whole, spread=TUNING.usual if whole.told is None else max(known_spreads(whole.told)))
    last = last_body(terms)
    z, own = loose(near, start, last)
    own = np.append(own, abs(own[0]) * (PAYLOAD.solid * reach(terms)) ** 2)
    z[10 * last : 10 * last + 10] = near.links.mean[last]
    found: list[tuple[Candidate, float]] = []
    for solid in (True, False):
        for _ in range(TUNING.rounds):
            centre = own[1:4] / own[0] if own[0] > 0.0 else np.zeros(3)
            candidate = solid_about(terms, centre, own[0]) if solid else payload_about(terms, centre)
            own = own[: candidate.size]
            if not own[0] > 0.0 or not candidate.allows(own):
                return None if solid else found[0][0]
            beside = with_candidate(near, candidate, last)
            rest = z[: beside.place(len(beside.sums.further) - 1).start]
            fitted = solve(beside, None, np.concatenate([rest, own]))
            z, own = fitted[: len(rest)], fitted[len(rest) :]
        found.append((candidate, beside.cost(fitted, beside.sums.whole)))
    (body, its), (point, more) = found
    return body if more - its > TUNING.solid and near.links.heavy[last] else point


def loose(near: RobotProblem, start: Array, last: int) -> tuple[Array, Array]:
    """Return a fit (Z,) with a last link that may be anything, and (4,) how much heavier it is: m [kg] and m·c [kg·m].

    Args:
        near: everything usual free.
        start: its coordinates (Z,).
        last: index of the last link.
    """
    scale = near.links.scale.copy()
    scale[last] *= TUNING.loose
    free, z = replace(near, links=replace(near.links, scale=scale)), start
    for _ in range(TUNING.rounds):
        z = solve(free, None, z)
    more = parameters(z[10 * last : 10 * last + 10][None])[0] - near.links.described[last]
    return z.copy(), more[:4]
