"""A motor that gives another torque than its log says: its candidates and its record."""

from __future__ import annotations

from twin_diagram.gap.candidates.candidate import Candidate, transformed
from twin_diagram.gap.candidates.joint_candidate import single, those_there
from twin_diagram.gap.candidates.merging import multiplied
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.candidates.wording import effort
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.actuation import ActuatorFault, TorqueConstant
from twin_diagram.signals.arrays import Array


def on_joints(terms: Terms) -> list[list[Candidate]]:
    """Return torque in proportion to what each joint transmits."""
    load = terms.reduce(terms.load)

    def gain(c: Array) -> dict[str, Array]:
        return {"gain": 1.0 / (1.0 + c[0:1])}

    return [
        those_there([single(terms, TorqueConstant.name, j, [load[:, j]], transformed(gain), [-0.75], [4.0])])
        for j in range(terms.records.n)
    ]


def sentence(effect: Effect) -> str:
    """Return its gain on each joint."""
    parts = (f"{x:.4g} times on {j}" for j, x in zip(effect.joints, effect.value("gain"), strict=True))
    return f"the motors give the logged {effort(effect)} {', '.join(parts)}"


register(
    EffectRecord(
        effect=TorqueConstant,
        title="A wrong torque constant",
        explanation="The motor gives more or less than its log says, always by one factor.",
        sentence=sentence,
        keys={"gain": "torque applied over torque logged"},
        on_joints=on_joints,
        family="motor",
        merge=multiplied,
        joint_by_joint=True,
        starts=True,
        started=ActuatorFault.name,
        motor=True,
        swung=True,
        held=frozenset({"gain"}),
        wakes=frozenset({Wakes.LOAD}),
    )
)
