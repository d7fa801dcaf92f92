"""Friction that a description states and the arm has not got: a search starts without it, and says it is too much.

Round numbers stand in many descriptions, as a simulator wants some. A search that begins from them finds other names
than one that begins from none: what is left at first sets its noise, and what stays as described stays far off. So both
begin from none, and what was stated is subtracted in the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.findings import Estimate, Finding
from twin_diagram.gap.residuals.prepared_logs import Records, prepare
from twin_diagram.gap.residuals.regressors import present
from twin_diagram.gap.verdict.posterior import unit_of
from twin_diagram.gap.whole_robot.concluding import WholeRobot, corrected
from twin_diagram.gap.whole_robot.estimates import FRICTION, NAMES
from twin_diagram.gap.whole_robot.explain import begun, settled
from twin_diagram.gap.whole_robot.torque_equations import OWN, equations
from twin_diagram.logs import Log
from twin_diagram.model.effects import make
from twin_diagram.model.effects.friction import ViscousFriction
from twin_diagram.model.model import Model
from twin_diagram.scenario import EffectSpec
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    nearer: float = 0.5
    """Share of the friction torque stated, below which what a joint has is nearer to none."""


TUNING = Tuning()


@dataclass(frozen=True)
class Placeholders:
    """What a description states of friction and is none.

    Attributes:
        stated: (n, 2) damping and dry friction per joint, 0 where it may be true.
        records: prepared with the description without that.
    """

    stated: Array
    records: Records


def placeholders(records: Records, logs: Sequence[Log]) -> Placeholders | None:
    """Return what is stated of friction on joints that have rather none of it; None where that is nothing.

    Args:
        records: prepared with the given model.
        logs: they were prepared of.
    """
    model, there = records.model, present(records)
    dry = np.array([model.arm.stated.friction.get(joint, 0.0) for joint in model.joints])
    stated = np.stack([there.damping, dry], axis=1)
    if not np.any(stated) or any(not effect.given for effect in model.effects):
        return None
    whole, z = settled(begun(records, equations(records)))
    own = z[10 * whole.n : 14 * whole.n].reshape(whole.n, len(OWN))[:, [OWN.index(term) for term in FRICTION]]
    rms = whole.sums.own_size[:, [OWN.index(term) for term in FRICTION]]
    found = np.linalg.norm((stated + own) * rms, axis=1)
    none = found < TUNING.nearer * np.linalg.norm(stated * rms, axis=1)
    if not np.any(none):
        return None
    stated = stated * none[:, None]
    return Placeholders(stated, prepare(without(model, stated), logs))


def without(model: Model, stated: Array) -> Model:
    """Return a model whose description does not state some friction.

    Args:
        model: the given one.
        stated: (n, 2) damping and dry friction that is stated and goes.
    """
    at = {joint: level for joint, level in zip(model.joints, stated, strict=True)}
    friction = {j: level for j, level in model.arm.stated.friction.items() if not at.get(j, np.zeros(2))[1]}
    arm = replace(model.arm, stated=replace(model.arm.stated, friction=friction))
    damped = [joint for joint, level in at.items() if level[0]]
    less = {"damping": [-float(at[joint][0]) for joint in damped]}
    spec = EffectSpec(ViscousFriction.name, damped, [], less)
    return Model(model.plant, arm, [*model.effects, *([make(spec)] if damped else [])])


def as_of_the_description(found: WholeRobot, given: Records, stated: Array) -> WholeRobot | None:
    """Return what was found relative to the description with all that it states; None where that cannot be.

    Args:
        found: relative to it without placeholders.
        given: prepared with it.
        stated: (n, 2) what is taken away, see `Placeholders`.
    """
    findings = list(found.findings)
    for k, term in enumerate(FRICTION):
        findings = relative(findings, found, term, stated[:, k])
    model = corrected(given.model, findings, [record.mark for record in given.records])
    if model is None:
        return None
    return replace(found, model=model, findings=tuple(findings), before=equations(given).residual_rms)


def relative(findings: Sequence[Finding], found: WholeRobot, term: str, stated: Array) -> list[Finding]:
    """Return findings with one term of joints' friction relative to what is stated of it (n,).

    Errors stay those of what a joint has: a placeholder says nothing that it could be compared with.
    """
    name, key = NAMES[term]
    if not np.any(stated):
        return list(findings)
    model, surplus = found.model, surplus_of(found, term, stated)
    mine = [one for one in findings if one.name == name and key in one.parameters]
    before = mine[0].parameters[key] if mine else {}
    assert isinstance(before, dict)
    values: dict[str, Estimate] = {}
    for joint, level in zip(model.joints, map(float, stated), strict=True):
        none = Estimate(0.0, level / np.sqrt(12.0), unit_of(name, key, joint in model.prismatic))
        one = before.get(joint, none if level else None)
        if one is None:
            continue
        values[joint] = replace(one, value=float(np.asarray(one.value)) - level)
    rest = [one for one in findings if one not in mine]
    sure = float(1.0 / (1.0 + np.exp(-np.clip(surplus, -30.0, 30.0))))
    told = mine[0] if mine else Finding(name, (), (), {}, sure)
    told = replace(told, joints=tuple(values), parameters={**told.parameters, key: dict(values)})
    at = [k for k, one in enumerate(findings) if one in mine]
    return [*rest[: at[0]], told, *rest[at[0] :]] if at else [told, *rest]


def surplus_of(found: WholeRobot, term: str, stated: Array) -> float:
    """Return by how much less likely logs are with what is stated of one term, on the joint where that is least [nats].

    Args:
        found: without it.
        term: of `FRICTION`.
        stated: (n,) what is stated of it.
    """
    problem, joints = found.problem, np.flatnonzero(stated)
    z = found.coordinates.copy()
    z[10 * problem.n + len(OWN) * joints + OWN.index(term)] = stated[joints]
    with_it, now = (problem.squares(x, problem.sums.whole) for x in (z, found.coordinates))
    rise = 0.5 * problem.share * problem.sums.counted * np.log(np.maximum(with_it, 1e-30) / np.maximum(now, 1e-30))
    return float(np.min(rise[joints]))
