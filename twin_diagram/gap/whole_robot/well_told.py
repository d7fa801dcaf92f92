"""What of a search's findings is known well enough to bear its name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.gap.candidates.records import record_of
from twin_diagram.gap.findings import Estimate, Finding
from twin_diagram.signals.arrays import Array

SIZES = (
    *("gain", "delay", "offset", "amplitude", "coefficient", "torque", "wrench", "roll", "pitch"),
    *("limit", "gap", "stiffness"),
)
"""Parameters that say how large an effect is whose record names none as leading."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    third: float = 1.0 / 3.0
    """No name where the standard error is more than this share of what it says."""


TUNING = Tuning()


def well_told(findings: Sequence[Finding], rough: float = 1.0) -> tuple[Finding, ...]:
    """Return findings without the joints, or the names, whose size is known no better than to a third of it.

    Args:
        findings: any.
        rough: times a third that counts as one: errors are known only so well.
    """
    most = rough * TUNING.third
    result = []
    for finding in findings:
        per_joint = any(isinstance(value, dict) for value in finding.parameters.values())
        if not (per_joint and finding.joints):
            if _known([value for key, value in _sizes(finding) if isinstance(value, Estimate)], finding, most):
                result.append(finding)
            continue
        kept = tuple(joint for joint in finding.joints if _known(_of_joint(finding, joint), finding, most))
        if kept == finding.joints:
            result.append(finding)
        elif kept and record_of(finding.name).joint_by_joint:
            parameters: dict[str, Estimate | dict[str, Estimate]] = {
                key: {joint: value[joint] for joint in kept if joint in value} if isinstance(value, dict) else value
                for key, value in finding.parameters.items()
            }
            result.append(replace(finding, joints=kept, parameters=parameters))
    return tuple(result)


def _sizes(finding: Finding) -> list[tuple[str, Estimate | dict[str, Estimate]]]:
    keys = record_of(finding.name).leading or SIZES
    return [(key, value) for key, value in finding.parameters.items() if key in keys]


def _of_joint(finding: Finding, joint: str) -> list[Estimate]:
    return [value[joint] for _, value in _sizes(finding) if isinstance(value, dict) and joint in value]


def share_of(finding: Finding, joint: str) -> float:
    """Return the standard error of what is known best of a finding's size, as a share of it; 0 where it has none.

    Args:
        finding: any.
        joint: which one; empty: of all of it.
    """
    sizes = [value for _, value in _sizes(finding) if isinstance(value, Estimate)]
    return _least(_of_joint(finding, joint) if joint else sizes, finding)


def _known(sizes: Sequence[Estimate], finding: Finding, most: float) -> bool:
    """Return whether any of the sizes is known to a share `most`; one that has none is."""
    return _least(sizes, finding) <= most


def _least(sizes: Sequence[Estimate], finding: Finding) -> float:
    nothing = 1.0 if "gain" in finding.parameters else 0.0
    return min((_share(size, nothing) for size in sizes), default=0.0)


def _share(size: Estimate, nothing: float) -> float:
    """Return the standard error as a share of what is said; of a wrench see `share_along`."""
    value, std = (np.atleast_1d(np.asarray(x, dtype=np.float64)) for x in (size.value, size.std))
    return share_along(value, std, nothing)


def share_along(value: Array, std: Array, nothing: float = 0.0) -> float:
    """Return the standard error as a share of what is said; of a wrench, of force or moment, along what it says.

    Across its own direction a small error would count the most, as there is nothing that it is a share of.

    Args:
        value: a number, a force, or force and moment.
        std: its standard errors.
        nothing: the value that says nothing.
    """
    shares = []
    for part in (slice(0, 3), slice(3, None)) if len(value) > 1 else (slice(None),):
        told = value[part] - nothing
        along = float(np.linalg.norm(told * std[part]))
        shares.append(along / float(told @ told) if np.any(told) else np.inf)
    return min(shares)
