"""What a joint that sticks tells: friction holds it, so the level at rest is at least the torque that it takes.

No law of speed explains the samples at which a joint sticks, and they are left out of the regression. Where friction
held more than its sliding level, though, that level rises at rest: Coulomb's law is refuted, and Stribeck's is offered.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.candidates.candidate import Candidate, transformed
from twin_diagram.gap.candidates.joint_candidate import single
from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.residuals import stiction
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.evidence import HypothesisFit
from twin_diagram.model.effects.friction import CoulombFriction
from twin_diagram.model.effects.friction_stribeck_load import StribeckFriction
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.stretches import stretches


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand.

    CHANGELOG.md says what evidence of a hold they gave on training cases of Coulomb's and Stribeck's friction;
    `make gap-benchmark ARGS="--suite training"` shows what they do.
    """

    more: float = 1.25
    """A hold must exceed the sliding level by this factor, and by `clearly` times the noise, to count."""

    clearly: float = 2.5
    """Standard deviations of the noise by which it must, too."""

    fewest_clear: int = 3
    """So many samples must say so."""

    mixed: float = 0.05
    """Share of a hold in a sample from which on it is looked at."""

    always: float = 0.375
    """What a sample brings by noise alone, one and a half times, were friction always at its most [nats]."""

    least: float = 3.0
    """Less is not worth saying [nats]."""

    fewest: int = 8
    """Peaks at least."""

    usual_speed: float = 0.05
    """Stribeck speed where nothing but the hold tells of one [rad/s]."""

    strongest: float = 60.0
    """Evidence that a hold brings at most [nats]."""

    overshoot: float = 1.1
    """Of the low-pass, beside a step."""

    largest: float = 0.85
    """Expected largest of three samples of noise [standard deviations]."""

    sure: float = 4.0
    """Peaks must rise by so many standard errors of their mean."""

    brief: int = 8
    """Thinned samples that a short stick lasts at most."""

    about: int = 3
    """Thinned samples before and after a stick that tell the direction of motion."""

    resting: int = 6
    """Thinned samples that a rest lasts at least to be averaged."""

    few_rests: int = 3
    """Rests at least that must hold more on average: one or two may be pushed."""

    held_more: float = 1.15
    """Times the sliding level that they must hold on average."""

    held_sure: float = 3.0
    """And beyond it by this many standard errors: Coulomb's law never holds more."""

    coloured: float = 2.0
    """Variance of a mean of neighbours, over that of as many samples that know nothing of each other."""

    edge: int = 2
    """Thinned samples at each end of a hold that the low-pass mixes with the motion before and after."""


TUNING = Tuning()


def propose(bench: Bench, terms: Terms, fit: HypothesisFit) -> list[int]:
    """Offer friction that rises at rest for every joint that was held by more than Coulomb's law would.

    Where a fit has that law, it is the same torque under Stribeck's name; where it has Stribeck's, that one, the surer.
    """
    made = []
    known = stiction.dry_joints(terms.records)  # the share that is known already holds too, and is not told apart
    for k in fit.members:
        candidate = bench.candidates[k]
        at = _coulomb(bench, k)
        if at is None or candidate.joints[0] in known or _drier(bench, fit, k):
            continue
        plain = bench.solve(fit.members - {k} | {at})
        level = float(np.mean(bench.part(plain, at)[0])) if np.isfinite(plain.evidence) else 0.0
        if level <= 0.0:
            continue
        rises = [ask(bench, terms, plain, at, level) for ask in (beyond, dwells, short_holds)]
        rise = max((some for some in rises if some is not None), key=lambda some: some[1], default=None)
        if rise is not None:
            static, evidence = rise[0], min(TUNING.strongest, rise[1])
            surer = replace(candidate, cost=candidate.cost - evidence, variant="held")
            made.append(bench.add(rising(terms, candidate, static / level, evidence) if at == k else surer))
    return made


def _coulomb(bench: Bench, k: int) -> int | None:
    """Coulomb's law in the place of one of the two, from the begin; none where holds have spoken already."""
    candidate = bench.candidates[k]
    if not record_of(candidate.name).holds or candidate.variant or candidate.onset is not None:
        return None
    places = [
        (i, bench.candidates[i])
        for i in (k, *bench.find(CoulombFriction.name))
        if bench.candidates[i].name == CoulombFriction.name
    ]
    return next((i for i, other in places if other.joints == candidate.joints and other.onset is None), None)


def _drier(bench: Bench, fit: HypothesisFit, k: int) -> bool:
    """Return whether another law of dry friction, which holds more where there is load, is on a member's joint."""
    joint = bench.candidates[k].joints[0]
    others = (bench.candidates[m] for m in fit.members - {k})
    return any(record_of(other.name).dry and joint in other.joints for other in others)


def beyond(bench: Bench, terms: Terms, fit: HypothesisFit, k: int, level: float) -> tuple[float, float] | None:
    """Return the level at rest and evidence for it where friction exceeds what Coulomb's law could hold at all.

    None: no rise.

    Beside a stick, the low-pass mixes what is held with what slides: how much that is at most is worked out.
    """
    noise = _noise(bench, fit, k)
    friction = _friction(bench, fit, k)
    slid, held = stiction.reach(terms.records, terms, bench.candidates[k].joints[0])
    about = held > TUNING.mixed
    size = np.abs(friction[about])
    most = level * np.maximum(np.sign(friction[about]) * slid[about] + held[about], 1.0)
    over = np.maximum(size - most, 0.0) / noise
    clear = (over > TUNING.clearly) & (size > TUNING.more * level)
    evidence = (0.5 * float(np.sum(over**2)) - TUNING.always * len(over)) / TUNING.coloured
    if np.sum(clear) < TUNING.fewest_clear or evidence < TUNING.least:
        return None
    return float(np.sort(size)[-TUNING.fewest_clear]), evidence


def dwells(bench: Bench, terms: Terms, fit: HypothesisFit, k: int, level: float) -> tuple[float, float] | None:
    """Return the same where noise hides each sample's rise, by the means over whole rests, which hold one torque."""
    noise = _noise(bench, fit, k)
    stuck = inner(stiction.stuck(terms.records, terms, bench.candidates[k].joints[0]))
    friction = _friction(bench, fit, k)
    rests = stretches(stuck)
    lengths = np.diff(rests, axis=1)[:, 0]
    rests, lengths = rests[lengths >= TUNING.resting], lengths[lengths >= TUNING.resting]
    if len(rests) < TUNING.few_rests:
        return None
    total = np.concatenate([[0.0], np.cumsum(friction)])
    held = np.abs(np.diff(total[rests], axis=1)[:, 0]) / lengths
    mean = float(np.mean(held))
    error = noise * float(np.sqrt(TUNING.coloured * np.mean(1.0 / lengths) / len(held)))
    if mean < TUNING.held_more * level or mean - level < TUNING.held_sure * error:
        return None
    return float(np.quantile(held, 0.9)), 0.5 * ((mean - level) / error) ** 2


def short_holds(bench: Bench, terms: Terms, fit: HypothesisFit, k: int, level: float) -> tuple[float, float] | None:
    """Return the same where a joint sticks for moments only: friction peaks before it lets go, and again when it turns.

    Coulomb's law has no peak there but for the low-pass's own overshoot and the largest of a few samples' noise.
    """
    noise = _noise(bench, fit, k)
    peaks = peaks_of(_friction(bench, fit, k), stiction.stuck(terms.records, terms, bench.candidates[k].joints[0]))
    rise = peaks - TUNING.overshoot * level - TUNING.largest * noise
    if len(rise) < TUNING.fewest:
        return None
    mean, error = float(np.mean(rise)), float(np.std(rise) / np.sqrt(len(rise)))
    if mean < (TUNING.more - 1.0) * level or mean < TUNING.sure * error:
        return None
    return float(np.median(peaks)) / TUNING.overshoot, 0.5 * (mean / max(error, 1e-9)) ** 2


def peaks_of(friction: Array, stuck: npt.NDArray[np.bool_]) -> Array:
    """Return the largest torques of friction in its old and in its new direction about each short stick.

    Two per stick.

    Args:
        friction: (R,) torque that friction takes [N·m].
        stuck: (R,) where the joint may be sticking.
    """
    result = []
    for first, last in stretches(stuck):
        before, after = friction[max(first - TUNING.about, 0) : first], friction[last : last + TUNING.about]
        if not len(before) or not len(after) or last - first > TUNING.brief:
            continue
        old, new = np.sign(np.mean(before)), np.sign(np.mean(after))
        if old == -new:
            about = friction[max(first - 1, 0) : last + 1]
            result += [float(np.max(old * about)), float(np.max(new * about))]
    return np.array(result)


def inner(stuck: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return (R,) the same without `EDGE` samples at each end of a stretch."""
    for _ in range(TUNING.edge):
        less = stuck.copy()
        less[1:] &= stuck[:-1]
        less[:-1] &= stuck[1:]
        stuck = less
    return stuck


def _friction(bench: Bench, fit: HypothesisFit, k: int) -> Array:
    """Return (ΣD,) torque that a member and what is left of the residual make together [N·m]."""
    candidate = bench.candidates[k]
    j = candidate.joints[0]
    return np.asarray(bench.left(fit)[:, j] + candidate.columns[:, candidate.rows.index(j)] @ bench.part(fit, k)[0])


def _noise(bench: Bench, fit: HypothesisFit, k: int) -> float:
    """Return the standard deviation of what is left of a member's joint where it moves [N·m]."""
    j = bench.candidates[k].joints[0]
    return float(np.std(bench.left(fit)[bench.whitener.rows, j][bench.weights[j] > 0.0]))


def rising(terms: Terms, coulomb: Candidate, ratio: float, evidence: float) -> Candidate:
    """Return Coulomb's torque under Stribeck's name: what tells them apart is how much held, worth so many nats."""
    j = coulomb.joints[0]

    def values(c: Array) -> dict[str, Array]:
        return {"coulomb": c[0:1], "static": ratio * c[0:1], "stribeck_velocity": np.array([TUNING.usual_speed])}

    made = single(
        terms,
        StribeckFriction.name,
        j,
        [terms.reduced_signs[:, j]],
        transformed(values),
        [0.0],
        cost=-evidence,
        variant="held",
    )
    assert made is not None
    return made
