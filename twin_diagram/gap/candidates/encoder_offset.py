"""An encoder whose zero is elsewhere: its candidates and its record."""

from __future__ import annotations

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.candidates.joint_candidate import those_there
from twin_diagram.gap.candidates.merging import summed
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.candidates.wording import values_on_joints
from twin_diagram.gap.residuals.prepared_logs import Record
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.sensing import EncoderOffset
from twin_diagram.signals.arrays import Array


def on_arm(terms: Terms) -> list[Candidate]:
    """Return true position = measured − offset, on each joint."""
    return those_there(encoder_offset(terms, j) for j in range(terms.records.n))


def encoder_offset(terms: Terms, j: int, about: float = 0.0) -> Candidate | None:
    """Return it on one joint, to first order about half of `about`; none where it makes no difference."""
    model = terms.records.model

    def law(record: Record) -> Array:
        step = np.zeros(terms.records.n)
        step[j] = 1e-4
        q = record.q - 0.5 * about * (step > 0.0)
        ahead = model.inverse_dynamics(q + step, record.v, record.a)
        behind = model.inverse_dynamics(q - step, record.v, record.a)
        return -(ahead - behind) / 2e-4

    reduced = terms.records.reduce(law) if about else terms.records.reduce_once(EncoderOffset.name, j, law)
    columns = reduced[..., None]
    if np.max(np.sqrt(np.mean(columns**2, axis=0))) < 1e-6:
        return None
    return Candidate(
        name=EncoderOffset.name,
        joints=(j,),
        links=(),
        rows=tuple(range(terms.records.n)),
        columns=columns,
        spread=np.array([0.1]),
        lower=np.array([-0.6]),
        upper=np.array([0.6]),
        parameters=linear("offset"),
    )


def recentred(terms: Terms, candidate: Candidate, coefficients: Array) -> Candidate | None:
    """Return it about half of an offset."""
    return encoder_offset(terms, candidate.joints[0], float(coefficients[0]))


def sentence(effect: Effect) -> str:
    """Return its offset on each joint."""
    return f"encoders read too much by {values_on_joints(effect, 'offset')}"


register(
    EffectRecord(
        effect=EncoderOffset,
        title="A shifted encoder",
        explanation="The encoder's zero is not where the model has it.",
        sentence=sentence,
        on_arm=on_arm,
        recentred=recentred,
        merge=summed,
        joint_by_joint=True,
        starts=True,
        swung=True,
        wakes=frozenset({Wakes.POSE}),
    )
)
