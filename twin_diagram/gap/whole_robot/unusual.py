"""What a robot has beyond what every arm lacks: catalogue effects beside links and joints' own terms.

Each is looked at to first order beside everything that was fitted; the best are then fitted in full. What is named must
make motion likelier that its fit has not seen, and be known to a third of its size.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.records import RECORDS, record_of
from twin_diagram.gap.candidates.whole_arm import last_body
from twin_diagram.gap.residuals.regressors import Terms, slow_speed
from twin_diagram.gap.whole_robot import estimates
from twin_diagram.gap.whole_robot.left_out import LeftOut, likelihood
from twin_diagram.gap.whole_robot.physical_fit import Chosen, RobotProblem, coupling, solve, with_noise
from twin_diagram.gap.whole_robot.pushes import pushes
from twin_diagram.gap.whole_robot.torque_equations import OWN, TorqueEquations
from twin_diagram.model.effects.actuation import TimeDelay, TorqueBias, TorqueConstant
from twin_diagram.model.effects.environment import ExternalForce, GravityTilt
from twin_diagram.model.effects.friction_stribeck_load import LoadDependentFriction
from twin_diagram.model.effects.inertia import Payload
from twin_diagram.model.effects.sensing import EncoderOffset
from twin_diagram.model.effects.transmission import JointSpring
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array

BEYOND = (
    GravityTilt.name,
    JointSpring.name,
    TorqueConstant.name,
    LoadDependentFriction.name,
    EncoderOffset.name,
    TimeDelay.name,
    ExternalForce.name,
)
"""Names that are looked for."""

COMMON = (TorqueConstant.name, LoadDependentFriction.name)
"""Of which many arms have some."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/gap_whole_robots.py` shows what they do."""

    gain: float = 12.0
    """Rise of the left-out log likelihood that a name must bring on all joints together [nats]."""

    common: float = 8.0
    """The same of what many arms have: gains that are off, and friction that grows with the load."""

    gains: float = 0.06
    """Motors' torque constants are off by the order of this."""

    shape: float = 1.0
    """The same of another shape of what is there already."""

    each: float = 1.5
    """The same of a coefficient beyond the first of a place."""

    screened: float = 0.2
    """Share of what a name must bring that it must bring to first order to be fitted in full: the colour of noise, of
    which it may be some itself, is in that still."""

    tried: int = 3
    """That are fitted in full in each round."""

    most: int = 4
    """That are named at most: so many things at once rather follow something that has no name."""

    sure: float = 0.3
    """No name where the standard error is more than this share of the value: of so many names some always suits."""

    edge: float = 0.05
    """Share beyond the least that a name can say, up to which it says nothing: logs themselves may lag by a sample."""

    beyond_own: float = 2.0
    """Times the last link's own doubt that a payload must weigh."""


TUNING = Tuning()


def terms_of(sums: TorqueEquations, model: Model) -> Terms:
    """Return what candidates are made of: joints transmit what a corrected model says.

    Not what is logged: its own size would explain any log.
    """
    records = sums.records
    load = tuple(model.inverse_dynamics(r.q, r.v, r.a, time=r.time) for r in records.records)
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
    last = last_body(terms)
    steady = [c for c in offered(terms, names) if not any(same(c, other) for other in problem.sums.further)]
    z = start
    left_out = LeftOut.of(problem, z)
    for _ in range(TUNING.most):
        pushed = ExternalForce.name in (c.name for c in problem.sums.further)
        there = steady + (pushes(problem, z, terms) if ExternalForce.name in names and not pushed else [])
        best = None
        for k in worth_trying(ReadyFits.of(left_out), there):
            tried = with_candidate(problem, there[k], last)
            fitted = solve(tried, None, carried(problem, z, tried))
            if there[k].name == ExternalForce.name:  # beside which the joints that it pushes are as quiet as others
                tried = with_noise(tried, fitted)
                fitted = solve(tried, None, fitted)
            found = LeftOut.of(tried, fitted)
            whiter = whitened(problem, with_noise(tried, fitted), there[k])
            gain = float(np.sum(likelihood(whiter, found.rms) - likelihood(whiter, left_out.rms))) - price(there[k])
            gain -= asked(problem, there[k])
            if gain > 0.0 and (best is None or gain > best[0]) and believable(tried):
                best = gain, tried, found, there[k]
        if best is None:
            break
        before = problem
        _, problem, left_out, added = best
        z = solve(problem, None, carried(before, z, problem))
        steady = [c for c in steady if c is not added]
        problem, z = recentred(problem, z, terms, last)
        left_out = LeftOut.of(problem, z)
    return still_needed(problem, z)


def worth_trying(beside: ReadyFits, there: list[Candidate]) -> list[int]:
    """Return which candidates are fitted in full: the best to first order, and pushes, which were looked for before.

    Args:
        beside: fits without them.
        there: candidates.
    """
    pushed = [k for k, c in enumerate(there) if c.name == ExternalForce.name]
    screened = [beside.gain(c) - price(c) - TUNING.screened * asked(beside.left_out.problem, c) for c in there]
    order = [int(k) for k in np.argsort(screened)[::-1] if screened[k] > 0.0 and k not in pushed][: TUNING.tried]
    return order + pushed


def recentred(problem: RobotProblem, z: Array, terms: Terms, last: int) -> tuple[RobotProblem, Array]:
    """Return the problem with its newest candidate about where it was found to be, if its law is no straight one."""
    newest = len(problem.sums.further) - 1
    candidate = problem.sums.further[newest]
    about = record_of(candidate.name).recentred
    nearer = about(terms, candidate, z[problem.place(newest)]) if about is not None else None
    if nearer is None or nearer.size != candidate.size:
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
            if candidate.name == Payload.name:
                continue
            whiter = whitened(problem, with_noise(problem, z), candidate)
            rest = [c for c in problem.sums.further if c is not candidate]
            fewer = replace(problem, sums=problem.sums.with_further(rest))
            left = LeftOut.of(fewer, solve(fewer, None, carried(problem, z, fewer))).rms
            lost = float(np.sum(likelihood(whiter, now.rms) - likelihood(whiter, left)))
            short.append((lost - price(candidate) - least(candidate), k))
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
    return TUNING.common if candidate.name in COMMON else TUNING.gain


def between(problem: RobotProblem, after: RobotProblem) -> RobotProblem:
    """Return the problem with the colour of noise half-way to that beside something more.

    Colour that a candidate takes away was no noise if it is there, and was if it is not.
    """
    return replace(problem, share=np.sqrt(problem.share * np.maximum(problem.share, after.share)))


def whitened(problem: RobotProblem, after: RobotProblem, candidate: Candidate) -> RobotProblem:
    """Return the problem with the colour of noise by which a candidate is judged.

    Args:
        problem: without it.
        after: with it, and the noise that is left.
        candidate: what is judged. A push alone lets a joint's residual hang together over all of its span: that is no
            noise, which went on before and after it.
    """
    if candidate.name == ExternalForce.name:
        return replace(problem, share=np.maximum(problem.share, after.share))
    return between(problem, after)


def price(candidate: Candidate) -> float:
    """Return what is asked of a candidate for its further coefficients, and for its times [nats]."""
    return TUNING.each * (candidate.size - 1) + (candidate.cost if candidate.onset is not None else 0.0)


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
        if TorqueBias.name in record_of(candidate.name).rivals:
            own[list(candidate.joints), OWN.index("bias")] = False
        if candidate.name == Payload.name:
            links[last] = False
    return links, own


def believable(problem: RobotProblem, at: int = -1) -> bool:
    """Return whether a further candidate can be, is known well enough, and is no doubt of the description.

    Args:
        problem: with it.
        at: which of the further ones.
    """
    z = solve(problem)
    at = at % len(problem.sums.further)
    candidate, s = problem.sums.further[at], problem.place(at)
    covariance = estimates.covariance(with_noise(problem, z), z)[s, s]  # what it explains is no noise
    least = (candidate.lower > 0.0) & (z[s] <= (1.0 + TUNING.edge) * candidate.lower)
    if not candidate.allows(z[s]) or np.any(least):  # no more than what is no effect at all
        return False
    if candidate.name == Payload.name:
        own, mass = estimates.own_doubt(problem), abs(z[s][0])
        return bool(mass > TUNING.beyond_own * own and np.hypot(np.sqrt(covariance[0, 0]), own) < TUNING.sure * mass)
    # A straight spring's level alone would be an offset.
    told = slice(0, 1) if candidate.name == JointSpring.name and not candidate.variant else slice(None)
    size, spread = z[s][told], covariance[told, told]
    return float(np.sqrt(size @ np.linalg.pinv(spread, hermitian=True) @ size / len(size))) > 1.0 / TUNING.sure


def without_doubtful(problem: RobotProblem) -> RobotProblem:
    """Return the problem without further candidates that are believable no more beside what came after them."""
    while True:
        doubtful = [k for k in range(len(problem.sums.further)) if not believable(problem, k)]
        if not doubtful:
            return problem
        kept = [c for k, c in enumerate(problem.sums.further) if k != doubtful[0]]
        problem = replace(problem, sums=problem.sums.with_further(kept))


@dataclass(frozen=True)
class ReadyFits:
    """Left-out fits to first order, ready for one candidate after the other.

    Attributes:
        left_out: the fits.
        moving: per kind of motion left out, which coordinates move.
        inverses: per kind, of the normal matrix of those.
        slopes: per kind (10 n, 10 n), of links' parameters by their coordinates.
        full: (F, n, K + 1) what each fit makes of the columns: less its parameters, and 1 for the residual.
    """

    left_out: LeftOut
    moving: list[npt.NDArray[np.int64]]
    inverses: list[Array]
    slopes: list[Array]
    full: Array

    @staticmethod
    def of(left_out: LeftOut) -> ReadyFits:
        """Make fits ready."""
        problem = left_out.problem
        moving = [np.flatnonzero(problem.free & (z > problem.lower)) for z in left_out.fits]
        inverses = []
        for some, (H, _) in zip(moving, left_out.systems, strict=True):
            inner = H[np.ix_(some, some)]
            scale = np.sqrt(np.diag(inner))
            inverses.append(np.linalg.inv(inner / np.outer(scale, scale)) / np.outer(scale, scale))
        full = [np.concatenate([-problem.difference(z), np.ones((problem.n, 1))], axis=1) for z in left_out.fits]
        return ReadyFits(left_out, moving, inverses, [problem.slope(z) for z in left_out.fits], np.stack(full))

    def gain(self, candidate: Candidate) -> float:
        """Return the rise of the left-out log likelihood that a candidate brings beside all that is free.

        Its columns are summed up once per kind of motion; what is fitted sees the sums alone.
        """
        problem, sums = self.left_out.problem, self.left_out.problem.sums
        crosses, owns = candidate_sums(sums, candidate)
        rows = list(candidate.rows)
        weight = (problem.share / problem.variance)[rows][:, None, None]
        squares = np.zeros(problem.n)
        prior = np.diag(candidate.spread**-2.0)
        for k, (some, inverse, slope, full) in enumerate(
            zip(self.moving, self.inverses, self.slopes, self.full, strict=True)
        ):
            cross, own = (np.sum(x, axis=0) - x[k] for x in (crosses, owns))
            cross = cross * weight
            B = coupling(problem, rows, slope, cross)[some]
            solved = inverse @ B
            S = np.sum(own * weight, axis=0) + prior - B.T @ solved
            right = np.einsum("jk,jkm->m", full[rows], cross)
            c = np.clip(np.linalg.lstsq(S, right, rcond=1e-9)[0], candidate.lower, candidate.upper)
            step = np.zeros(len(problem.mean))
            step[some] = solved @ c
            moved = full + settled(problem, slope, step)
            squares += np.sum((moved[:, None] @ sums.of_kinds[k])[:, 0] * moved, axis=1)
            mixed = np.einsum("jk,jkm,m->j", moved[rows], crosses[k], c)
            squares[rows] += np.einsum("m,jml,l->j", c, owns[k], c) - 2.0 * mixed
        rms = np.sqrt(np.maximum(squares, 1e-30) / sums.counted)
        return float(np.sum(likelihood(problem, rms)) - self.left_out.score())


def settled(problem: RobotProblem, slope: Array, step: Array) -> Array:
    """Return (n, K + 1) by which what a fit makes of the columns changes where coordinates go back by a step (Z,)."""
    n = problem.n
    links = np.broadcast_to(slope @ step[: 10 * n], (n, 10 * n))
    further = np.broadcast_to(step[14 * n :], (n, len(step) - 14 * n))
    own = step[10 * n : 14 * n].reshape(n, len(OWN))
    return np.concatenate([links, own, further, np.zeros((n, 1))], axis=1)


def candidate_sums(sums: TorqueEquations, candidate: Candidate) -> tuple[Array, Array]:
    """Return per kind of motion a candidate's products: with all columns (F, r, K + 1, k), and its own (F, r, k, k)."""
    rows = list(candidate.rows)
    kind = sums.fold[sums.stretch]
    weighted = candidate.columns * sums.weights[:, rows, None]
    cross, own = [], []
    for k in sums.kinds:
        some = kind == k
        mine = weighted[some].transpose(1, 0, 2)
        cross.append(sums.columns[some][:, rows].transpose(1, 2, 0) @ mine)
        own.append(candidate.columns[some].transpose(1, 2, 0) @ mine)
    return np.stack(cross), np.stack(own)
