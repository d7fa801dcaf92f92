"""A mass at the last link: its candidates and its record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, transformed
from twin_diagram.gap.candidates.merging import TUNING as MERGING
from twin_diagram.gap.candidates.merging import Parameters
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.candidates.whole_arm import in_link_frame, inertia_spread, last_body, reach
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.inertia import Payload
from twin_diagram.scenario import EffectSpec
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    along: float = 0.9
    """Share of the way from the joint before that lies along the last joint's axis, from which on it tells where
    outward is: of arms that are built it is 1 or 0, and 26° are allowed for."""

    solid: float = 0.04
    """Share of the arm's reach that a payload's radius of gyration is of the order of: 5 cm of a UR10's 1.3 m."""

    short: float = 0.03
    """Share of the arm's reach below which that way tells nothing: where all joints of a wrist meet in a point, say."""


TUNING = Tuning()

SOLID = "solid"
"""Variant of a payload that is no point: a coefficient more, its own moment of inertia, the same about all axes."""

ALIKE = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
"""Moments and products of inertia of what has the same moment about all axes."""


def carried_always(candidate: Candidate) -> bool:
    """Return whether a candidate is a mass at the last link that is there all the time."""
    return candidate.name == Payload.name and not candidate.passing


def on_arm(terms: Terms) -> list[Candidate]:
    """Return a point and a body at the last link."""
    return [payload(terms), bulky_payload(terms)]


def payload(terms: Terms, centre: Array | None = None) -> Candidate:
    """Return a mass at the last link: coefficients m and m·c; `centre` sets the inertia that a unit mass brings."""
    body = last_body(terms)
    full = in_link_frame(terms, body)
    columns = full[..., :4].copy()
    if centre is not None:
        columns[..., 0] += full[..., 4:] @ _turned(centre, centre)
    spread = inertia_spread(terms)[:4]

    def values(c: Array) -> dict[str, Array]:
        return {"mass": c[0:1], "com": c[1:4] / c[0]}

    least = -1.05 * terms.present.mass
    return Candidate(
        name=Payload.name,
        joints=(),
        links=(terms.records.model.last_link,),
        rows=tuple(range(terms.records.n)),
        columns=columns,
        spread=spread,
        lower=np.array([least, -np.inf, -np.inf, -np.inf]),
        upper=np.full(4, np.inf),
        parameters=transformed(values),
        admits=within_reach(terms, body),
    )


def within_reach(terms: Terms, body: int) -> Callable[[Array], bool]:
    """Return whether mass and first moment are of something that the last link can hold.

    It is near the link, and not behind the wrist: where the last joint turns about the way to it from the joint before,
    what turns with it does not lie beyond that one.
    """
    model, far = terms.records.model, 0.35 * reach(terms)
    tree, (_, X_ML) = model.tree, model.bodies.body_of(model.last_link)
    from_before = tree.R_PF[body].T @ tree.p_PF[body]
    ahead = float(from_before @ tree.axis[body])
    least = max(TUNING.along * float(np.linalg.norm(from_before)), TUNING.short * reach(terms))
    wrist = tree.revolute[body] and tree.parent[body] >= 0 and abs(ahead) > least
    outward = np.sign(ahead) * tree.axis[body]

    def admits(c: Array) -> bool:
        mass = abs(c[0])
        moment = np.sign(c[0]) * (X_ML.rotation().matrix() @ c[1:4]) + mass * X_ML.translation()
        behind = wrist and -float(outward @ moment) > abs(ahead) * mass
        return bool(np.linalg.norm(c[1:4]) <= far * mass) and not behind

    return admits


def payload_about(terms: Terms, centre: Array) -> Candidate:
    """Return a mass at the last link whose inertia is to first order in m and m·c about a `centre`.

    Of a point with first moment h, inertia is that of h hᵀ / m, which a heavier point has less of: were it taken to
    grow with m alone, looking for mass and centre in turn would run away from both. As it is homogeneous, it is exact
    where the centre is right.
    """
    plain, full = payload(terms), in_link_frame(terms, last_body(terms))[..., 4:]
    columns = plain.columns.copy()
    columns[..., 0] -= full @ _turned(centre, centre)
    for k, axis in enumerate(np.eye(3)):
        columns[..., 1 + k] += 2.0 * full @ _turned(centre, axis)
    return replace(plain, columns=columns)


def solid_about(terms: Terms, centre: Array, mass: float) -> Candidate:
    """Return `payload_about` a centre, of something of about a mass [kg] that is no point.

    Near the last joint's axis a point has no inertia about it, and what a solid has there would move mass and centre.
    """
    point = payload_about(terms, centre)
    own = in_link_frame(terms, last_body(terms))[..., 4:] @ ALIKE
    return replace(
        point,
        columns=np.concatenate([point.columns, own[..., None]], axis=-1),
        spread=np.append(point.spread, abs(mass) * (TUNING.solid * reach(terms)) ** 2),
        lower=np.append(point.lower, 0.0),
        upper=np.append(point.upper, np.inf),
        variant=SOLID,
    )


def _turned(a: Array, b: Array) -> Array:
    """Return (6,) moments and products of inertia that two halves of a product of lengths (3,) stand for [m²]."""
    tensor = a @ b * np.eye(3) - 0.5 * (np.outer(a, b) + np.outer(b, a))
    return np.array([*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2]])


def bulky_payload(terms: Terms) -> Candidate:
    """Return a payload that is no point: its inertia is free, and not reported."""
    point = payload(terms)
    columns = in_link_frame(terms, last_body(terms))
    return replace(
        point,
        columns=columns,
        spread=inertia_spread(terms),
        lower=np.concatenate([point.lower, np.full(6, -np.inf)]),
        upper=np.full(10, np.inf),
        variant="bulky",
    )


def recentred(terms: Terms, candidate: Candidate, coefficients: Array) -> Candidate | None:
    """Return a point where it was found to be."""
    if candidate.variant or coefficients[0] == 0.0:
        return None
    return payload(terms, coefficients[1:4] / coefficients[0])


def merge(here: Parameters, more: Parameters) -> Parameters | None:
    """Take a loss off a payload that was there.

    Two payloads weigh as one, but their inertia is not that of one point.
    """
    lost = more["mass"][0]
    if lost >= 0.0:
        return None
    mass = here["mass"][0] + lost
    if mass <= MERGING.nothing:
        return {"mass": [max(mass, 0.0)], "com": [0.0, 0.0, 0.0]} if mass > -MERGING.rounded * here["mass"][0] else None
    if mass < MERGING.rounded * here["mass"][0]:  # of so little, the centre is anywhere
        return {"mass": [mass], "com": list(here["com"])}
    moment = here["mass"][0] * np.array(here["com"]) + lost * np.array(more["com"])
    return {"mass": [mass], "com": (moment / mass).tolist()}


def put_down(specs: list[EffectSpec], piece: EffectSpec) -> list[EffectSpec]:
    """Return less of the lightest payload on a link that is enough, or of all of them together."""
    there = [
        spec
        for spec in specs
        if spec.name == piece.name and spec.links in ([], piece.links) and spec.onset is None and spec.end is None
    ]
    lost = -piece.parameters["mass"][0]
    enough = [spec for spec in there if spec.parameters["mass"][0] * (1.0 + MERGING.rounded) >= lost]
    chosen = [min(enough, key=lambda spec: spec.parameters["mass"][0])] if enough else there
    masses = np.array([spec.parameters["mass"][0] for spec in chosen])
    if not np.sum(masses) > 0.0:
        return [*specs, piece]
    com = masses @ np.array([spec.parameters["com"] for spec in chosen]) / np.sum(masses)
    remaining = merge({"mass": [float(np.sum(masses))], "com": com.tolist()}, piece.parameters)
    if remaining is None:
        return [*specs, piece]
    left = EffectSpec(piece.name, [], list(piece.links), remaining)
    rest = [spec for spec in specs if not any(spec is one for one in chosen)]
    return [*rest, left] if abs(remaining["mass"][0]) > MERGING.nothing else rest


def sentence(effect: Effect) -> str:
    """Return its mass, link and centre."""
    x, y, z = effect.value("com")
    where = f" on {effect.links[0]}" if effect.links else " at the last link"
    mass = effect.value("mass")[0]
    return f"a payload of {mass:.4g} kg{where}, centred at ({x:.4g}, {y:.4g}, {z:.4g}) m in its frame"


register(
    EffectRecord(
        effect=Payload,
        title="A payload",
        explanation="Mass at the last link that the model does not know of: a tool, a cable, a part in the hand.",
        sentence=sentence,
        keys={"com": "centre of mass"},
        on_arm=on_arm,
        recentred=recentred,
        once=True,
        merge=merge,
        leading=("mass",),
        on_last_link=True,
        put_down=put_down,
        starts=True,
        per_joint=False,
        adds=frozenset({"mass"}),
        wakes=frozenset({Wakes.POSE, Wakes.ACCELERATION}),
    )
)
