"""Candidates for gears that yield: springs that swing and play that knocks, worked out for the measured motion.

Neither is linear in anything but the rotor's inertia: a spring's stiffness says at which frequency the link swings, a
gap when it knocks. Their torques are worked out on a grid (`elastic_gears`) and compared with the residual; the best of
each joint is offered, and its shape refined like any other.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate
from twin_diagram.gap.candidates.gears import GearShape, gear
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.search.backlash_gaps import Knocks
from twin_diagram.gap.search.bench import Bench
from twin_diagram.gap.search.evidence import Members
from twin_diagram.gap.search.prior_costs import TUNING as PRIOR_COSTS
from twin_diagram.gap.search.scoring import basis, score_both
from twin_diagram.model.dynamics.elastic_gears import Untwisted
from twin_diagram.model.effects.elasticity import Backlash, JointElasticity
from twin_diagram.model.effects.inertia import ReflectedInertia
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    leaning: tuple[float, ...] = (0.004, 0.01, 0.025)
    """Gaps of a gear that never turns over: they tell how far it leans [rad]."""

    losses: tuple[float, ...] = (3e-3, 1.2e-2)
    """With so much of it a swing is broad enough for the grid to meet it, and forgets the encoder's noise, which drives
    it, too; how much there is, refinement tells [s]."""

    calm_loss: float = 6e-2
    """With so much a gear follows its load and hardly swings: where noise hides the swing, this is left [s]."""

    finished: int = 3
    """Springs of a joint that are worked out in full beside each hypothesis: the best by a first pass, which tells
    evidence to a few per cent where a gear twists by hundredths of a radian."""

    worth: float = 10.0
    """Evidence beyond a name's price that makes a gear worth offering [nats]."""


TUNING = Tuning()

SWINGS = tuple(np.geomspace(2.5, 16.0, 10))
"""Frequencies at which a link may swing on its gear [Hz]; stiffer ones follow their load."""


CALM = slice(1, None, 3)
"""Of `SWINGS`, those that are tried with `calm_loss`: without a swing to meet, few are enough."""


def play_shapes(bench: Bench, members: Members, joints: Sequence[int], knocks: Knocks) -> dict[int, list[GearShape]]:
    """Return the play that is tried on each joint: beside the members, and without some that are on it."""
    beside: dict[int, list[Members]] = {}
    for j in filter(knocks.turns, range(bench.n)):
        own = {k for k in members if j in bench.candidates[k].joints}
        beside[j] = [rest for rest in _rests(bench, members, j) if not rest or members - rest <= own]
    gaps = {j: list(TUNING.leaning) for j in joints} | knocks.gaps(beside)
    return {j: [GearShape(Backlash.name, j, (("gap", gap),)) for gap in some] for j, some in gaps.items()}


def spring_shapes(terms: Terms, j: int) -> list[GearShape]:
    """Return the springs that are tried on a joint."""
    inertia = _link_inertia(terms, j)
    result: list[GearShape] = []
    swings = [(swing, loss) for swing in SWINGS for loss in TUNING.losses] + [
        (swing, TUNING.calm_loss) for swing in SWINGS[CALM]
    ]
    for swing, loss in swings:
        stiffness = inertia * (2.0 * np.pi * float(swing)) ** 2
        result.append(GearShape(JointElasticity.name, j, (("stiffness", stiffness), ("loss", loss))))
    return result


def _link_inertia(terms: Terms, j: int) -> float:
    """Return the mean inertia of what a joint moves, its rotor aside [kg·m²]."""
    tree = terms.records.model.tree
    q = np.concatenate([r.q[:: max(1, len(r.q) // 40)] for r in terms.records.records])
    return float(np.mean(tree.mass_matrix(q)[:, j, j]) - tree.rotor[j])


def propose(bench: Bench, terms: Terms, members: Members, joints: Sequence[int], knocks: Knocks) -> list[int]:
    """Offer the best spring and the best play of each joint, where they are worth it; answer their indices.

    Beside all members a gear must be worth a good deal, be it with coefficients that are not physical: a crowd of other
    names may have taken so much of it. Rotors, offsets and friction may have taken all: it is offered, too, where it is
    better than one of them, or alone better than any of them alone.

    Args:
        bench: takes them in.
        terms: of the logs.
        members: named so far.
        joints: where springs are looked for, and play of gears that never turn over; other play is on all joints.
        knocks: of the same bench.
    """
    made: list[int] = []
    whole = bench.solve(members).evidence
    alone = max((bench.solve(frozenset({k})).evidence for k in members), default=0.0)
    play = play_shapes(bench, members, joints, knocks)
    for j in range(bench.n):
        shapes = [*play.get(j, ()), *(spring_shapes(terms, j) if j in joints else ())]
        if not shapes:
            continue
        rests = _rests(bench, members, j)
        bases = [basis(bench, rest) for rest in rests]
        projected = [np.einsum("jrk,jr->k", Q, bench.y) for Q in bases]
        bare: defaultdict[int, Untwisted] = defaultdict(Untwisted)  # of one joint: long logs take space
        shapes = promising(bench, terms, shapes, bases, projected, bare)
        crowded: dict[str, tuple[float, Candidate]] = {}
        best: dict[tuple[str, Members], tuple[float, Candidate]] = {}
        for shape in shapes:
            candidate = gear(terms, shape, bare)
            if candidate is None:
                continue
            white = bench.whiten(candidate)  # beside each hypothesis it is the same
            scores = [score_both(bench, candidate, Q, told, white) for Q, told in zip(bases, projected, strict=True)]
            score = scores[0][0] - candidate.cost
            if score > crowded.get(shape.name, (PRIOR_COSTS.new_name + TUNING.worth, candidate))[0]:
                crowded[shape.name] = score, candidate
            for rest, (_, score) in zip(rests, scores, strict=True):
                if score > best.get((shape.name, rest), (0.0, candidate))[0]:
                    best[shape.name, rest] = score, candidate
        known = {id(candidate): bench.add(candidate) for _, candidate in crowded.values()}
        made += known.values()
        for (_, rest), (_, candidate) in best.items():
            if id(candidate) not in known:
                known[id(candidate)] = bench.add(candidate, offered=False)
            k = known[id(candidate)]
            least = whole + TUNING.worth if rest == members else whole if rest else alone
            if k not in made and bench.solve(rest | {k}).evidence > least:
                bench.offered.offer(k)
                made.append(k)
    return made


def promising(
    bench: Bench,
    terms: Terms,
    shapes: list[GearShape],
    bases: Sequence[Array],
    projected: Sequence[Array],
    bare: defaultdict[int, Untwisted],
) -> list[GearShape]:
    """Return the shapes of a joint's gears without springs that a first pass shows to be far from the best.

    Args:
        bench: with the data.
        terms: of the logs.
        shapes: of one joint.
        bases: of each hypothesis that they may join, as `scoring.basis` has them.
        projected: of each.
        bare: of each record.
    """
    springs = [k for k, shape in enumerate(shapes) if shape.name == JointElasticity.name]
    rough = {k: gear(terms, shapes[k], bare, roughly=True) for k in springs}
    white = {k: bench.whiten(one) for k, one in rough.items() if one is not None}
    kept = set(range(len(shapes))) - set(springs)
    for Q, told in zip(bases, projected, strict=True):
        scores = {
            k: np.array(score_both(bench, one, Q, told, white[k])) - one.cost
            for k, one in rough.items()
            if one is not None
        }
        for bounded in (0, 1):
            kept |= set(sorted(scores, key=lambda k: (scores[k][bounded], k), reverse=True)[: TUNING.finished])
    return [shapes[k] for k in sorted(kept)]


def _rests(bench: Bench, members: Members, j: int) -> list[Members]:
    """Return what may stand beside a gear on joint j: all members, all but its rotor and one more, and none."""
    rotor = {
        k for k in members if bench.candidates[k].name == ReflectedInertia.name and bench.candidates[k].joints == (j,)
    }
    without = members - rotor
    return list(dict.fromkeys([members, without, *(without - {k} for k in sorted(without)), frozenset()]))
