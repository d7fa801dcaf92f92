"""A gear that gives like a spring: its candidates and its record; those that swing are made in `gears`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.candidate import Candidate, transformed
from twin_diagram.gap.candidates.gears import rebuilt, swinging
from twin_diagram.gap.candidates.merging import Parameters
from twin_diagram.gap.candidates.records import EffectRecord, Wakes, register
from twin_diagram.gap.residuals.prepared_logs import Record
from twin_diagram.gap.residuals.regressors import Terms, rate_of
from twin_diagram.model.effects import Effect
from twin_diagram.model.effects.elasticity import JointElasticity
from twin_diagram.model.effects.inertia import ReflectedInertia
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    cost: float = 3.0
    """Of a gear that follows its load [nats]."""

    swings: float = 8.0
    """Of the search for one that swings: two dozen are tried, and three numbers refined [nats]."""

    share: float = 0.025
    """Of what the rotor brings, which a spring must bring beyond it."""


TUNING = Tuning()


def on_arm(terms: Terms) -> list[Candidate]:
    """Link angle = motor angle − transmitted torque / stiffness; coefficients 1/stiffness and rotor inertia."""
    model = terms.records.model
    tree = model.tree
    result = []
    for j in range(terms.records.n):
        others = np.arange(terms.records.n)

        def law(record: Record, load: Array, j: int = j) -> Array:
            twist = load[:, j]
            rate = rate_of(twist[:, None], record)[:, 0]
            second = rate_of(rate[:, None], record)[:, 0]
            unit = 1e-7 * np.eye(terms.records.n)[j]
            angles = terms.records.angles(record)
            q = angles - np.outer(twist, unit)
            v = record.v - np.outer(rate, unit)
            a = record.a - np.outer(second, unit)
            bare = replace(tree, rotor=np.zeros_like(tree.rotor), damping=np.zeros_like(tree.damping))
            there = bare.inverse_dynamics(q, v, a) - bare.inverse_dynamics(angles, record.v, record.a)
            columns = np.zeros((*record.q.shape, 2))
            columns[..., 0] = there / 1e-7
            columns[:, j, 1] = record.a[:, j]
            return columns

        columns = terms.reduce(tuple(law(r, load) for r, load in zip(terms.records.records, terms.load, strict=True)))

        def values(c: Array) -> dict[str, Array]:
            return {"stiffness": 1.0 / c[0:1], "rotor_inertia": c[1:2]}

        size = max(float(np.sqrt(np.mean(columns[:, j, 1] ** 2))), 1e-9)
        result.append(
            Candidate(
                name=JointElasticity.name,
                joints=(j,),
                links=(),
                rows=tuple(int(i) for i in others),
                columns=columns,
                spread=np.array([3e-4, terms.torque_size[j] / size]),
                lower=np.array([1e-6, -1.05 * terms.present.rotor[j]]),
                upper=np.array([1e-1, np.inf]),
                parameters=transformed(values),
                cost=TUNING.cost,
            )
        )
    return result


def merge(here: Parameters, more: Parameters) -> Parameters:
    """Return two springs in series, and both rotors."""
    stiffness = 1.0 / (1.0 / here["stiffness"][0] + 1.0 / more["stiffness"][0])
    result = {"stiffness": [stiffness], "rotor_inertia": [here["rotor_inertia"][0] + more["rotor_inertia"][0]]}
    if "loss" in here and "loss" in more:
        lost = here["loss"][0] / here["stiffness"][0] + more["loss"][0] / more["stiffness"][0]
        result["loss"] = [lost * stiffness]
    return result


def sentence(effect: Effect) -> str:
    """Return its stiffness and what its rotor has more, on each joint."""
    parts = (
        f"{k:.4g} {effect.unit('stiffness', joint)} on {joint}"
        + (f" behind a rotor of {b:.4g} {effect.unit('rotor_inertia', joint)} more" if b > 0.0 else "")
        for joint, k, b in zip(effect.joints, effect.value("stiffness"), effect.value("rotor_inertia"), strict=True)
    )
    return f"an elastic gear of {'; '.join(parts)}"


register(
    EffectRecord(
        effect=JointElasticity,
        title="An elastic gear",
        explanation="The gear gives like a spring: the link moves behind the motor, and swings.",
        sentence=sentence,
        on_arm=on_arm,
        smooth=False,
        shapes=swinging(("stiffness", 0.75, 1.33), ("loss", 0.25, 4.0), ("stiffness", 0.93, 1.07)),
        rebuilt=rebuilt,
        shape_cost=TUNING.swings,
        rivals=frozenset({ReflectedInertia.name}),
        plainer=ReflectedInertia.name,
        plainer_share=TUNING.share,
        share_of_own=True,
        merge=merge,
        joint_by_joint=True,
        swung=True,
        unseen=0.03,  # set on training logs
        adds=frozenset({"stiffness", "rotor_inertia"}),
        logarithmic=frozenset({"stiffness", "loss"}),
        untold=frozenset({"loss"}),
        scanned="stiffness",
        wakes=frozenset({Wakes.ACCELERATION}),
    )
)
