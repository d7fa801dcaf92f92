"""Friction on the sum of two joints' speeds: its candidates and its record."""

from __future__ import annotations

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.candidates.merging import summed
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.residuals.regressors import Terms
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.friction_stribeck_load import CoupledFriction


def on_joints(terms: Terms) -> list[list[Candidate]]:
    """Return friction between each joint and the next."""
    return [[] if i + 1 == terms.records.n else _of_pair(terms, (i, i + 1)) for i in range(terms.records.n)]


def _of_pair(terms: Terms, pair: tuple[int, int]) -> list[Candidate]:
    speed = terms.records.reduce(lambda r: r.v[:, pair[0]] + r.v[:, pair[1]])
    slow = float(np.hypot(terms.slow[pair[0]], terms.slow[pair[1]]))
    sign = terms.records.reduce(lambda r: np.tanh((r.v[:, pair[0]] + r.v[:, pair[1]]) / slow))
    size = np.sqrt([np.mean(speed**2), np.mean(sign**2)])
    if not np.all(size > 1e-12):
        return []
    both = np.repeat(np.stack([speed, sign], axis=-1)[:, None, :], 2, axis=1)
    scale = float(np.min(terms.torque_size[list(pair)]))
    return [
        Candidate(
            name=CoupledFriction.name,
            joints=pair,
            links=(),
            rows=pair,
            columns=both,
            spread=scale / size,
            lower=np.array([0.0, 0.0]),
            upper=np.full(2, np.inf),
            parameters=linear("damping", "torque"),
        )
    ]


def sentence(effect: Effect) -> str:
    """Return its damping and its level, in the units of all its joints."""
    damping, torque = (
        f"{effect.value(key)[0]:.4g} {' or '.join(dict.fromkeys(effect.unit(key, joint) for joint in effect.joints))}"
        for key in ("damping", "torque")
    )
    return f"friction on the sum of the speeds of {', '.join(effect.joints)}: {damping} and {torque}"


register(
    EffectRecord(
        effect=CoupledFriction,
        title="Friction between coupled joints",
        explanation="Friction on the sum of several joints' speeds, as where one gear runs inside another.",
        sentence=sentence,
        on_joints=on_joints,
        merge=summed,
        leading=("damping", "torque"),
        dry=True,
        coupled=True,
        adds=frozenset({"damping", "torque"}),
        wakes=frozenset({Wakes.REVERSAL, Wakes.SPEED}),
    )
)
