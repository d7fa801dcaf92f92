"""Dry friction in proportion to the load: its candidates and its record."""

from __future__ import annotations

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.candidates.joint_candidate import below_zero, single, those_there
from twin_diagram.gap.candidates.merging import summed
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.friction_stribeck_load import LoadDependentFriction


def on_joints(terms: Terms) -> list[list[Candidate]]:
    """Return the size of what each gear passes on, against the motion."""
    loaded = terms.reduce(tuple(np.abs(load) * s for load, s in zip(terms.passed_on, terms.signs, strict=True)))
    least = [below_zero(coefficient) for coefficient in terms.present.load]
    name, key = LoadDependentFriction.name, linear("coefficient")
    return [
        those_there([single(terms, name, j, [loaded[:, j]], key, [least[j]], [0.9])]) for j in range(terms.records.n)
    ]


def sentence(effect: Effect) -> str:
    """Return its share of the load on each joint."""
    parts = (f"{100.0 * c:.3g} % on {j}" for j, c in zip(effect.joints, effect.value("coefficient"), strict=True))
    return f"dry friction in proportion to the load: {', '.join(parts)}"


register(
    EffectRecord(
        effect=LoadDependentFriction,
        title="Friction that grows with load",
        explanation="Dry friction in proportion to the torque that the gear carries.",
        sentence=sentence,
        on_joints=on_joints,
        family="friction",
        merge=summed,
        joint_by_joint=True,
        leading=("coefficient",),
        starts=True,
        dry=True,
        adds=frozenset({"coefficient"}),
        wakes=frozenset({Wakes.REVERSAL, Wakes.LOAD}),
    )
)
