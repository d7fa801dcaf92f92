"""One name on several joints: a strong one makes a weak one on the next joint easy to believe, or hard to rule out."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.gap_bench import arm, run
from twin_diagram.gap.findings import Finding
from twin_diagram.gap.naming import name
from twin_diagram.gap.verdict.posterior import unseen
from twin_diagram.model.model import Model
from twin_diagram.scenario import EffectSpec


def found(folder: Path, weak: float) -> Finding:
    """Of a strong ripple on the shoulder and one of some amplitude [N·m] on the elbow."""
    values = {"amplitude": [0.3, weak], "cycles": [9.0, 14.0], "phase": [0.4, 1.1]}
    model = Model.load(arm(folder))
    specs = [EffectSpec(name="torque_ripple", joints=["shoulder", "elbow"], parameters=values)]
    (finding,) = name(model, [run(model, specs, seed=2)]).findings
    return finding


@pytest.mark.long
def test_a_weak_ripple_is_named_where_another_joint_has_a_strong_one(tmp_path: Path) -> None:
    finding = found(tmp_path, 0.015)
    assert (finding.name, finding.joints) == ("torque_ripple", ("shoulder", "elbow"))


@pytest.mark.long
def test_one_that_hardly_shows_leaves_the_name_less_sure(tmp_path: Path) -> None:
    finding = found(tmp_path, 0.013)
    assert finding.joints == ("shoulder",)
    assert finding.confidence < 0.9
    assert finding.alternatives[0].joints == ("shoulder", "elbow")


def test_the_more_joints_there_are_the_more_may_hide_a_weak_spring() -> None:
    springs = [unseen(("joint_elasticity", (1,), ()), joints) for joints in (1, 2, 6, 7)]
    assert springs[0] == 0.0
    assert springs == sorted(springs)
    assert unseen(("joint_elasticity", (0, 1), ()), 6) > springs[2]
    assert unseen(("viscous_friction", (1,), ()), 7) == pytest.approx(0.0)
