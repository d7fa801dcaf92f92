"""A user's law that is linear in its parameters is looked for; others are left alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import pytest

from tests.gap.made import ARM, ELBOW, law, swinging, told, torque
from twin_diagram.gap.candidates.records import RECORDS, EffectRecord
from twin_diagram.gap.candidates.user_effects import own_candidates
from twin_diagram.model.effects import REGISTRY, Effect, ParameterKind


class Drag(Effect):
    """A square and a cube of the speed, the latter felt by the next joint, too."""

    name: ClassVar[str] = "square_drag"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {
        "square": ParameterKind("", lower=0.5, upper=9.0),
        "cube": ParameterKind("", lower=-3.0, upper=0.25),
    }

    def torque(self, bodies: Any, q: Any, v: Any, a: Any, tau: Any) -> Any:
        own = self.spread(bodies.joints, self.value("square")) * v * np.abs(v)
        beside = self.spread(bodies.joints, self.value("cube")) * v**3
        return own + beside + 0.5 * np.roll(beside, 1, axis=1)


class Bent(Drag):
    name: ClassVar[str] = "bent_drag"

    def torque(self, bodies: Any, q: Any, v: Any, a: Any, tau: Any) -> Any:
        return self.spread(bodies.joints, self.value("square") ** 2) * v


class Nothing(Drag):
    name: ClassVar[str] = "no_drag"

    def torque(self, bodies: Any, q: Any, v: Any, a: Any, tau: Any) -> Any:
        return self.spread(bodies.joints, self.value("square")) * v


class Listed(Drag):
    name: ClassVar[str] = "listed"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {"square": ParameterKind("", size=2), "cube": ParameterKind("")}


class WholeArm(Drag):
    name: ClassVar[str] = "whole_arm"
    per_joint: ClassVar[bool] = False


class Plain(Drag):
    name: ClassVar[str] = "plain"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {}


def made(monkeypatch: pytest.MonkeyPatch, *classes: type[Effect]) -> list[Any]:
    for cls in classes:
        monkeypatch.setitem(REGISTRY, cls.name, cls)
    return own_candidates(swinging())


def test_a_linear_law_is_tried_on_every_joint(monkeypatch: pytest.MonkeyPatch) -> None:
    terms = swinging()
    candidates = made(monkeypatch, Drag)
    assert [c.joints[0] for c in candidates] == list(range(len(ARM.joints)))
    candidate = candidates[ELBOW]
    assert candidate.rows == (ELBOW, ELBOW + 1)
    c = np.array([2.0, -1.5])
    wanted = law(terms, candidate, told(candidate, c))
    np.testing.assert_allclose(torque(terms, candidate, c), wanted, atol=1e-9)
    for inside, outside in (([0.51, 0.0], [0.49, 0.0]), ([8.9, 0.0], [9.1, 0.0]), ([1.0, 0.24], [1.0, 0.26])):
        assert candidate.allows(np.array(inside)) and not candidate.allows(np.array(outside))
    size = np.max(np.sqrt(np.mean(candidate.columns**2, axis=0)), axis=0)
    np.testing.assert_allclose(candidate.spread * size, terms.torque_size[ELBOW])


@pytest.mark.parametrize("cls", [Bent, Nothing, Listed, WholeArm, Plain])
def test_what_is_not_linear_or_has_no_number_per_joint_is_not_searched(
    cls: type[Effect], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert made(monkeypatch, cls) == []


def test_an_effect_with_a_record_makes_its_own_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(RECORDS, Drag.name, EffectRecord(Drag, "", ""))
    assert made(monkeypatch, Drag) == []
    monkeypatch.setitem(RECORDS, Drag.name, EffectRecord(Bent, "", ""))
    assert len(made(monkeypatch, Drag)) == 6, "the record is of an older class of the name"
