"""What records say where it decides: order of candidates, prices in nats, what a law must bring, words and units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from tests.gap.made import effect
from twin_diagram.gap.candidates import records as records_of
from twin_diagram.gap.candidates.candidate import Candidate, linear
from twin_diagram.gap.candidates.records import (
    EffectRecord,
    catalogue_candidates,
    record_of,
    records,
    sentence,
)
from twin_diagram.gap.candidates.wording import effort, name_and_place, values_on_joints
from twin_diagram.gap.search.greedy_search import handicaps
from twin_diagram.gap.search.prior_costs import price
from twin_diagram.gap.verdict.posterior import unseen
from twin_diagram.model.effects import REGISTRY, Effect, ParameterKind


def at(name: str, joint: int = 0, **more: Any) -> Candidate:
    one = np.ones(1)
    return Candidate(name, (joint,), (), (joint,), np.ones((4, 1, 1)), one, -9.0 * one, 9.0 * one, linear("x"), **more)


def test_candidates_come_joint_by_joint_within_a_family_and_the_arms_last(monkeypatch: pytest.MonkeyPatch) -> None:
    def on_joints(name: str) -> Any:
        return lambda terms: [[at(name, j)] for j in range(2)]

    made = {
        "a": EffectRecord(Effect, "", "", on_joints=on_joints("a"), family="dry", on_arm=lambda terms: [at("arm", 9)]),
        "b": EffectRecord(Effect, "", "", on_joints=on_joints("b"), family="dry"),
        "c": EffectRecord(Effect, "", "", on_joints=on_joints("c")),
        "none": EffectRecord(Effect, "", ""),
    }

    class Named(Effect):
        name: ClassVar[str] = "c"

    made["c"] = replace(made["c"], effect=Named)
    monkeypatch.setattr(records_of, "RECORDS", made)
    terms: Any = None
    places = [(c.name, c.joints[0]) for c in catalogue_candidates(terms)]
    assert places == [("a", 0), ("b", 0), ("a", 1), ("b", 1), ("c", 0), ("c", 1), ("arm", 9)]


def test_a_class_without_a_record_says_what_it_says_of_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    class Sticky(Effect):
        """Glue in the gear.

        More of it.
        """

        name: ClassVar[str] = "sticky_gear"
        kinds: ClassVar[Mapping[str, ParameterKind]] = {"glue": ParameterKind("N·m")}

        def sentence(self) -> str:
            return "it sticks"

    monkeypatch.setitem(REGISTRY, "sticky_gear", Sticky)
    record = record_of("sticky_gear")
    assert record.effect is Sticky and record.title == "Sticky gear" and record.explanation == "Glue in the gear."
    assert not record.positive and sentence(Sticky(["a"])) == "it sticks"
    nothing = record_of("never_heard_of")
    assert nothing.effect is Effect and nothing.explanation == ""
    assert sentence(effect("torque_bias", ["a"], torque=2.0)) == record_of("torque_bias").sentence(
        effect("torque_bias", ["a"], torque=2.0)
    )
    assert record_of("coulomb_friction").positive and not record_of("torque_bias").positive


def test_a_push_without_a_moment_turns_nothing() -> None:
    push = sentence(
        effect("external_force", links=["hand"], wrench=[1.0, 2.0, 3.0, 0.0, 0.0, 0.0], point=[0.0, 0.1, 0.0])
    )
    assert push == "something pushes hand at (0, 0.1, 0) m with (1, 2, 3) N, in world axes"
    turned = sentence(effect("external_force", links=["hand"], wrench=[1.0, 2.0, 3.0, 0.0, 4.0, 0.0], point=[0.0] * 3))
    assert turned == "something pushes hand with (1, 2, 3) N and turns it with (0, 4, 0) N·m, in world axes"


def test_prices_in_nats() -> None:
    """Six a name, three a further joint, six a further ripple on one, four where dry friction is of two kinds.

    A usual name on several joints is one out of all sets of so many, where that is less than joint by joint.
    """
    assert price([at("torque_bias")], 7) == 6.0
    assert price([at("torque_bias", 0), at("torque_bias", 1)], 7) == 9.0
    assert price([at("torque_ripple", 0), at("torque_ripple", 0), at("torque_ripple", 1)], 7) == 18.0
    assert price([at("coulomb_friction", 0), at("stribeck_friction", 1)], 7) == 16.0
    assert price([at("coulomb_friction", 0), at("viscous_friction", 0, cost=0.5)], 7) == 12.5
    assert price([], 7) == 0.0
    seven = [at("viscous_friction", joint) for joint in range(7)]
    assert price(seven, 7) == 9.0 and price(seven[:2], 7) == 9.0
    assert price(seven[:3], 7) == pytest.approx(6.0 + np.log(35.0))
    assert price(seven[:4], 30) == 15.0, "one of 27405 sets would be more than three each"
    assert price([at("torque_bias", joint) for joint in range(7)], 7) == 24.0


class Fits:
    """A bench on which hypotheses have the evidence that a test gives them."""

    def __init__(self, candidates: list[Candidate], evidence: dict[frozenset[int], float]) -> None:
        self.candidates, self.evidence = candidates, evidence

    def solve(self, members: frozenset[int]) -> Any:
        return SimpleNamespace(members=members, evidence=self.evidence[members])


@pytest.mark.parametrize(
    ("plain", "finer", "share", "rest"),
    [
        ("coulomb_friction", "stribeck_friction", 0.0015, 300.0),
        ("reflected_inertia", "joint_elasticity", 0.025, 300.0),
        ("reflected_inertia", "backlash", 0.025, 300.0),
        ("reflected_inertia", "backlash", 0.025, -50.0),
    ],
)
def test_a_finer_law_must_bring_its_share_beyond_the_plainer(plain: str, finer: str, share: float, rest: float) -> None:
    """Of all evidence, for a dip near rest; of what the rotor brings, for a gear that yields."""
    bench: Any = Fits([at(plain)], {frozenset({0}): 1000.0, frozenset(): rest})
    whole = 1000.0 if finer == "stribeck_friction" else 1000.0 - max(rest, 0.0)
    less = handicaps(bench, bench.solve(frozenset({0})))
    assert less[finer] == pytest.approx(share * whole)


@pytest.mark.parametrize(
    ("name", "one", "two"),
    [
        ("joint_elasticity", 1.0 - 0.97**5, 1.0 - 0.92**4),
        ("backlash", 1.0 - 0.99**5, 1.0 - 0.92**4),
        ("torque_ripple", 1.0 - 0.994**5, 1.0 - 0.92**4),
        ("viscous_friction", 0.0, 0.0),
    ],
)
def test_a_law_whose_weak_ones_do_not_show_may_be_elsewhere_unseen(name: str, one: float, two: float) -> None:
    assert unseen((name, (1,), ()), 6) == pytest.approx(one)
    assert unseen((name, (1, 2), ()), 6) == pytest.approx(two)


def test_words_of_torques_and_forces() -> None:
    both = effect("torque_bias", ["turn", "slide"], torque=[1.0, 2.0])
    assert effort(both) == "torque"
    assert effort(both.on_arm(["slide", "other"])) == "torque or force"
    assert effort(both.on_arm(["slide", "turn"])) == "force"
    assert values_on_joints(both.on_arm(["slide"]), "torque") == "1 N·m on turn, 2 N on slide"
    assert name_and_place(both) == "torque bias on turn, slide"
    assert name_and_place(effect("external_force", links=["hand"], wrench=[0.0] * 6)) == "external force on hand"
    ripple = effect("torque_ripple", ["turn", "slide"], amplitude=[1.0, 1.0], cycles=[8.0, 100.0], phase=[0.0, 0.0])
    said = sentence(ripple.on_arm(["slide"]))
    assert "8 times per revolution" in said and f"every {2.0 * np.pi / 100.0:.4g} m" in said
    still = effect("torque_ripple", ["slide"], amplitude=[1.0], cycles=[0.0], phase=[0.0])
    assert "the same everywhere" in sentence(still.on_arm(["slide"]))


def test_what_laws_leave_out_of_their_errors() -> None:
    """0.3 ms of a delay, two per cent of a gap: controllers hold a torque, teeth give way."""
    assert record_of("time_delay").left_out["delay"] == (pytest.approx(3e-4), 0.0)
    assert record_of("backlash").left_out["gap"] == (0.0, pytest.approx(0.02))


def test_what_is_built_in_does_not_begin_amid_a_log() -> None:
    """Noise that grows with the torque was told as a rotor of 0.004 kg·m² that came six seconds into a run."""
    beginning = {record.name for record in records() if record.starts}
    assert {"payload", "coulomb_friction", "torque_bias", "joint_spring"} <= beginning
    assert not beginning & {"reflected_inertia", "joint_elasticity", "backlash", "torque_ripple", "time_delay"}
