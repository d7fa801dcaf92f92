"""What a model has too much of is taken away, and the corrected model explains the next run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests import gap_bench as bench
from twin_diagram.errors import ModelError
from twin_diagram.gap.correction.add_effects import add
from twin_diagram.gap.correction.merge_effects import merged
from twin_diagram.gap.findings import Estimate, Finding
from twin_diagram.gap.workflow import run_gap
from twin_diagram.logs import write_log
from twin_diagram.model.effects import make
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import torque_residual_rms
from twin_diagram.scenario import EffectSpec

HAD, TRUE = 3.0, 1.8
"""Dry friction of the elbow, in the given model and in truth [N·m]."""


def stated(folder: Path) -> Path:
    """A description that has it."""
    path = bench.arm(folder)
    limit = '<limit lower="-2.5" upper="2.5" velocity="3" effort="40"/>'
    assert limit in bench.URDF
    path.write_text(bench.URDF.replace(limit, f'{limit}<dynamics damping="0" friction="{HAD}"/>'), encoding="utf-8")
    return path


def corrected(folder: Path) -> Path:
    """A corrected model that has it."""
    model = Model.load(bench.arm(folder))
    model.with_effects([*model.effects, *Model.load(replace(model.spec, effects=[bench.dry(HAD)])).effects]).save(
        folder / "given"
    )
    return folder / "given"


@pytest.mark.parametrize("having", [stated, corrected])
@pytest.mark.slow
def test_less_than_the_model_has_is_named_added_and_then_nothing_is_missing(having: object, tmp_path: Path) -> None:
    assert callable(having)
    given = having(tmp_path)
    (tmp_path / "bare").mkdir()
    bare = Model.load(bench.arm(tmp_path / "bare"))
    paths = [tmp_path / f"run_{k}.csv" for k in range(4)]
    for k, path in enumerate(paths):
        write_log(bench.run(bare, [bench.dry(TRUE)], seed=20 + k), path)
    first = run_gap(given, [paths[0]], paths[1], tmp_path / "out")
    assert [(f.name, f.joints) for f in first.verdict.findings] == [("coulomb_friction", ("elbow",))]
    told = first.verdict.findings[0].parameters["torque"]
    assert isinstance(told, dict)
    assert told["elbow"].value == pytest.approx(TRUE - HAD, abs=0.05)  # relative to the given model
    second = run_gap(tmp_path / "out" / "model", [paths[2]], paths[3])
    assert second.verdict.verdict == "none"
    whole = sum(float(effect.value("torque")[0]) for effect in second.given.effects)
    assert whole == pytest.approx(TRUE, abs=0.05)


def load(mass: float, **others: object) -> EffectSpec:
    return replace(EffectSpec("payload", [], ["lower"], {"mass": [mass], "com": [0.02, 0.0, 0.2]}), **others)  # type: ignore[arg-type]


LOADS = {
    "one of two": ([load(1.0), load(0.8)], 0.8),
    "both": ([load(1.0), load(0.8)], 1.8),
    "more than each": ([load(1.0), load(0.8)], 1.3),
    "of no link in particular": ([load(1.0, links=[])], 1.0),
    "picked up in an older run": ([load(1.0, onset=3.0, log="older")], 1.0),
}


@pytest.mark.parametrize("case", LOADS)
def test_a_payload_is_put_down(case: str, tmp_path: Path) -> None:
    """However the model came by it; a link may have several, as one was picked up after another."""
    had, lost = LOADS[case]
    bare = Model.load(bench.arm(tmp_path))
    given = bare.with_effects([make(spec) for spec in had])
    left = sum(spec.parameters["mass"][0] for spec in had) - lost
    runs = [bench.run(bare, [load(left)] if left > 1e-6 else [], seed=seed) for seed in (1, 2)]
    told = {"mass": Estimate(-lost * 0.97, 0.01, "kg"), "com": Estimate([0.02, 0.0, 0.2], [0.001] * 3, "m")}
    added = add(given, runs[:1], [Finding("payload", (), ("lower",), told, 0.99)])  # type: ignore[arg-type]
    assert np.all(torque_residual_rms(added.model, runs[1]) < 0.05)
    mass = sum(float(effect.value("mass")[0]) for effect in added.model.effects if effect.name == "payload")
    assert mass == pytest.approx(left, abs=0.02)


@pytest.mark.parametrize("left", [0.0, 0.002, 0.01])
def test_what_is_left_of_a_load_is_near_where_it_was(left: float) -> None:
    """A centre that is told a little wrong must not swing a few grams metres away."""
    lost = EffectSpec("payload", [], ["lower"], {"mass": [left - 2.0], "com": [0.02, 0.0, 0.205]})
    for effect in merged([make(load(2.0))], [lost]):
        assert np.linalg.norm(effect.value("com")) < 0.3


def test_a_load_on_no_link_in_particular_is_put_down_within_a_run() -> None:
    lost = EffectSpec("payload", [], ["lower"], {"mass": [-1.0], "com": [0.02, 0.0, 0.2]}, onset=2.0, log="a")
    (before,) = merged([make(load(1.0, links=[]))], [lost])
    assert (before.end, before.onset, before.links) == (2.0, None, ("lower",))


def test_static_friction_may_be_all_that_is_left() -> None:
    curve = {"coulomb": [2.0], "static": [3.0], "stribeck_velocity": [0.06]}
    had = [make(EffectSpec("stribeck_friction", ["elbow"], [], curve))]
    for lost in (-2.0, -2.05):
        (effect,) = merged(had, [replace(bench.dry(), parameters={"torque": [lost]})])
        assert effect.value("coulomb")[0] == 0.0 and effect.value("static")[0] == pytest.approx(3.0 + lost)


def test_friction_of_a_stribeck_curve_becomes_less(tmp_path: Path) -> None:
    """It is the same dry friction, whichever way the model says it."""
    bare = Model.load(bench.arm(tmp_path))

    def curve(level: float) -> EffectSpec:
        values = {"coulomb": [level], "static": [level + 1.5], "stribeck_velocity": [0.06]}
        return EffectSpec("stribeck_friction", ["elbow"], [], values)

    given = bare.with_effects([make(curve(3.0))])
    runs = [bench.run(bare, [curve(1.5)], seed=seed) for seed in (1, 2)]
    added = add(given, runs[:1], [bench.friction_finding(-1.4)])
    assert np.all(torque_residual_rms(added.model, runs[1]) < 0.06)
    (effect,) = added.model.effects
    assert effect.name == "stribeck_friction"
    assert (effect.value("coulomb")[0], effect.value("static")[0]) == pytest.approx((1.5, 3.0), abs=0.1)
    with pytest.raises(ModelError):  # there is no more than that
        merged(given.effects, [replace(bench.dry(), parameters={"torque": [-3.5]})])
