"""Candidates for gears that yield: springs that swing and play that knocks, worked out for the measured motion.

Neither is linear in anything but the rotor's inertia: a spring's stiffness says at which frequency the link swings, a
gap when it knocks. Their torques are worked out on a grid (`elastic_gears`) and compared with the residual; the best of
each joint is offered, and its shape refined like any other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, transformed
from twin_diagram.gap.residuals.prepared_logs import TUNING as PREPARED_LOGS
from twin_diagram.gap.residuals.prepared_logs import Record
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.gap.search.backlash_gaps import Knocks
from twin_diagram.gap.search.evidence import Bench, Members
from twin_diagram.gap.search.prior_costs import TUNING as PRIOR_COSTS
from twin_diagram.model.effects import REGISTRY, Effect, make
from twin_diagram.model.model import Model
from twin_diagram.scenario import EffectSpec
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    leaning: tuple[float, ...] = (0.004, 0.01, 0.025)
    """Gaps of a gear that never turns over: they tell how far it leans [rad]."""

    losses: tuple[float, ...] = (3e-3, 1.2e-2)
    """With so much of it a swing is broad enough for the grid to meet it, and forgets the encoder's noise, which drives
    it, too; how much there is, refinement tells [s]."""

    calm_loss: float = 6e-2

    about_one: tuple[float, ...] = (0.6, 1.5)
    """A shape's torque fits the residual as it stands, or the shape is wrong."""

    worth: float = 10.0
    """Evidence beyond a name's price that makes a gear worth offering [nats]."""

    edge: float = 1.25
    """Whitened, noise counts evenly up to so many times the band."""


TUNING = Tuning()

SWINGS = tuple(np.geomspace(2.5, 16.0, 10))
"""Frequencies at which a link may swing on its gear [Hz]; stiffer ones follow their load."""


CALM = slice(1, None, 3)
"""With so much a gear follows its load and hardly swings: where noise hides the swing, this is left. Few of `SWINGS`
are enough for it."""


GEARS = ("joint_elasticity", "backlash")

COST = {"joint_elasticity": 8.0, "backlash": 3.0}
"""Of the search for a shape, which two dozen are tried for a spring, and three numbers refined [nats]."""


@dataclass(frozen=True)
class Shape:
    """Of a gear: what it is called, and the numbers on which its torque depends otherwise than linearly."""

    name: str
    joint: int
    values: tuple[tuple[str, float], ...]


def gear(terms: Terms, shape: Shape) -> Candidate | None:
    """Return the candidate of one shape: its torque, whose coefficient is about 1, and the rotor's inertia.

    None where the shape is not within what the effect allows, or its torque not finite.
    """
    kinds = REGISTRY[shape.name].kinds
    if not all(kinds[key].lower <= value <= kinds[key].upper for key, value in shape.values):
        return None
    records = terms.records
    j = shape.joint
    given = records.model
    model = given.with_effects([*(e for e in given.present if e.name not in GEARS), _effect(given, shape)])
    rate = records.reduce(lambda r: r.a)[:, j]

    def law(record: Record) -> Array:
        beyond = record.torque - record.given
        return model.law.twist((record.q, record.v, record.a), 1.0 / record.rate, beyond).torque

    with np.errstate(all="ignore"):
        torque = records.reduce(law)
    if not np.all(np.isfinite(torque)):
        return None
    columns = np.zeros((*torque.shape, 2))
    columns[..., 0] = torque
    columns[:, j, 1] = rate
    size = max(float(np.sqrt(np.mean(rate**2))), 1e-9)
    values = dict(shape.values)

    def parameters(c: Array) -> dict[str, Array]:
        told = {key: np.array([value]) for key, value in values.items() if key != "loss"}
        return {**told, "rotor_inertia": np.maximum(c[1:2], 0.0)}

    return Candidate(
        name=shape.name,
        joints=(j,),
        links=(),
        rows=tuple(range(records.n)),
        columns=columns,
        spread=np.array([1.0, terms.torque_size[j] / size]),
        lower=np.array([TUNING.about_one[0], -1.05 * terms.present.rotor[j] - 1e-9]),
        upper=np.array([TUNING.about_one[1], np.inf]),
        parameters=transformed(parameters),
        shape=values,
        cost=COST[shape.name] + rattled(terms, j),
        variant="swinging",
    )


def rattled(terms: Terms, j: int) -> float:
    """Return evidence that a gear may find in an encoder's noise alone [nats].

    The given model answers the noise of positions with inertial torque, which a gear that yields takes back. The band
    keeps that small beside the torque's noise; where it does not, because most of the log says nothing of it (a joint
    rests), the share x/(1 + x) of the noise's power goes to any gear, x growing with the frequency's fourth power.
    """
    u = np.linspace(0.0, TUNING.edge, 40)
    lost = 0.0
    for record in terms.records.records:
        x = max(0.0, record.shaken[j] ** 2 - PREPARED_LOGS.noise_share**2) * u**4
        lost += 0.5 * len(record.kept) * float(np.mean(x / (1.0 + x)))
    return lost


def _effect(model: Model, shape: Shape) -> Effect:
    parameters = {**{key: [value] for key, value in shape.values}, "rotor_inertia": [0.0]}
    return make(EffectSpec(name=shape.name, joints=[model.joints[shape.joint]], parameters=parameters))


def plays(bench: Bench, members: Members, joints: Sequence[int], knocks: Knocks) -> dict[int, list[Shape]]:
    """Play that is tried on each joint: beside the members, and without some that are on it."""
    beside: dict[int, list[Members]] = {}
    for j in filter(knocks.turns, range(bench.n)):
        own = {k for k in members if j in bench.candidates[k].joints}
        beside[j] = [rest for rest in _rests(bench, members, j) if not rest or members - rest <= own]
    gaps = {j: list(TUNING.leaning) for j in joints} | knocks.gaps(beside)
    return {j: [Shape("backlash", j, (("gap", gap),)) for gap in some] for j, some in gaps.items()}


def springs(terms: Terms, j: int) -> list[Shape]:
    """Springs that are tried on a joint."""
    inertia = _link_inertia(terms, j)
    result: list[Shape] = []
    swings = [(swing, loss) for swing in SWINGS for loss in TUNING.losses] + [
        (swing, TUNING.calm_loss) for swing in SWINGS[CALM]
    ]
    for swing, loss in swings:
        stiffness = inertia * (2.0 * np.pi * float(swing)) ** 2
        result.append(Shape("joint_elasticity", j, (("stiffness", stiffness), ("loss", loss))))
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
    play = plays(bench, members, joints, knocks)
    for j in range(bench.n):
        shapes = [*play.get(j, ()), *(springs(terms, j) if j in joints else ())]
        if not shapes:
            continue
        rests = _rests(bench, members, j)
        bases = [bench.basis(rest) for rest in rests]
        projected = [np.einsum("jrk,jr->k", Q, bench.y) for Q in bases]
        crowded: dict[str, tuple[float, Candidate]] = {}
        best: dict[tuple[str, Members], tuple[float, Candidate]] = {}
        for shape in shapes:
            candidate = gear(terms, shape)
            if candidate is None:
                continue
            score = bench.score_once(candidate, bases[0], projected[0]) - candidate.cost
            if score > crowded.get(shape.name, (PRIOR_COSTS.new_name + TUNING.worth, candidate))[0]:
                crowded[shape.name] = score, candidate
            for rest, Q, told in zip(rests, bases, projected, strict=True):
                score = bench.score_once(candidate, Q, told, bounded=True)
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
                bench.offer(k)
                made.append(k)
    return made


def _rests(bench: Bench, members: Members, j: int) -> list[Members]:
    """Return a hypothesis, what is left where a gear on joint j takes the place of its rotor and of one more.

    And nothing.
    """
    rotor = {
        k for k in members if bench.candidates[k].name == "reflected_inertia" and bench.candidates[k].joints == (j,)
    }
    without = members - rotor
    return list(dict.fromkeys([members, without, *(without - {k} for k in sorted(without)), frozenset()]))
