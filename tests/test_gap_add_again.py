"""What a model has too much of is taken away, and the corrected model explains the next run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gap_bench as bench
import pytest

from twin_diagram.gap.command import run_gap
from twin_diagram.logs import write_log
from twin_diagram.model import Model

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


@pytest.mark.parametrize("make", [stated, corrected])
def test_less_than_the_model_has_is_named_added_and_then_nothing_is_missing(make: object, tmp_path: Path) -> None:
    assert callable(make)
    given = make(tmp_path)
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
