"""What a held-out run says of a correction: below the frequencies of the residual, and above."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests import gap_bench as bench
from twin_diagram.gap import workflow
from twin_diagram.gap.correction.held_out_evidence import confirmed
from twin_diagram.gap.findings import Estimate, Finding
from twin_diagram.gap.whole_robot import few_or_whole
from twin_diagram.gap.workflow import run_gap
from twin_diagram.logs import write_log
from twin_diagram.model.effects import make
from twin_diagram.model.model import Model
from twin_diagram.scenario import EffectSpec

CYCLES = 150.0
"""Of a ripple that is above 10 Hz most of the time at the speeds of `bench.run`."""


def ripple(phase: float, amplitude: float = 0.15) -> EffectSpec:
    values = {"amplitude": [amplitude], "cycles": [CYCLES], "phase": [phase]}
    return EffectSpec("torque_ripple", ["elbow"], [], values)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    return Model.load(bench.arm(tmp_path_factory.mktemp("arm")))


@pytest.mark.parametrize("seed", range(4))
def test_what_is_too_fast_for_the_residual_is_confirmed_above_it(model: Model, seed: int) -> None:
    held = bench.run(model, [ripple(0.4)], seed=seed)

    def with_phase(phase: float) -> Model:
        return model.with_effects([make(ripple(phase))])

    assert confirmed(model, with_phase(0.4), held)
    assert not confirmed(model, with_phase(0.4 + np.pi), held)
    assert not confirmed(model, with_phase(0.4), bench.run(model, seed=seed))  # a healthy one
    assert not confirmed(model, with_phase(0.4), held.between(0.0, 2.0))  # too short to tell


@pytest.mark.parametrize("there", [True, pytest.param(False, marks=pytest.mark.long)])
def test_a_fast_ripple_is_kept_where_the_held_out_run_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: bool
) -> None:
    model = Model.load(bench.arm(tmp_path))
    fit, held = bench.run(model, [ripple(0.4)], seed=1), bench.run(model, [ripple(0.4)] if there else [], seed=2)
    paths = [tmp_path / "fit.csv", tmp_path / "held.csv"]
    for run, path in zip((fit, held), paths, strict=True):
        write_log(run, path)
    values = {"amplitude": (0.15, "N·m"), "cycles": (CYCLES, "1"), "phase": (0.4, "rad")}
    told = {key: {"elbow": Estimate(value, 0.01, unit)} for key, (value, unit) in values.items()}
    found = Finding("torque_ripple", ("elbow",), (), told, 0.9)  # type: ignore[arg-type]
    monkeypatch.setattr(few_or_whole, "name", lambda *_: bench.verdict("named", [found]))
    monkeypatch.setattr(workflow.Shown, "shrinks", lambda self: False)  # below 10 Hz it is chance
    assert run_gap(tmp_path / "arm.urdf", paths[:1], paths[1]).verdict.verdict == ("named" if there else "unknown")
