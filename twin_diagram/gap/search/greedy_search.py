"""Search for the hypothesis of most evidence: forward, backward and swap steps from many starts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.candidates.records import EffectRecord, records
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.evidence import HypothesisFit, Members
from twin_diagram.gap.search.prior_costs import TUNING as PRIOR_COSTS
from twin_diagram.gap.search.prior_costs import asked
from twin_diagram.gap.search.scoring import score_candidates


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    tried: int = 8
    """Additions that are solved exactly at each step."""

    starts: int = 5
    """First members that are tried beside the best one."""

    budget: int = 4_000_000
    """Members of all hypotheses solved on a bench, times its samples, after which the best is kept: nothing simple
    fits."""

    narrowed: int = 3
    """Times that joints whose coefficient is not physical are left out of a name that was said of all."""

    crowded: int = 6
    """With more members, nothing new is proposed for swaps."""

    promising: float = 0.3
    """A first member must bring this share of what the best one does."""


TUNING = Tuning()


Propose = Callable[[Bench, Members], list[int]]
"""Makes further candidates (ripples, onsets) that suit what a hypothesis leaves; answers their indices."""


Polish = Callable[[Bench, HypothesisFit], HypothesisFit]
"""Moves a hypothesis's shapes and working points to where the data want them."""


def search(
    bench: Bench, least: float = 3.0, most: int = 40, propose: Propose | None = None, polish: Polish | None = None
) -> HypothesisFit:
    """Climb from the empty hypothesis and from each of its best first members.

    Args:
        bench: data and candidates.
        least: rise of the evidence, beyond all prices, that a further member must bring [nats].
        most: members.
        propose: see `Propose`.
        polish: see `Polish`.
    """
    empty: Members = frozenset()
    best = climb(bench, empty, least, most, propose, polish)
    for start in _starts(bench):
        if start in best.members:
            continue
        found = climb(bench, frozenset({start}), least, most, propose, polish)
        if found.evidence > best.evidence:
            best = found
    return best


def _starts(bench: Bench) -> list[int]:
    scores = score_candidates(bench, frozenset())
    order = np.argsort(scores)[::-1]
    result: list[int] = []
    places = set()
    for k in order:
        candidate = bench.candidates[k]
        if not candidate.name or not np.isfinite(scores[k]) or scores[k] < PRIOR_COSTS.new_name:
            continue
        if scores[k] < TUNING.promising * scores[order[0]]:
            break
        # One start per name is enough for single joints; effects of the whole arm are rivals to sets of those.
        key = candidate.place if len(candidate.rows) > 1 else candidate.name
        if key in places:
            continue
        places.add(key)
        result.append(int(k))
        if len(result) == TUNING.starts:
            break
    return result


def climb(
    bench: Bench,
    start: Members,
    least: float,
    most: int,
    propose: Propose | None = None,
    polish: Polish | None = None,
) -> HypothesisFit:
    """Add, drop and swap members until nothing raises the evidence."""
    fit = bench.solve(start)
    if polish is not None:
        fit = polish(bench, fit)
    for _ in range(2 * most):
        if bench.solver.spent > TUNING.budget / bench.rows:
            return fit
        step = _drop(bench, fit)
        if step is None and len(fit.members) < most:
            step = _add(bench, fit, least, propose)
        if step is None:
            step = _swap(bench, fit, propose)
        if step is None:
            return fit
        fit = step if polish is None else polish(bench, step)
    return fit


def possible(bench: Bench, fit: HypothesisFit) -> HypothesisFit:
    """Return the fit without members that cannot be, where another one on which they leant was taken out of it.

    Of several that would do, the one without which evidence is greatest goes; where none would do alone, one that is
    not physical itself.
    """

    def so_far(found: HypothesisFit) -> tuple[float, int]:
        allowed = (bench.candidates[k].allows(bench.part(found, k)[0]) for k in found.members)
        return found.evidence, sum(allowed) - len(found.members)

    while fit.members and not np.isfinite(fit.evidence):
        fit = max((bench.solve(fit.members - {k}) for k in sorted(fit.members)), key=so_far)
    return fit


def additions(bench: Bench, members: Members, count: int = TUNING.tried) -> list[HypothesisFit]:
    """Return the best exact fits with one member more."""
    scores = score_candidates(bench, members)
    names = {bench.candidates[k].name for k in members}
    for k, candidate in enumerate(bench.candidates):
        scores[k] -= PRIOR_COSTS.further_joint if candidate.name in names else PRIOR_COSTS.new_name
        if not candidate.name:
            scores[k] = -np.inf
    result: list[HypothesisFit] = []
    for k in np.argsort(scores)[::-1]:
        if len(result) >= count or not np.isfinite(scores[k]):
            break
        if int(k) not in members and bench.compatible(members, int(k)):
            result.append(bench.solve(members | {int(k)}))
    return sorted(result, key=lambda fit: -fit.evidence)


def worth(bench: Bench, fit: HypothesisFit, least: float) -> float:
    """Return what a hypothesis brings beyond all that is asked of it [nats]."""
    return fit.evidence - asked([bench.candidates[k] for k in fit.members], least)


def _add(bench: Bench, fit: HypothesisFit, least: float, propose: Propose | None) -> HypothesisFit | None:
    if propose is not None:
        propose(bench, fit.members)
    single = additions(bench, fit.members)
    together = everywhere(bench, fit)
    if together is not None and together.evidence > max([fit.evidence + least, *(found.evidence for found in single)]):
        return together
    best = max(single, key=lambda found: worth(bench, found, least), default=fit)
    if worth(bench, best, least) > worth(bench, fit, least):
        return best
    return None


def everywhere(bench: Bench, fit: HypothesisFit) -> HypothesisFit | None:
    """Return the best fit with one usual name on every joint that lacks it, but where it is not physical."""
    best: HypothesisFit | None = None
    # Joint by joint, the way to what every joint of a real arm may lack leads past better-looking errors.
    every = sorted((record for record in records() if record.everywhere), key=lambda record: record.everywhere)
    for name in (record.name for record in every):
        new = {
            k
            for k, c in enumerate(bench.candidates)
            if c.name == name and c.onset is None and not c.variant and k in bench.offered
            if bench.compatible(fit.members, k)
        }
        for _ in range(TUNING.narrowed):
            found = bench.solve(fit.members | new)
            wrong = {k for k in new if not bench.candidates[k].allows(bench.part(found, k)[0])}
            new -= wrong
            if not wrong or len(new) < 2:
                break
        if len(new) > 1 and np.isfinite(found.evidence) and (best is None or found.evidence > best.evidence):
            best = found
    return best


def one_kind(bench: Bench, fit: HypothesisFit) -> HypothesisFit | None:
    """Return the fit with Stribeck's law wherever it has Coulomb's beside Stribeck's, if that is better.

    No single swap is. The same of any law that has a price beside its plainer one.
    """
    for record in records():
        found = _of_one_kind(bench, fit, record) if record.mixed > 0.0 else None
        if found is not None:
            return found
    return None


def _of_one_kind(bench: Bench, fit: HypothesisFit, law: EffectRecord) -> HypothesisFit | None:
    names = {bench.candidates[k].name for k in fit.members}
    dry = [k for k in fit.members if bench.candidates[k].name == law.plainer]
    if law.name not in names or any(bench.candidates[k].onset is not None for k in dry):
        return None
    members = fit.members
    for k in dry:
        others = members - {k}
        joints = bench.candidates[k].joints
        swaps = [
            bench.solve(others | {i})
            for i in bench.find(law.name)
            if bench.candidates[i].joints == joints and i in bench.offered
        ]
        members = max(swaps, key=lambda option: option.evidence, default=fit).members
    found = bench.solve(members)
    return found if found.evidence > fit.evidence + 1e-6 else None


def plainer(bench: Bench, fit: HypothesisFit) -> HypothesisFit:
    """Return the fit with the plainer law for every one that brings next to nothing beyond it.

    No law is exact to the noise where an effect is strong: what a simulator's or a real joint's friction does within
    a hundredth of a radian per second of rest would else pass for a dip, and what smoothing does to a heavy rotor's
    torque for a gear that yields.
    """
    for law in _finer_laws():
        finer = [k for k in sorted(fit.members) if bench.candidates[k].name == law.name]
        # All of them first: some here and some there would be two names.
        for some in [finer, *([k] for k in finer if len(finer) > 1)]:
            rest = fit.members - frozenset(some)
            members = rest
            for k in some:
                same = [
                    i
                    for i in bench.find(law.plainer)
                    if bench.candidates[i].joints == bench.candidates[k].joints
                    and bench.candidates[i].onset == bench.candidates[k].onset
                    and not bench.candidates[i].variant
                ]
                members = members | (frozenset(same[:1]) if same else {k})
            found = bench.solve(members)
            explained = _explained(bench, found, rest) if law.share_of_own else fit.evidence
            if fit.evidence - found.evidence < law.plainer_share * explained:
                fit = found
    return fit


def _finer_laws() -> list[EffectRecord]:
    """Return the records of laws that hold a plainer one."""
    return [record for record in records() if record.plainer]


def _explained(bench: Bench, fit: HypothesisFit, rest: Members) -> float:
    """Return evidence that a fit has beyond a part of its members [nats]."""
    return max(fit.evidence - max(bench.solve(rest).evidence, 0.0), 0.0)


def handicaps(bench: Bench, fit: HypothesisFit) -> dict[str, float]:
    """Return what a law that is finer than one of a fit's must bring beyond it [nats], see `plainer`."""
    result = {}
    for law in _finer_laws():
        names = {bench.candidates[k].name for k in fit.members}
        if law.name in names and law.plainer not in names:
            continue
        rest = frozenset(k for k in fit.members if bench.candidates[k].name != law.plainer)
        explained = _explained(bench, fit, rest) if law.share_of_own else fit.evidence
        result[law.name] = law.plainer_share * explained
    return result


def finer(bench: Bench, fit: HypothesisFit, other: Members, less: Mapping[str, float]) -> float:
    """Return what is asked of a hypothesis for laws that are finer than a fit's [nats], as `plainer` asks it.

    Of all joints together where the fit has no such law; of each further one where it has, or what `plainer` took from
    a joint would seem more probable than what it left there.

    Args:
        bench: of both.
        fit: that it is held against.
        other: members of the hypothesis.
        less: of the fit, see `handicaps`.
    """
    asked = 0.0
    for name, each in less.items():
        here, there = (sum(bench.candidates[k].name == name for k in some) for some in (fit.members, other))
        asked = max(asked, each * (max(there - here, 0) if here else min(there, 1)))
    return asked


def _drop(bench: Bench, fit: HypothesisFit) -> HypothesisFit | None:
    options = [bench.solve(fit.members - {k}) for k in fit.members]
    best = max(options, key=lambda option: option.evidence, default=None)
    if best is None:
        return None
    if best.evidence >= fit.evidence and (np.isfinite(best.evidence) or not np.isfinite(fit.evidence)):
        return best
    return None


def _swap(bench: Bench, fit: HypothesisFit, propose: Propose | None) -> HypothesisFit | None:
    """Replace one member, or all members of one name, by another candidate."""
    names: dict[str, Members] = {}
    for k in fit.members:
        name = bench.candidates[k].name
        names[name] = names.get(name, frozenset()) | {k}
    groups = [frozenset({k}) for k in fit.members] + [group for group in names.values() if len(group) > 1]
    best = one_kind(bench, fit) or fit
    for group in groups:
        if propose is not None and len(groups) <= TUNING.crowded:
            propose(bench, fit.members - group)
        said = {(bench.candidates[k].place, bench.candidates[k].variant) for k in group}
        for found in additions(bench, fit.members - group, 5):
            (new,) = found.members - (fit.members - group)
            # The same effect off its working point is an approximation of what is already there.
            again = (bench.candidates[new].place, bench.candidates[new].variant) in said
            if found.evidence > best.evidence + 1e-6 and not again:
                best = found
    return None if best is fit else best
