"""What a problem of the whole robot says in the end: names that honest errors leave standing, and their model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.errors import ModelError
from twin_diagram.gap.candidates.payload import carried_always
from twin_diagram.gap.correction.merge_effects import merged
from twin_diagram.gap.correction.named_effects import specs_of
from twin_diagram.gap.findings import Finding, Separation
from twin_diagram.gap.residuals.prepared_logs import Records
from twin_diagram.gap.residuals.stiction import slides
from twin_diagram.gap.whole_robot import estimates
from twin_diagram.gap.whole_robot.believable import without_doubtful
from twin_diagram.gap.whole_robot.beside_dry import TUNING as BESIDE_DRY
from twin_diagram.gap.whole_robot.beside_dry import damped, largest_share, rubbing, told_beside
from twin_diagram.gap.whole_robot.beside_the_usual import offset_evidence, rise_beside_the_usual
from twin_diagram.gap.whole_robot.bounded_step import Chosen
from twin_diagram.gap.whole_robot.left_out import TUNING as LEFT_OUT
from twin_diagram.gap.whole_robot.left_out import LeftOut, Linearised, earning, free_units, likelihood, units
from twin_diagram.gap.whole_robot.physical_fit import RobotProblem, solve
from twin_diagram.gap.whole_robot.torque_equations import OWN
from twin_diagram.gap.whole_robot.unusual import price, room_for
from twin_diagram.gap.whole_robot.well_told import share_of, well_told
from twin_diagram.model.effects.actuation import TorqueBias, TorqueConstant
from twin_diagram.model.effects.link_inertia import InertialParameters
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `sims/benchmarks/real_rows.py` shows what they do."""

    gone: float = 1.0
    """What a name's weakest place brings where all of it is gone: it won over what is described [nats]."""

    matters: float = 3.0
    """Fall of the left-out log likelihood, for each name that is gone, from which on offsets are missed [nats]."""

    doubtful: float = 10.0
    """The same for what is unusual and known no better than to 0.7 of itself [nats]: of an LWR4+'s eight seconds a tilt
    and a spring that other motion bears out were missed by 20 a name, of a Panda's a tilt that it does not by 4.5."""

    unsure: int = 4
    """Times that what honest errors leave unsure is taken out."""

    likely: float = 0.5
    """Rise of the evidence, beside links and gains that may be off, that an offset which is known no better than to a
    third must bring to stay [nats]: one of 1.8 standard errors. Asked of all offsets it took true ones, too."""

    none: float = 1.0
    """Share of an offset from which on an error leaves nothing of it."""

    rough: float = 1.1
    """Times a third that an error may be: one that is told by five kinds of motion is itself known to a third."""

    third: float = 1.0 / 3.0
    """No name where the standard error is more than this share of the value, but for damping: see `beside_dry`."""


TUNING = Tuning()


@dataclass(frozen=True)
class WholeRobot:
    """What was found.

    Attributes:
        model: the given one with all of it.
        findings: relative to the given model.
        before: (n,) residual of the given model on the fit logs [N·m].
        fitted: (n,) of the corrected one.
        left: (n,) of fits that had not seen the kind of motion that they are judged on.
        problem: that was solved.
        coordinates: its solution.
        separation: of near pairs.
        along: how many links are there beside those that earned their place, see `with_all_links`.
    """

    model: Model
    findings: tuple[Finding, ...]
    before: Array
    fitted: Array
    left: Array
    problem: RobotProblem
    coordinates: Array
    separation: tuple[Separation, ...] = ()
    along: int = 0

    def terms(self) -> int:
        """Return how many links and joints earned their place, each name counted."""
        return sum(len(finding.joints) + len(finding.links) for finding in self.findings) - self.along

    def closes(self) -> float:
        """Return the share of the residual torque that is gone on motion that fits have not seen, mean over joints."""
        told = self.before > 0.0
        return float(np.mean(1.0 - np.minimum(self.left[told] / self.before[told], 1.0))) if np.any(told) else 0.0

    def links(self) -> int:
        """Return how many links earned their place."""
        return len({link for finding in self.findings for link in finding.links}) - self.along

    def places(self) -> int:
        """Return how many joints have something of their own."""
        return len({joint for finding in self.findings for joint in finding.joints})


def concluded(problem: RobotProblem) -> WholeRobot | None:
    """Return what a problem says once doubtful terms are out of it; None where nothing is left, or cannot be."""
    problem, z, spread = sure_ones(without_doubtful(problem))
    kept = earning(problem, LeftOut.of(problem, z))
    if np.any(free_units(kept) != free_units(problem)):
        problem, z, spread = sure_ones(kept)
    for beside in (rubbing, damped):
        more = beside(problem, z)
        if more is not problem:
            problem, z, spread = sure_ones(more)
    return said_of(problem, z, spread)


def well_known(found: WholeRobot) -> WholeRobot | None:
    """Return what was found without names that honest errors leave unsure; None where nothing is left.

    That comes last: what is unsure as long as something else has no name may be sure beside it. In a short log names
    trade with one another: what is not known to a third, but better than nothing at all would be, stays where left-out
    motion misses what is lost, no surer than its own error says. Offsets trade with what gravity makes of links, which
    no motion parts; they stay where evidence beside links and gains that may be off does not speak against them.
    """
    kept: set[tuple[str, str]] = set()
    for _ in range(TUNING.unsure):
        lost = lost_names(found.findings) - kept - told_beside(found.findings, TUNING.rough, found.problem)
        if not lost:
            break
        fewer = said_of(*sure_ones(without_names(found.problem, found.coordinates, lost)))
        offsets, rest = likely_offsets(found, lost), told_enough(found.findings, lost)
        missed = np.inf if fewer is None else missed_by(found, fewer) / len(lost)
        rest = rest if missed > TUNING.doubtful else set()
        if (offsets or rest) and missed > TUNING.matters:
            kept |= offsets | rest
            found = replace(found, findings=no_surer(found.findings, rest))
            continue
        if fewer is None:
            return None
        sure = {one.name: one.confidence for one in found.findings}  # each as sure as it was beside all of them
        findings = tuple(replace(one, confidence=min(one.confidence, sure[one.name])) for one in fewer.findings)
        found = replace(fewer, findings=findings, separation=found.separation)
    return found


def likely_offsets(found: WholeRobot, lost: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Return which of the lost names, each with its joint, are offsets that evidence beside links and gains speaks for.

    One that is smaller than its own error is none: it may as well have the other sign.

    Args:
        found: with them.
        lost: names that are known no better than to a third.
    """
    offsets = {one for one in lost if one[0] == TorqueBias.name}
    if not offsets:
        return offsets
    brought = dict(zip(found.model.joints, offset_evidence(found.problem, found.coordinates), strict=True))
    (there,) = [one for one in found.findings if one.name == TorqueBias.name]
    return {one for one in offsets if brought[one[1]] >= TUNING.likely and share_of(there, one[1]) < TUNING.none}


def told_enough(findings: Sequence[Finding], lost: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Return which of the lost names, each with its joint or an empty one, are nearer the truth than nothing would be.

    What is usual has rules of its own: offsets, see `likely_offsets`, and what stands beside dry friction. A gain that
    is near one, as they are, trades with all links' masses.
    """
    usual = {TorqueConstant.name, *(name for name, _ in estimates.NAMES.values())}
    beyond = {one.name: one for one in findings if one.name not in usual}
    most = TUNING.rough * BESIDE_DRY.most
    return {(name, joint) for name, joint in lost if name in beyond and share_of(beyond[name], joint) <= most}


def no_surer(findings: Sequence[Finding], kept: set[tuple[str, str]]) -> tuple[Finding, ...]:
    """Return findings of which those kept are no surer than that their size is not none, by their errors.

    Args:
        findings: any.
        kept: names, each with its joint or an empty one.
    """
    result = []
    for one in findings:
        t = np.array([1.0 / share_of(one, joint) for name, joint in kept if name == one.name])
        nats = 0.5 * (t**2 - 1.0) - np.log(t)  # see `offset_evidence`
        result.append(replace(one, confidence=float(np.min(1.0 / (1.0 + np.exp(-nats)), initial=one.confidence))))
    return tuple(result)


def missed_by(found: WholeRobot, fewer: WholeRobot) -> float:
    """Return by how much likelier left-out motion is with all that was found than with less of it [nats]."""
    return float(np.sum(likelihood(found.problem, found.left) - likelihood(found.problem, fewer.left)))


def said_of(problem: RobotProblem, z: Array, spread: Array) -> WholeRobot | None:
    """Return what a problem says.

    Args:
        problem: what was fitted.
        z: (Z,) its coordinates.
        spread: (Z, Z) their covariance, see `sure_ones`.
    """
    if not (np.any(problem.links_free) or np.any(problem.said) or problem.sums.further):
        return None
    given, left_out = problem.sums.records.model, LeftOut.of(problem, z)
    every, brought = every_beside(problem), what_each_brings(problem, left_out)
    wide, least = (estimates.beside_all(x, every, z) for x in (estimates.widened(spread, left_out.fits), spread))
    own = [float(brought[k][(k - problem.n) // len(OWN)]) if k in brought else 0.0 for k in own_units(problem)]
    spread = estimates.by_evidence(wide, least, z - problem.mean, np.reshape(own, (problem.n, len(OWN))))
    sure = confidences(
        problem, {**brought, **of_offsets(problem, z, brought), **of_drives(problem, brought), **of_loads(problem, z)}
    )
    found = estimates.findings(problem, z, spread, given, sure)
    fitted = np.sqrt(problem.squares(z, problem.sums.whole) / problem.sums.counted)
    model = corrected(given, found, [record.mark for record in problem.sums.records.records])
    if model is None:
        return None
    return WholeRobot(model, found, problem.sums.residual_rms, fitted, left_out.rms, problem, z)


def lost_names(found: Sequence[Finding]) -> set[tuple[str, str]]:
    """Return names, with the joint of each or an empty one, that honest errors leave unknown to a third of their size.

    Links are exempt: each of their base directions is known, or stays as described.
    """
    found = [one for one in found if one.name != InertialParameters.name]
    told = {one.name: one.joints for one in well_told(found, TUNING.rough)}
    lost = {(one.name, joint) for one in found for joint in one.joints if joint not in told.get(one.name, ())}
    return lost | {(one.name, "") for one in found if not one.joints and one.name not in told}


def without_names(problem: RobotProblem, z: Array, lost: set[tuple[str, str]]) -> RobotProblem:
    """Return the problem without joints' own terms and further candidates of some names, see `lost_names`."""
    joints = problem.sums.records.model.joints
    for j, term in np.argwhere(problem.said):
        if (estimates.name_of(problem, int(j), int(term)), joints[j]) in lost:
            problem = decided(problem, z, (int(j), int(term)))
    kept = [c for c in problem.sums.further if not {(c.name, joints[j]) for j in c.joints} & lost]
    kept = [c for c in kept if (c.name, "") not in lost]
    if len(kept) == len(problem.sums.further):
        return problem
    return replace(problem, sums=problem.sums.with_further(kept))


def last_of(problem: RobotProblem) -> int:
    """Return the index of the last link."""
    model = problem.sums.records.model
    return int(model.bodies.body_of(model.last_link)[0])


def every_beside(problem: RobotProblem) -> RobotProblem:
    """Return the problem with all that a robot may lack free: what has no name may still be there."""
    last = last_of(problem)
    own = own_terms(problem.sums.records) & room_for(problem.sums, last)[1] & ~problem.gone
    return replace(problem, links_free=problem.links.heavy, own_free=own | problem.own_free)


def own_terms(records: Records) -> Chosen:
    """Return (n, 4) which of joints' own terms there may be.

    Behind the gears no rotor shows, and a joint that never slides, but gives way a little as it is held, no damping.
    """
    there = np.tile([not (records.model.arm.link_side and term == "rotor") for term in OWN], (records.n, 1))
    there[:, OWN.index("viscous")] &= slides(records)
    return there


def corrected(given: Model, found: Sequence[Finding], marks: Sequence[str]) -> Model | None:
    """Return the given model with findings about runs of some fingerprints; None where they cannot be."""
    specs = [spec for finding in found for spec in specs_of(finding, marks)]
    try:
        return given.with_effects(merged(given.effects, specs))
    except ModelError:
        return None


def sure_ones(problem: RobotProblem) -> tuple[RobotProblem, Array, Array]:
    """Return the problem without joints' terms whose standard error is too large, its fit and covariance.

    Offsets that left-out motion misses stay, as in `well_known`: without them other terms stand in for them. Beside a
    payload they do not: what an offset holds may be the load's weight.
    """
    z, own = None, slice(10 * problem.n, 14 * problem.n)
    missed = np.zeros_like(problem.own_free)
    loaded = any(carried_always(candidate) for candidate in problem.sums.further)
    while True:
        share = largest_share(problem, TUNING.third)
        z = solve(problem, None, z)
        spread = estimates.covariance(problem, z)
        size = np.abs(z[own]).reshape(problem.n, len(OWN))
        error = np.sqrt(np.diag(spread)[own]).reshape(problem.n, len(OWN))
        held = z[own].reshape(size.shape) <= problem.least
        doubtful = problem.own_free & ~(held & problem.stated) & ((error > share * size) | (size == 0.0)) & ~missed
        if not np.any(doubtful):
            return problem, z, spread
        worst = np.unravel_index(int(np.argmax(np.where(doubtful, error / np.maximum(size, 1e-12), 0.0))), size.shape)
        fewer = decided(problem, z, (int(worst[0]), int(worst[1])))
        if worst[1] == OWN.index("bias") and not loaded:
            missed[worst] = LeftOut.of(problem, z).score() - LeftOut.of(fewer, z).score() > TUNING.matters
        if not missed[worst]:
            problem = fewer


def decided(problem: RobotProblem, z: Array, term: tuple[int, int]) -> RobotProblem:
    """Return the problem with a doubtful term as described, or, where left-out motion likes it better, all gone."""
    own, gone = problem.own_free.copy(), problem.gone.copy()
    own[term] = False
    as_described = replace(problem, own_free=own)
    if not problem.stated[term]:
        return as_described
    gone[term] = True
    without = replace(as_described, gone=gone)
    left = [LeftOut.of(some, z).likelihood()[term[0]] for some in (as_described, without)]
    return without if left[1] > left[0] else as_described


def own_units(problem: RobotProblem) -> range:
    """Return which of `units` are joints' own terms, in order."""
    return range(problem.n, problem.n * (1 + len(OWN)))


def what_each_brings(problem: RobotProblem, left_out: LeftOut) -> dict[int, Array]:
    """Return per free one of `units`, then per one of what is further there, what it brings (n,) [nats].

    That is by how much it makes left-out motion of each joint likelier.
    """
    linear, places = Linearised.of(left_out), np.arange(len(problem.mean))
    further = [np.isin(places, places[problem.place(at)]) for at in range(len(problem.sums.further))]
    parts = [*units(problem), *further]
    there = [k for k, part in enumerate(parts) if np.any(problem.free & part)]
    lost = linear.likelihood() - linear.likelihoods([parts[k] for k in there])
    return dict(zip(there, lost, strict=True))


def of_offsets(problem: RobotProblem, z: Array, brought: dict[int, Array]) -> dict[int, Array]:
    """Return what free offsets bring (n,) [nats], see `what_each_brings`: no more than evidence beside links and gains.

    Args:
        problem: with them.
        z: (Z,) its coordinates.
        brought: by what is free.
    """
    k = OWN.index("bias")
    free = np.flatnonzero(problem.own_free[:, k])
    most = offset_evidence(problem, z) if len(free) else np.zeros(problem.n)
    units = {int(j): problem.n + len(OWN) * int(j) + k for j in free}
    return {unit: np.minimum(brought[unit], most[j]) for j, unit in units.items() if unit in brought}


def of_loads(problem: RobotProblem, z: Array) -> dict[int, Array]:
    """Return what loads that are held for a while bring (n,) [nats]: left-out motion tells of none.

    That is the rise of the evidence beside everything usual, less the price of mass, centre and times.
    """
    sums, first = problem.sums, own_units(problem).stop
    held = {k: candidate for k, candidate in enumerate(sums.further) if candidate.spans}
    rises = {k: rise_beside_the_usual(problem, z, candidate) - price(candidate) for k, candidate in held.items()}
    return {first + k: np.full(problem.n, rise / problem.n) for k, rise in rises.items()}


def of_drives(problem: RobotProblem, brought: dict[int, Array]) -> dict[int, Array]:
    """Return what free dry friction brings (n,) [nats], see `what_each_brings`, where an arm's drives have it alike.

    Where all k joints that show it have it, odds that another one does are k + 1 to one (Laplace's rule of succession).
    """
    k = OWN.index("coulomb")
    drives = [problem.n + len(OWN) * j + k for j in range(problem.n)] if problem.rubs else []
    there = {(unit - problem.n) // len(OWN): brought[unit] for unit in drives if unit in brought}
    shown = sum(bool(lost[j] >= LEFT_OUT.own) for j, lost in there.items())
    return {problem.n + len(OWN) * j + k: np.maximum(lost, np.log(1.0 + shown)) for j, lost in there.items()}


def confidences(problem: RobotProblem, brought: dict[int, Array]) -> dict[str, float]:
    """Return per name how sure all its places are: as the weakest of them, by what it brings left-out motion."""
    n, own = problem.n, own_units(problem)
    weakest: dict[str, float] = {}
    for k, lost in brought.items():
        gain = float(np.sum(lost))
        if k < own.start:
            name = InertialParameters.name
        elif k in own:
            j, term = divmod(k - n, len(OWN))
            name, gain = estimates.name_of(problem, j, term), float(lost[j])
        else:
            name = problem.sums.further[k - own.stop].name
        weakest[name] = min(weakest.get(name, np.inf), gain)
    for j, term in np.argwhere(problem.gone):
        weakest.setdefault(estimates.name_of(problem, int(j), int(term)), TUNING.gone)
    for candidate in problem.sums.further:  # what acts for a while is weighed by itself
        weakest.setdefault(candidate.name, np.inf)
    return {name: float(1.0 / (1.0 + np.exp(-np.clip(gain, -30.0, 30.0)))) for name, gain in weakest.items()}
