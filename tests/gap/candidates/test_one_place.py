"""What the workflow knows of an effect stands in its class and its record: one file more, and a new one is named."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tests import gap_bench as bench
from twin_diagram.gap.candidates import records
from twin_diagram.gap.candidates.records import RECORDS, record_of, sentence
from twin_diagram.gap.candidates.user_effects import COME_ALONG, own_candidates
from twin_diagram.gap.correction.merge_effects import merged
from twin_diagram.gap.experiments import trajectories
from twin_diagram.gap.experiments.advice import LOAD, SPEEDS, experiment
from twin_diagram.gap.naming import all_candidates
from twin_diagram.gap.report import words
from twin_diagram.gap.residuals.prepared_logs import prepare
from twin_diagram.gap.residuals.regressors import Terms, given_load, slow_speed
from twin_diagram.gap.workflow import run_gap
from twin_diagram.model.effects import REGISTRY, make
from twin_diagram.model.model import Model
from twin_diagram.scenario import EffectSpec

ONE_FILE = '''
"""Drag of the air: its law, its candidates and its record."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from twin_diagram.gap.candidates.candidate import linear
from twin_diagram.gap.candidates.joint_candidate import single, those_there
from twin_diagram.gap.candidates.merging import summed
from twin_diagram.gap.candidates.records import EffectRecord, Wakes
from twin_diagram.gap.candidates.records import register as register_record
from twin_diagram.gap.candidates.wording import values_on_joints
from twin_diagram.model.effects import Effect, ParameterKind, register
from twin_diagram.model.effects.friction import ViscousFriction


@register
class QuadraticDrag(Effect):
    """Drag that grows with the square of the speed."""

    name: ClassVar[str] = "quadratic_drag"
    kinds: ClassVar[Mapping[str, ParameterKind]] = {"drag": ParameterKind("N·m·s²/rad²", lower=0.0)}

    def torque(self, bodies, q, v, a, tau):
        return self.spread(bodies.joints, self.value("drag")) * v * np.abs(v)


def on_joints(terms):
    size = terms.records.reduce(lambda r: r.v * np.abs(r.v))
    return [
        those_there([single(terms, QuadraticDrag.name, j, [size[:, j]], linear("drag"), [-1.0])])
        for j in range(terms.records.n)
    ]


register_record(
    EffectRecord(
        effect=QuadraticDrag,
        title="Drag of the air",
        explanation="A torque that grows with the square of the speed.",
        sentence=lambda effect: f"drag of {values_on_joints(effect, 'drag')}",
        keys={"drag": "torque over speed squared"},
        on_joints=on_joints,
        rivals=frozenset({ViscousFriction.name}),
        merge=summed,
        joint_by_joint=True,
        leading=("drag",),
        adds=frozenset({"drag"}),
        wakes=frozenset({Wakes.SPEED}),
    )
)
'''
DRAG = 1.5
VALUES = {"rest_angle": 0.1, "stribeck_velocity": 0.1, "cycles": 12.0}
"""Of parameters; 0.2 for all others."""


@pytest.fixture
def one_file_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The catalogue with one effect more, whose law and record are one file; it is as it was afterwards."""
    laws, said = dict(REGISTRY), dict(RECORDS)
    path = tmp_path / "quadratic_drag.py"
    path.write_text(ONE_FILE, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("quadratic_drag_of_one_file", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    try:
        spec.loader.exec_module(module)
        yield module
    finally:
        for registry, before in ((REGISTRY, laws), (RECORDS, said)):
            registry.clear()  # type: ignore[attr-defined]
            registry.update(before)  # type: ignore[attr-defined]


def drag(*values: float, joints: tuple[str, ...] = ("elbow",)) -> EffectSpec:
    return EffectSpec("quadratic_drag", list(joints), [], {"drag": list(values)})


@pytest.mark.long
def test_a_new_effect_is_named_sized_written_and_described(one_file_more: ModuleType, tmp_path: Path) -> None:
    paths = bench.write_runs(tmp_path, [drag(DRAG)])
    run_gap(tmp_path / "arm.urdf", [paths[0]], paths[1], tmp_path / "out")
    answer = json.loads((tmp_path / "out/gap.json").read_text())
    (effect,) = answer["effects"]
    assert (effect["name"], effect["joints"]) == ("quadratic_drag", ["elbow"])
    found = effect["parameters"]["drag"]["elbow"]
    assert abs(found["value"] - DRAG) < 4.0 * found["std"] + 0.01 and found["unit"] == "N·m·s²/rad²"
    again = Model.load(tmp_path / "out/model").effects
    assert [(type(each).__name__, each.joints) for each in again] == [("QuadraticDrag", ("elbow",))]
    np.testing.assert_allclose(again[0].value("drag"), [found["value"]], rtol=1e-9)
    assert "quadratic_drag" in (tmp_path / "out/model/effects.yaml").read_text()
    said = (tmp_path / "out/report.html").read_text()
    for text in ("The model lacks drag of the air on elbow.", "Drag of the air", "torque over speed squared"):
        assert text in said
    assert "square of the speed" in said and re.search(r"Drag of 1\.\d+ N·m·s²/rad² on elbow", said)


def test_a_new_effect_has_words_an_experiment_and_merges(one_file_more: ModuleType, tmp_path: Path) -> None:
    effect = make(drag(2.0, 3.0, joints=("shoulder", "elbow"))).on_arm({"shoulder"})
    assert sentence(effect) == "drag of 2 N·s²/m² on shoulder, 3 N·m·s²/rad² on elbow"
    assert words.explanation("quadratic_drag", True) == "A force that grows with the square of the speed."
    assert experiment("quadratic_drag", "viscous_friction") == SPEEDS
    assert experiment("quadratic_drag", "torque_constant") == LOAD
    (less,) = merged([make(drag(2.0))], [drag(-0.5)])
    assert less.value("drag").tolist() == [1.5]
    assert merged([make(drag(2.0))], [drag(-2.0)]) == []


def test_what_has_a_record_has_no_second_candidates(one_file_more: ModuleType, tmp_path: Path) -> None:
    model = Model.load(bench.arm(tmp_path))
    prepared = prepare(model, [bench.run(model)])
    terms = Terms(prepared, given_load(prepared), slow_speed(prepared))
    made = [candidate for candidate in all_candidates(terms) if candidate.name == "quadratic_drag"]
    assert [candidate.joints for candidate in made] == [(0,), (1,)]
    assert not own_candidates(terms)


# The catalogue's own records.


ALONG = sorted(name for name, cls in REGISTRY.items() if cls.__module__.startswith(COME_ALONG))


def spec_of(name: str) -> EffectSpec:
    cls = REGISTRY[name]
    joints = ["rail", "shoulder"] if cls.per_joint or record_of(name).coupled else []
    links = ["tool"] if not joints and name != "time_delay" and name != "gravity_tilt" else []
    count = len(joints) if cls.per_joint else 1
    left_out = {"curve", "torque_positive", "torque_negative"}
    return EffectSpec(
        name,
        joints,
        links,
        {
            key: [VALUES.get(key, 0.2)] * (count if cls.per_joint else kind.size or 1)
            for key, kind in cls.kinds.items()
            if key not in left_out and key not in record_of(name).untold
        },
    )


ALONE = ("actuator_fault", "external_force", "inertial_parameters", "payload", "torque_ripple")


@pytest.mark.parametrize("name", ALONG)
def test_every_effect_of_the_catalogue_has_a_whole_record(name: str) -> None:
    record = RECORDS[name]
    assert record.effect is REGISTRY[name] and record.name == name
    assert record.title and record.explanation.endswith(".")
    effect = make(spec_of(name))
    turning, prismatic = sentence(effect), sentence(effect.on_arm({"rail", "shoulder"}))
    assert record.sentence is not records.name_and_place
    for said in (turning, prismatic):
        assert len(said) > 10 and all(place in said for place in (*effect.joints, *effect.links))
    if effect.joints and any(kind.unit_on(True) != kind.unit for kind in effect.kinds.values()):
        assert turning != prismatic and "N·m" not in prismatic and "rad" not in prismatic
    for other in ALONG:
        assert experiment(name, other) == experiment(other, name)
        assert experiment(name, other) in trajectories.MAKERS
    values = {key: [value[0]] for key, value in spec_of(name).parameters.items()}
    both = record.merge(values, values) if name not in ("inertial_parameters", "external_force") else None
    # Two pushes, loads, ripples, faults or links stay beside each other: their numbers cannot be summed.
    assert (both is None) == (name in ALONE)
    assert both is None or set(both) == set(values)
    assert record.leading == tuple(key for key in record.leading if key in record.effect.kinds)
    for keys in (record.keys, record.keys_on_prismatic, record.adds, record.logarithmic, record.untold, record.held):
        assert set(keys) <= set(record.effect.kinds)
    for others in (record.rivals, record.rivals_on_link, record.wider_than, record.taken_off, {record.plainer} - {""}):
        assert set(others) <= set(ALONG) - {name}


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("viscous_friction", [5.0]),
        ("torque_constant", [6.0]),
        ("torque_saturation", [2.0]),
        ("torque_ripple", None),
        ("actuator_fault", None),
    ],
)
def test_two_of_a_law_are_one_by_its_rule(name: str, rule: list[float] | None) -> None:
    key = next(iter(REGISTRY[name].kinds))
    both = RECORDS[name].merge({key: [2.0]}, {key: [3.0]})
    assert both == (None if rule is None else {key: rule})


def test_an_effect_without_a_record_says_what_its_class_says() -> None:
    record = record_of("no_such_effect")
    assert (record.title, record.explanation, record.wakes) == ("No such effect", "", frozenset())
    assert not record.positive and not record.joint_by_joint and record.merge({"a": [1.0]}, {"a": [2.0]}) is None
