"""Inertia of a motor's rotor: its candidates and its record."""

from __future__ import annotations

from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.candidates.joint_candidate import below_zero, single, those_there
from twin_diagram.gap.candidates.merging import summed
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.candidates.wording import values_on_joints
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.inertia import ReflectedInertia


def on_joints(terms: Terms) -> list[list[Candidate]]:
    """Return torque in proportion to each joint's acceleration."""
    a = terms.records.reduce(lambda r: r.a)
    least = [below_zero(rotor) for rotor in terms.present.rotor]
    return [
        those_there([single(terms, ReflectedInertia.name, j, [a[:, j]], linear("inertia"), [least[j]])])
        for j in range(terms.records.n)
    ]


def sentence(effect: Effect) -> str:
    """Return its inertia on each joint."""
    return f"reflected inertia of {values_on_joints(effect, 'inertia')}"


register(
    EffectRecord(
        effect=ReflectedInertia,
        title="Inertia of a motor's rotor",
        explanation=(
            "The rotor turns faster than the joint by the gear's ratio; the joint feels it times the ratio squared."
        ),
        sentence=sentence,
        on_joints=on_joints,
        merge=summed,
        joint_by_joint=True,
        leading=("inertia",),
        everywhere=3,
        usual=True,
        swung=True,
        of_rotor=True,
        adds=frozenset({"inertia"}),
        wakes=frozenset({Wakes.ACCELERATION}),
    )
)
