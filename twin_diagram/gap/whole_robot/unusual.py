"""What a robot has beyond what every arm lacks: catalogue effects beside links and joints' own terms.

Each is looked at to first order beside everything that was fitted; the best are then fitted in full. What is named must
make motion likelier that its fit has not seen, and be known to a third of its size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.gravity_tilt import tilt
from twin_diagram.gap.candidates.payload import carried_always
from twin_diagram.gap.candidates.records import RECORDS, record_of
from twin_diagram.gap.candidates.whole_arm import last_body
from twin_diagram.gap.residuals.regressors import Terms, slow_speed
from twin_diagram.gap.whole_robot.believable import believable
from twin_diagram.gap.whole_robot.beside_the_usual import EVIDENT, rise_beside_the_usual
from twin_diagram.gap.whole_robot.beside_the_usual import TUNING as BESIDE
from twin_diagram.gap.whole_robot.bounded_step import Chosen
from twin_diagram.gap.whole_robot.colour_of_noise import quietest, whitened
from twin_diagram.gap.whole_robot.events import counted
from twin_diagram.gap.whole_robot.first_order import ReadyFits
from twin_diagram.gap.whole_robot.free_level import with_free_level
from twin_diagram.gap.whole_robot.held_loads import held_loads
from twin_diagram.gap.whole_robot.left_out import LeftOut, likelihood
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve, with_noise
from twin_diagram.gap.whole_robot.pushes import on_the_innermost, pushes
from twin_diagram.gap.whole_robot.torque_equations import OWN, TorqueEquations
from twin_diagram.gap.whole_robot.transmitted_torque import transmitted
from twin_diagram.model.effects.actuation import TorqueBias, TorqueConstant
from twin_diagram.model.effects.environment import ExternalForce, GravityTilt
from twin_diagram.model.effects.friction_stribeck_load import CoupledFriction, LoadDependentFriction
from twin_diagram.model.effects.sensing import EncoderOffset
from twin_diagram.model.effects.transmission import JointSpring
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array

BEYOND = (
    GravityTilt.name,
    JointSpring.name,
    TorqueConstant.name,
    LoadDependentFriction.name,
    CoupledFriction.name,
    EncoderOffset.name,
    ExternalForce.name,
)
"""Names that are looked for, beside delays: see `evident`."""

COMMON = (TorqueConstant.name, LoadDependentFriction.name)
"""Of which many arms have some."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    gain: float = 12.0
    """Rise of the left-out log likelihood that a name must bring on all joints together [nats]."""

    common: float = 8.0
    """The same of what many arms have: gains that are off, and friction that grows with the load."""

    gains: float = 0.03
    """Motors' torque constants are off by this, one standard deviation, as in `beside_the_usual`. Links that are off
    pass for gains: with 0.06, of eight that were named on 55 arms of training six were said 1.3 to 2.4 times as far
    off as they are, and one is not off."""

    mistaken: float = 3.0
    """Such deviations beyond which a constant is no motor's tolerance, but a mistake, and may be anything."""

    event: float = 8.0
    """The same of what acts for a while, beyond the price of when: on all motion, as none that is left out tells of
    it."""

    shifted: float = 30.0
    """What an encoder's offset must bring beside everything usual [nats]: it does little but what links' centres and
    tilts do. On a Panda such offsets bring up to 24, on one part of a log and not on another."""

    rather: float = 0.5
    """Share of what an event brings that something which is always there must bring to go before it."""

    shape: float = 1.0
    """The same of another shape of what is there already."""

    each: float = 1.5
    """The same of a coefficient beyond the first of a place."""

    screened: float = 0.2
    """Share of what a name must bring that it must bring to first order to be fitted in full: the colour of noise, of
    which it may be some itself, is in that still."""

    rounds: int = 3
    """Times that a gain is put on what its joint transmits, and a tilt is looked for about where it was found: of a
    gain of 1.2, a third of a percent is left."""

    tried: int = 3
    """That are fitted in full in each round."""

    most: int = 4
    """That are named at most: so many things at once rather follow something that has no name."""


TUNING = Tuning()


def terms_of(sums: TorqueEquations, model: Model) -> Terms:
    """Return what candidates are made of: joints transmit what a corrected model says.

    Not what is logged: its own size would explain any log.
    """
    records = sums.records
    load = tuple(model.for_run(r.mark).inverse_dynamics(r.q, r.v, r.a, time=r.time) for r in records.records)
    return Terms(records, load, slow_speed(records))


def offered(terms: Terms, names: tuple[str, ...] = BEYOND) -> list[Candidate]:
    """Return the candidates of some names: one per place and variant."""
    result: list[Candidate] = []
    for name in names:
        record = RECORDS[name]
        if record.on_joints is not None:
            result += [candidate for each in record.on_joints(terms) for candidate in each]
        if record.on_arm is not None:
            result += record.on_arm(terms)
    result = [c for c in result if c.variant != "bulky"]
    return [replace(c, spread=0.0 * c.spread + TUNING.gains) if c.name == TorqueConstant.name else c for c in result]


def unusual(problem: RobotProblem, start: Array, model: Model, names: tuple[str, ...] = BEYOND) -> RobotProblem:
    """Return the problem with what is unusual, best first, as long as it earns its place.

    Args:
        problem: with links and joints' own terms chosen.
        start: its coordinates (Z,).
        model: with them.
        names: that are looked for.
    """
    terms = terms_of(problem.sums, model)
    last, offsets = last_body(terms), offered(terms, (TorqueBias.name,))
    level = problem.own_deviation[:, OWN.index("bias")]
    there = [with_free_level(c, level[c.joints[0]]) if c.variant == "curve" else c for c in offered(terms, names)]
    steady = [c for c in there if not any(same(c, other) for other in problem.sums.further)]
    z = start
    problem, z = pushed_rightly(problem, z, terms)
    for _ in range(TUNING.most):
        left_out = LeftOut.of(problem, z)
        pushed = ExternalForce.name in (c.name for c in problem.sums.further)
        events = [] if ExternalForce.name not in names else held_loads(problem, z, terms)
        there = steady + events + (pushes(problem, z, terms) if ExternalForce.name in names and not pushed else [])
        tried = [
            weighed(problem, z, left_out, there[k], last) for k in worth_trying(ReadyFits.of(left_out), there, offsets)
        ]
        best = likeliest([one for one in tried if one is not None])
        if best is None:
            break
        z = solve(best.problem, None, carried(problem, z, best.problem))
        problem = best.problem
        steady = [c for c in steady if c is not best.candidate]
        problem, z = recentred(problem, z, terms, last)
    return still_needed(problem, z)


@dataclass(frozen=True)
class Weighed:
    """A candidate that earns its place.

    Attributes:
        candidate: it.
        problem: with it.
        gain: in left-out log likelihood, beyond what is asked of it [nats].
        loud: the same where all colour that it takes away was no noise, as it is counted for an event [nats].
    """

    candidate: Candidate
    problem: RobotProblem
    gain: float
    loud: float


def weighed(problem: RobotProblem, z: Array, left_out: LeftOut, candidate: Candidate, last: int) -> Weighed | None:
    """Fit a candidate beside a problem; None where it does not earn its place, or is not to be believed.

    Args:
        problem: without it.
        z: (Z,) its coordinates.
        left_out: its fits.
        candidate: what is weighed.
        last: index of the last link.
    """
    tried = with_candidate(problem, candidate, last)
    fitted = solve(tried, None, carried(problem, z, tried))
    if candidate.passing:  # beside which the joints that it pushes are as quiet as others
        tried = with_noise(tried, fitted)
        fitted = solve(tried, None, fitted)
    rms, after = LeftOut.of(tried, fitted).rms, with_noise(tried, fitted)
    due, before = price(candidate) + asked(problem, candidate), [left_out.rms, *beside_rivals(problem, z, candidate)]
    gain, loud = (
        float(np.sum(likelihood(judge, rms)) - max(np.sum(likelihood(judge, one)) for one in before)) - due
        for judge in (whitened(problem, after, candidate), quietest(problem, after))
    )
    if gain <= 0.0 or not believable(tried):
        return None
    if stands_by(candidate) and rise_beside_the_usual(problem, z, candidate) < stands_by(candidate):
        return None
    return Weighed(candidate, tried, gain, loud)


def beside_rivals(problem: RobotProblem, z: Array, candidate: Candidate) -> list[Array]:
    """Return (n,) what left-out motion leaves where what a candidate takes the place of is there instead [N·m].

    What earned no place by itself may have been weighed beside something that stood in for it: a spring's level is an
    offset, and is no reason for a spring. Empty where nothing is displaced that is not there already.

    Args:
        problem: without the candidate.
        z: (Z,) its coordinates.
        candidate: what is weighed.
    """
    own = problem.own_free | displaced(candidate, problem.n)
    if np.array_equal(own, problem.own_free):
        return []
    rival = replace(problem, own_free=own)
    return [LeftOut.of(rival, solve(rival, None, z)).rms]


def stands_by(candidate: Candidate) -> float:
    """Return what a candidate must bring beside everything usual [nats]; 0 where left-out motion alone judges it."""
    if candidate.passing:
        return price(candidate) + TUNING.event
    if candidate.name in EVIDENT:
        return BESIDE.evident
    if candidate.name == JointSpring.name and candidate.variant:  # a curve bends to what friction does about its turns
        return BESIDE.evident + price(candidate)
    return TUNING.shifted if candidate.name == EncoderOffset.name else 0.0


def likeliest(there: Sequence[Weighed]) -> Weighed | None:
    """Return the candidate to add: of what is always there and an event, the latter where it brings much more.

    What is always there bends over any span, and a push there passes for it; beside it, the push is weighed again.
    """
    best = max(there, key=lambda one: one.gain, default=None)
    if best is None or not best.candidate.passing:
        return best
    rivals = [one for one in there if not one.candidate.passing and one.loud > TUNING.rather * best.gain]
    return max(rivals, key=lambda one: one.loud, default=best)


def pushed_rightly(problem: RobotProblem, z: Array, terms: Terms) -> tuple[RobotProblem, Array]:
    """Return the problem with its push, if it has one, on the innermost link that suffices beside all else."""
    for push in [c for c in problem.sums.further if c.name == ExternalForce.name and c.passing]:
        fewer = replace(problem, sums=problem.sums.with_further([c for c in problem.sums.further if c is not push]))
        there = on_the_innermost(fewer, solve(fewer, None, carried(problem, z, fewer)), terms, push)
        if not same(there, push):
            rest = fewer.sums.further
            problem = replace(problem, sums=problem.sums.with_further([*rest, there]))
            z = solve(problem, None, np.concatenate([carried(problem, z, fewer), np.zeros(there.size)]))
    return problem, z


def worth_trying(beside: ReadyFits, there: list[Candidate], offsets: list[Candidate]) -> list[int]:
    """Return which candidates are fitted in full: the best to first order, and pushes, which were looked for before.

    Args:
        beside: fits without them.
        there: candidates.
        offsets: of joints, of which some of the candidates take the place.
    """
    problem, pushed = beside.left_out.problem, [k for k, c in enumerate(there) if c.passing]
    bare = ~problem.own_free[:, OWN.index("bias")]
    level = {c.joints: max(beside.gain(c), 0.0) for c in offsets if bare[c.joints[0]]}
    instead = [level.get(c.joints, 0.0) if np.any(displaced(c, problem.n)) else 0.0 for c in there]
    screened = [
        beside.gain(c) - less - price(c) - TUNING.screened * asked(problem, c)
        for c, less in zip(there, instead, strict=True)
    ]
    order = [int(k) for k in np.argsort(screened)[::-1] if screened[k] > 0.0 and k not in pushed][: TUNING.tried]
    return order + pushed


def recentred(problem: RobotProblem, z: Array, terms: Terms, last: int) -> tuple[RobotProblem, Array]:
    """Return the problem with its newest candidate about where it was found to be, if its law is no straight one."""
    newest = len(problem.sums.further) - 1
    candidate = problem.sums.further[newest]
    found = z[problem.place(newest)]
    about = record_of(candidate.name).recentred
    nearer = about(terms, candidate, found) if about is not None else None
    if candidate.passing:  # which was looked for about where it is
        return problem, z
    if candidate.name == TorqueConstant.name:
        mistaken = np.all(np.abs(found) > TUNING.mistaken * candidate.spread)
        nearer = replace(candidate, spread=np.abs(found)) if mistaken else candidate
        for _ in range(TUNING.rounds):
            (joint,) = candidate.joints
            load = transmitted(problem, z, joint)[:, None, None]
            problem = with_candidate(problem, replace(nearer, columns=load), last)
            z = solve(problem, None, z)
        return problem, z
    if nearer is None or nearer.size != candidate.size:
        return problem, z
    if nearer.name == GravityTilt.name:
        for _ in range(TUNING.rounds):
            there = z[problem.place(newest)]
            problem = with_candidate(problem, tilt(terms, there), last)
            problem = replace(problem, sums=problem.sums.on_base((float(there[0]), float(there[1]))))
            z = solve(problem, None, z)
        return problem, z
    moved = with_candidate(problem, nearer, last)
    return moved, solve(moved, None, z)


def still_needed(problem: RobotProblem, z: Array) -> RobotProblem:
    """Return the problem without further candidates that earn their place no more beside what came after them.

    Args:
        problem: with all of them.
        z: (Z,) its coordinates.
    """
    while len(problem.sums.further) > 1:
        now, short = LeftOut.of(problem, z), []
        for k, candidate in enumerate(problem.sums.further):
            if carried_always(candidate):
                continue
            whiter = whitened(problem, with_noise(problem, z), candidate)
            rest = [c for c in problem.sums.further if c is not candidate]
            fewer = replace(problem, sums=problem.sums.with_further(rest))
            plain = solve(fewer, None, carried(problem, z, fewer))
            left = [LeftOut.of(fewer, plain).rms, *beside_rivals(fewer, plain, candidate)]
            lost = float(np.sum(likelihood(whiter, now.rms)) - max(np.sum(likelihood(whiter, one)) for one in left))
            margin = lost - price(candidate) - least(candidate)
            if margin < 0.0 and candidate.name in EVIDENT:
                margin = rise_beside_the_usual(problem, z, candidate) - stands_by(candidate)
            short.append((margin, k))
        if not short or min(short)[0] >= 0.0:
            break
        weakest = min(short)[1]
        rest = [c for k, c in enumerate(problem.sums.further) if k != weakest]
        fewer = replace(problem, sums=problem.sums.with_further(rest))
        problem, z = fewer, solve(fewer, None, carried(problem, z, fewer))
    return problem


def carried(before: RobotProblem, z: Array, after: RobotProblem) -> Array:
    """Return coordinates to begin a problem from, of one with other further candidates."""
    old = {id(c): z[before.place(k)] for k, c in enumerate(before.sums.further)}
    more = [old.get(id(c), np.zeros(c.size)) for c in after.sums.further]
    return np.where(after.free, np.concatenate([z[: 14 * before.n], *more]), after.mean)


def same(a: Candidate, b: Candidate) -> bool:
    """Return whether two candidates say the same."""
    return a.place == b.place and a.variant == b.variant and a.size == b.size


def asked(problem: RobotProblem, candidate: Candidate) -> float:
    """Return what a candidate must bring beyond its price [nats]: a name, or another shape of one that is there."""
    there = any(candidate.place == other.place for other in problem.sums.further)
    return TUNING.shape if there else least(candidate)


def least(candidate: Candidate) -> float:
    """Return what a name must bring: of what is common, less [nats]."""
    if candidate.passing:
        return TUNING.event
    return TUNING.common if candidate.name in COMMON else TUNING.gain


def price(candidate: Candidate) -> float:
    """Return what is asked of a candidate for its further coefficients, and for its times [nats]."""
    return TUNING.each * (counted(candidate) - 1) + (candidate.cost if candidate.passing else 0.0)


def with_candidate(problem: RobotProblem, candidate: Candidate, last: int) -> RobotProblem:
    """Return the problem with a candidate more, or in the place of another of the same name, and without its rivals."""
    others = [c for c in problem.sums.further if c.place != candidate.place]
    sums = problem.sums.with_further([*others, candidate])
    links, own = room_for(sums, last)
    return replace(problem, sums=sums, own_free=problem.own_free & own, links_free=problem.links_free & links)


def room_for(sums: TorqueEquations, last: int) -> tuple[Chosen, Chosen]:
    """Return which links (n,) and joints' own terms (n, 4) may be there beside the further candidates."""
    links, own = np.ones(sums.n, dtype=bool), np.ones((sums.n, len(OWN)), dtype=bool)
    for candidate in sums.further:
        own &= ~displaced(candidate, sums.n)
        if carried_always(candidate):
            links[last] = False
    return links, own


def displaced(candidate: Candidate, n: int) -> Chosen:
    """Return (n, 4) which of n joints' own terms a candidate takes the place of."""
    result = np.zeros((n, len(OWN)), dtype=bool)
    if TorqueBias.name in record_of(candidate.name).rivals:
        result[list(candidate.joints), OWN.index("bias")] = True
    return result
