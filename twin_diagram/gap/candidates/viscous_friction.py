"""Viscous friction: its candidates and its record."""

from __future__ import annotations

from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.candidates.joint_candidate import below_zero, single, those_there
from twin_diagram.gap.candidates.merging import summed
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.candidates.wording import values_on_joints
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.friction import ViscousFriction


def on_joints(terms: Terms) -> list[list[Candidate]]:
    """Return torque in proportion to each joint's speed."""
    speed = terms.records.reduce(lambda r: r.v)
    least = [below_zero(damping) for damping in terms.present.damping]
    return [
        those_there([single(terms, ViscousFriction.name, j, [speed[:, j]], linear("damping"), [least[j]])])
        for j in range(terms.records.n)
    ]


def sentence(effect: Effect) -> str:
    """Return its damping on each joint."""
    return f"viscous friction of {values_on_joints(effect, 'damping')}"


register(
    EffectRecord(
        effect=ViscousFriction,
        title="Viscous friction",
        explanation="A torque that grows with speed and works against it, as in oil or grease.",
        sentence=sentence,
        on_joints=on_joints,
        family="friction",
        merge=summed,
        joint_by_joint=True,
        leading=("damping",),
        everywhere=2,
        usual=True,
        starts=True,
        adds=frozenset({"damping"}),
        wakes=frozenset({Wakes.SPEED}),
    )
)
