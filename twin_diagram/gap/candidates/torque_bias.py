"""A constant torque beyond what is logged: its candidates and its record."""

from __future__ import annotations

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.candidates.joint_candidate import single, those_there
from twin_diagram.gap.candidates.merging import summed
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.candidates.wording import effort, values_on_joints
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.actuation import TorqueBias


def on_joints(terms: Terms) -> list[list[Candidate]]:
    """Return the same torque at all times, on each joint."""
    one = np.ones(len(terms.reduce(terms.load)))
    key = linear("torque", scale=-1.0)
    return [those_there([single(terms, TorqueBias.name, j, [one], key, [-np.inf])]) for j in range(terms.records.n)]


def sentence(effect: Effect) -> str:
    """Return its torque on each joint."""
    return f"a constant {effort(effect)} beyond the logged one of {values_on_joints(effect, 'torque')}"


register(
    EffectRecord(
        effect=TorqueBias,
        title="A constant torque",
        explanation="A torque that is always there, beyond what is logged: an offset of the sensor.",
        sentence=sentence,
        on_joints=on_joints,
        family="motor",
        merge=summed,
        joint_by_joint=True,
        starts=True,
        motor=True,
        adds=frozenset({"torque"}),
        wakes=frozenset({Wakes.POSE}),
    )
)
