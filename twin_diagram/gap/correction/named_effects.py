"""A finding as the effects that it names: what a model takes, and what says itself in a sentence."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np

from twin_diagram.errors import ModelError
from twin_diagram.gap.candidates.records import record_of, sentence
from twin_diagram.gap.findings import Estimate, Finding
from twin_diagram.model.effects import REGISTRY, Effect, make
from twin_diagram.scenario import EffectSpec


def specs_of(finding: Finding, fingerprints: Sequence[str] = ()) -> list[EffectSpec]:
    """Return one specification, or several where places hold different parameters (a curve here, a stiffness there).

    Args:
        finding: named.
        fingerprints: of the fit logs, for onsets; empty: they are about any log.
    """
    shared = {key: value for key, value in finding.parameters.items() if isinstance(value, Estimate)}
    per_joint = {key: value for key, value in finding.parameters.items() if not isinstance(value, Estimate)}
    when = finding.onset or finding.end

    def spec(
        joints: Sequence[str], parameters: dict[str, list[float]], links: Sequence[str] | None = None
    ) -> EffectSpec:
        return EffectSpec(
            name=finding.name,
            joints=list(joints),
            links=list(finding.links if links is None else links),
            parameters=parameters,
            onset=None if finding.onset is None else float(finding.onset.time),
            end=None if finding.end is None else float(finding.end.time),
            log=fingerprints[when.log] if when is not None and len(fingerprints) else "",
            elsewhere={} if when is None else dict.fromkeys(fingerprints[: when.log], math.inf),
        )

    if not per_joint:
        return [spec(finding.joints, {key: _numbers(value) for key, value in shared.items()})]
    if not finding.joints:
        return [
            spec((), {key: _numbers(values[link]) for key, values in per_joint.items()}, [link])
            for link in finding.links
        ]
    cls = REGISTRY.get(finding.name)
    if cls is not None and not cls.per_joint:
        first = {key: _numbers(next(iter(values.values()))) for key, values in per_joint.items()}
        return [spec(finding.joints, first)]
    groups: dict[tuple[str, ...], list[str]] = {}
    for joint in finding.joints:
        keys = tuple(key for key, values in per_joint.items() if joint in values)
        lists = any(len(_numbers(per_joint[key][joint])) > 1 for key in keys)
        groups.setdefault((*keys, joint) if lists else keys, []).append(joint)
    return [
        spec(
            joints,
            {
                key: [x for joint in joints for x in _numbers(values[joint])]
                for key, values in per_joint.items()
                if joints[0] in values
            },
        )
        for joints in groups.values()
    ]


def effects_of(finding: Finding, fingerprints: Sequence[str] = ()) -> list[Effect]:
    """Return the same as effects.

    Raises:
        ModelError: parameters that do not fit the catalogue.
    """
    return [make(spec) for spec in specs_of(finding, fingerprints)]


def sentence_of(finding: Finding, prismatic: Collection[str] = ()) -> str:
    """Return what a finding says: its effects' own sentences, or what is less of where the given model has too much.

    Args:
        finding: named.
        prismatic: the prismatic ones of the arm's joints (`Model.prismatic`), whose parameters have other units.
    """
    amount = amount_of(finding)
    if amount == "more":
        try:
            return "; ".join(sentence(effect.on_arm(prismatic)) for effect in effects_of(finding))
        except ModelError:
            amount = "other"
    places = ", ".join([*finding.joints, *finding.links])
    return f"{amount} {finding.name.replace('_', ' ')} than the model has" + (f", on {places}" if places else "")


def amount_of(finding: Finding) -> str:
    """Return whether the arm has `more` of an effect than the given model, `less`, or, on different joints, `other`."""
    leading = record_of(finding.name).leading
    values = [x for spec in specs_of(finding) for key in leading for x in spec.parameters.get(key, [])]
    below = [x < 0.0 for x in values]
    return "less" if values and all(below) else "other" if any(below) else "more"


def _numbers(estimate: Estimate) -> list[float]:
    return [float(x) for x in np.atleast_1d(np.asarray(estimate.value, dtype=float))]
