"""Friction is named after Stribeck where its dip is there after refinement, too."""

from __future__ import annotations

import numpy as np

from twin_diagram.gap.findings import Alternative, Estimate, Finding, Separation, Verdict
from twin_diagram.gap.whole_robot.lost_dips import without_lost_dips

ORDER = ("a", "b", "c")


def stribeck(**levels: tuple[float, float, float]) -> Finding:
    """Friction at speed, at rest, and the standard error of either, by joint."""
    parameters: dict[str, Estimate | dict[str, Estimate]] = {
        "coulomb": {joint: Estimate(low, std, "N·m") for joint, (low, _, std) in levels.items()},
        "static": {joint: Estimate(high, std, "N·m") for joint, (_, high, std) in levels.items()},
        "stribeck_velocity": {joint: Estimate(0.03, 0.01, "rad/s") for joint in levels},
    }
    dry = Alternative("coulomb_friction", tuple(levels), (), 0.04)
    other = Alternative("joint_spring", tuple(levels), (), 0.01)
    return Finding("stribeck_friction", tuple(levels), (), parameters, 0.95, (dry, other))


def verdict(*findings: Finding) -> Verdict:
    near = (Separation("stribeck_friction on a", "coulomb_friction on a", 3.0, "crawl"),)
    return Verdict("named", False, findings, near, (), np.ones(3))


def test_a_dip_that_is_gone_leaves_dry_friction() -> None:
    (found,) = without_lost_dips(verdict(stribeck(a=(1.5, 1.503, 0.02))), ORDER).findings
    assert (found.name, found.joints, set(found.parameters)) == ("coulomb_friction", ("a",), {"torque"})
    assert found.parameters["torque"] == {"a": Estimate(1.5, 0.02, "N·m")}
    assert abs(found.confidence - 0.99) < 1e-12 and [each.name for each in found.alternatives] == ["joint_spring"]
    assert without_lost_dips(verdict(stribeck(a=(1.5, 1.503, 0.02))), ORDER).separation == ()


def test_a_dip_that_is_small_but_seen_or_large_but_unsure_stays() -> None:
    for kept in (stribeck(a=(1.5, 1.55, 0.01)), stribeck(a=(1.5, 1.9, 0.3))):
        before = verdict(kept)
        assert without_lost_dips(before, ORDER) is before


def test_joints_are_told_apart_and_joined() -> None:
    """Of two joints named after Stribeck one keeps its dip; the other comes to where dry friction was named."""
    dry = Finding("coulomb_friction", ("c",), (), {"torque": {"c": Estimate(2.0, 0.1, "N·m")}}, 0.8)
    after = without_lost_dips(verdict(dry, stribeck(a=(1.5, 2.1, 0.02), b=(1.0, 1.0, 0.02))), ORDER).findings
    assert [(each.name, each.joints, each.confidence) for each in after] == [
        ("coulomb_friction", ("b", "c"), 0.8),
        ("stribeck_friction", ("a",), 0.95),
    ]
    assert set(after[1].parameters["static"]) == {"a"}  # type: ignore[arg-type]
