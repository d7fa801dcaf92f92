"""Calls friction dry where refinement left nothing of the dip by which it was named after Stribeck."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.findings import Alternative, Estimate, Finding, Separation, Verdict
from twin_diagram.model.effects.friction import CoulombFriction
from twin_diagram.model.effects.friction_stribeck_load import StribeckFriction


@dataclass(frozen=True)
class Tuning:
    """What is left of a dip that is none; by hand."""

    share: float = 0.05
    """Of friction at speed: friction at rest that is off it by less makes no difference to any motion."""

    errors: float = 2.0
    """Standard errors, likewise: what is off by more has been seen."""


TUNING = Tuning()


def without_lost_dips(verdict: Verdict, order: Sequence[str]) -> Verdict:
    """Return the verdict with `coulomb_friction` on each joint whose friction at rest is that at speed.

    Args:
        verdict: with refined sizes.
        order: of the model's joints.
    """
    findings: list[Finding] = []
    dry: list[Finding] = []
    for finding in verdict.findings:
        lost = tuple(
            joint for joint in finding.joints if finding.name == StribeckFriction.name and _lost(finding, joint)
        )
        kept = tuple(joint for joint in finding.joints if joint not in lost)
        if lost:
            dry.append(_dry(finding, lost))
        if kept or not lost:
            findings.append(_on(finding, kept) if lost else finding)
    if not dry:
        return verdict
    for finding in dry:
        findings = _joined(findings, finding, order)
    return replace(verdict, findings=tuple(findings), separation=_still_apart(verdict, findings))


def _lost(finding: Finding, joint: str) -> bool:
    speed, rest = (_estimate(finding, key, joint) for key in ("coulomb", "static"))
    if (
        finding.name != StribeckFriction.name
        or speed is None
        or rest is None
        or finding.onset is not None
        or finding.end is not None
    ):
        return False
    (low, low_error), (high, high_error) = ((np.asarray(e.value), np.asarray(e.std)) for e in (speed, rest))
    error = np.hypot(low_error, high_error)
    return bool(abs(high - low) < min(TUNING.errors * error, TUNING.share * abs(low)))


def _estimate(finding: Finding, key: str, joint: str) -> Estimate | None:
    values = finding.parameters.get(key)
    return values.get(joint) if isinstance(values, dict) else None


def _on(finding: Finding, joints: Sequence[str]) -> Finding:
    parameters: dict[str, Estimate | dict[str, Estimate]] = {
        key: {joint: value[joint] for joint in joints if joint in value} if isinstance(value, dict) else value
        for key, value in finding.parameters.items()
    }
    return replace(finding, joints=tuple(joints), parameters=parameters)


def _dry(finding: Finding, joints: tuple[str, ...]) -> Finding:
    """Return the finding as dry friction; as such it has the probability of both names."""
    level = _on(finding, joints).parameters["coulomb"]
    same = [other for other in finding.alternatives if _is_dry_on(other, finding.joints)]
    return replace(
        finding,
        name=CoulombFriction.name,
        joints=joints,
        parameters={"torque": level},
        confidence=min(1.0, finding.confidence + sum(other.probability for other in same)),
        alternatives=tuple(other for other in finding.alternatives if other not in same),
    )


def _is_dry_on(other: Alternative, joints: tuple[str, ...]) -> bool:
    return other.name == CoulombFriction.name and other.joints == joints


def _joined(findings: list[Finding], dry: Finding, order: Sequence[str]) -> list[Finding]:
    """Return findings with dry friction among them: one entry per name."""
    for k, other in enumerate(findings):
        torque, more = other.parameters.get("torque"), dry.parameters["torque"]
        if other.name == dry.name and other.onset is None and isinstance(torque, dict) and isinstance(more, dict):
            both = replace(
                other,
                joints=tuple(sorted((*other.joints, *dry.joints), key=order.index)),
                parameters={**other.parameters, "torque": {**torque, **more}},
                confidence=min(other.confidence, dry.confidence),
            )
            return [*findings[:k], both, *findings[k + 1 :]]
    return [*findings, dry]


def _still_apart(verdict: Verdict, findings: Sequence[Finding]) -> tuple[Separation, ...]:
    """Return the near pairs of which what was named still is."""
    names = {finding.name for finding in findings}
    return tuple(pair for pair in verdict.separation if pair.a.split(" on ")[0] in names)
