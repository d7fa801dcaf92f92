"""Coulomb's dry friction: its candidates and its record."""

from __future__ import annotations

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.candidates.joint_candidate import below_zero, single, those_there
from twin_diagram.gap.candidates.merging import TUNING as MERGING
from twin_diagram.gap.candidates.merging import Parameters, summed
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.candidates.wording import values_on_joints
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.friction import CoulombFriction
from twin_diagram.model.effects.friction_stribeck_load import StribeckFriction


def on_joints(terms: Terms) -> list[list[Candidate]]:
    """Return one level against each joint's motion, and a level for each direction."""
    sign = terms.reduced_signs
    ahead = terms.reduce(tuple(np.maximum(s, 0.0) for s in terms.signs))
    back = terms.reduce(tuple(np.minimum(s, 0.0) for s in terms.signs))

    def of_joint(j: int) -> list[Candidate]:
        least = below_zero(terms.present.coulomb[j])
        levels = linear("torque_positive", "torque_negative")
        two_sided = [ahead[:, j], back[:, j]]
        return those_there(
            [
                single(terms, CoulombFriction.name, j, [sign[:, j]], linear("torque"), [least]),
                single(terms, CoulombFriction.name, j, two_sided, levels, [least] * 2, variant="two-sided"),
            ]
        )

    return [of_joint(j) for j in range(terms.records.n)]


def sentence(effect: Effect) -> str:
    """Return its level on each joint, or its levels in both directions."""
    assert isinstance(effect, CoulombFriction)
    forward, backward = effect.levels()
    if np.array_equal(forward, backward):
        key = "torque" if "torque" in effect.parameters else "torque_positive"
        return f"dry friction of {values_on_joints(effect, key)}"
    ahead = f"dry friction against positive motion of {values_on_joints(effect, 'torque_positive')}"
    return f"{ahead}; against negative motion of {values_on_joints(effect, 'torque_negative')}"


def worn(here: Parameters, more: Parameters) -> Parameters | None:
    """Return a Stribeck curve less a loss of one level; None where the loss is none of one level, or no loss."""
    if set(more) != {"torque"}:
        return None
    lost, level = more["torque"][0], here["coulomb"][0]
    left = level + lost
    return {
        **here,
        "coulomb": [0.0 if abs(left) < MERGING.rounded * level else left],
        "static": [here["static"][0] + lost],
    }


register(
    EffectRecord(
        effect=CoulombFriction,
        title="Dry friction",
        explanation="A torque of one size that works against motion at any speed. It jumps where the joint turns back.",
        sentence=sentence,
        keys={
            "torque_positive": "torque against positive motion",
            "torque_negative": "torque against negative motion",
        },
        on_joints=on_joints,
        family="friction",
        merge=summed,
        joint_by_joint=True,
        leading=("torque", "torque_positive", "torque_negative"),
        taken_off={StribeckFriction.name: worn},
        everywhere=1,
        usual=True,
        starts=True,
        dry=True,
        holds=True,
        adds=frozenset({"torque", "torque_positive", "torque_negative"}),
        wakes=frozenset({Wakes.REVERSAL}),
    )
)
