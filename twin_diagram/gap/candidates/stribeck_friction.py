"""Dry friction that falls as a joint gets under way: its candidates and its record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, transformed
from twin_diagram.gap.candidates.joint_candidate import single, those_there
from twin_diagram.gap.candidates.merging import Parameters, summed
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.friction import CoulombFriction
from twin_diagram.model.effects.friction_stribeck_load import StribeckFriction
from twin_diagram.signals.arrays import Array

STRIBECK_SPEEDS = np.geomspace(0.016, 0.5, 8)
"""[rad/s]"""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    slowest: float = 0.014
    """Below this, a joint that sticks and one that creeps look the same [rad/s]."""

    narrow: float = 0.03
    """Below this, a dip is narrow [rad/s]; see `narrowest`."""

    narrowest: float = 10.0
    """A narrow dip lies where a joint may be held and laws of dry friction are the least exact; one at `slowest` must
    bring this much more [nats]."""

    alike: float = 0.2
    """Share by which the speeds of two dips may differ that are added up."""

    mixed: float = 4.0
    """Price of saying that dry friction is of one kind on some joints and of another on others [nats]."""

    share: float = 1.5e-3
    """Of all evidence, which a dip near rest must bring."""


TUNING = Tuning()


def on_joints(terms: Terms) -> list[list[Candidate]]:
    """Return a few Stribeck speeds for each joint."""
    return [those_there(stribeck(terms, j, float(speed)) for speed in STRIBECK_SPEEDS) for j in range(terms.records.n)]


def stribeck(terms: Terms, j: int, speed: float) -> Candidate | None:
    """Return Coulomb's level, and what breaking loose takes beyond it; None where the joint does not show its speed."""
    if speed < TUNING.slowest or speed > max(float(np.max(np.abs(r.v[:, j]))) for r in terms.records.records):
        return None
    parts = zip(terms.signs, terms.records.records, strict=True)
    bump = terms.reduce(tuple(s[:, j] * np.exp(-((r.v[:, j] / speed) ** 2)) for s, r in parts))

    def values(c: Array) -> dict[str, Array]:
        return {"coulomb": c[0:1], "static": c[0:1] + c[1:2], "stribeck_velocity": np.array([speed])}

    low = -terms.present.coulomb[j]
    return single(
        terms,
        StribeckFriction.name,
        j,
        [terms.reduced_signs[:, j], bump],
        transformed(values),
        [low, -np.inf if StribeckFriction.name in terms.present.names else 0.0],
        shape={"stribeck_velocity": speed},
        cost=float(
            np.log(4.0)
            + TUNING.narrowest * max(0.0, np.log(TUNING.narrow / speed) / np.log(TUNING.narrow / TUNING.slowest))
        ),
    )


def shapes(terms: Terms, candidate: Candidate) -> list[tuple[str, float, float]]:
    """Return the speed at which the dip ends."""
    del terms, candidate
    return [("stribeck_velocity", 0.55, 1.8)]


def rebuilt(terms: Terms, candidate: Candidate, key: str, value: float) -> Candidate | None:
    """Return the candidate of another speed."""
    del key
    return stribeck(terms, candidate.joints[0], value)


def merge(here: Parameters, more: Parameters) -> Parameters | None:
    """Return the sum of both levels of two dips at much the same speed."""
    if abs(here["stribeck_velocity"][0] / more["stribeck_velocity"][0] - 1.0) > TUNING.alike:
        return None
    return {**summed(here, more), "stribeck_velocity": list(here["stribeck_velocity"])}


def sentence(effect: Effect) -> str:
    """Return its levels at rest and at speed, on each joint."""
    parts = (
        f"{s:.4g} {effect.unit('static', joint)} at rest, {'falling' if c <= s else 'rising'} to "
        f"{c:.4g} {effect.unit('coulomb', joint)} above "
        f"some {w:.3g} {effect.unit('stribeck_velocity', joint)}, on {joint}"
        for joint, c, s, w in zip(
            effect.joints,
            effect.value("coulomb"),
            effect.value("static"),
            effect.value("stribeck_velocity"),
            strict=True,
        )
    )
    return f"dry friction of {'; '.join(parts)}"


register(
    EffectRecord(
        effect=StribeckFriction,
        title="Dry friction with a Stribeck dip",
        explanation="Dry friction that is other at a crawl than at speed: higher, and the joint sticks, then slips.",
        sentence=sentence,
        keys={"coulomb": "friction at speed", "static": "friction at rest"},
        on_joints=on_joints,
        shapes=shapes,
        rebuilt=rebuilt,
        mixed=TUNING.mixed,
        rivals=frozenset({CoulombFriction.name}),
        plainer=CoulombFriction.name,
        plainer_share=TUNING.share,
        wider_than=frozenset({CoulombFriction.name}),
        merge=merge,
        joint_by_joint=True,
        leading=("coulomb", "static"),
        usual=True,
        dry=True,
        holds=True,
        adds=frozenset({"coulomb", "static"}),
        logarithmic=frozenset({"stribeck_velocity"}),
        scanned="stribeck_velocity",
        wakes=frozenset({Wakes.REVERSAL, Wakes.SPEED}),
    )
)
