"""Effects that start or end in one of several runs, and what that says of the others."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests import gap_bench as bench
from twin_diagram.errors import ModelError
from twin_diagram.gap.correction.add_effects import add
from twin_diagram.gap.findings import Estimate, Finding
from twin_diagram.gap.naming import name
from twin_diagram.gap.report.gap_json import one_per_name
from twin_diagram.gap.whole_robot import few_or_whole
from twin_diagram.gap.workflow import run_gap
from twin_diagram.logs import Log, fingerprint, write_log
from twin_diagram.logs.parting import parted
from twin_diagram.model.effects import make, spec_of
from twin_diagram.model.effects.timing import in_run
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import predict, torque_residual_rms
from twin_diagram.scenario import EffectSpec

FLOOR = 0.05
"""A little more than the noise of `bench.run` below 10 Hz [N·m]."""


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Model:
    return Model.load(bench.arm(tmp_path_factory.mktemp("arm")))


def switched(model: Model, seed: int, moment: float, effects: Sequence[EffectSpec] | None = None) -> Log:
    """A run in which the elbow's dry friction starts at some time [s]."""
    healthy = bench.run(model, seed=seed)
    dry = bench.run(model, effects or [bench.dry()], seed=seed)
    assert healthy.torque is not None and dry.torque is not None
    return replace(healthy, torque=np.where((healthy.time >= moment)[:, None], dry.torque, healthy.torque))


@pytest.mark.long
def test_what_starts_after_a_silence_has_its_time_looked_for_there(model: Model) -> None:
    """Stretches of one run share its mark; the time was looked for in the first of them, where it is not."""
    run = switched(model, 1, 5.5)
    heard = (run.time < 3.0) | (run.time > 3.3)
    assert run.torque is not None
    gap = replace(run, time=run.time[heard], position=run.position[heard], torque=run.torque[heard])
    runs = parted(gap, 2.0)
    assert len(runs) == 2
    added = add(model, runs, [bench.friction_finding(2.7, onset=bench.begin(1, 5.4))])
    (finding,) = added.findings
    assert finding.onset is not None
    assert finding.onset.time == pytest.approx(5.5, abs=0.02) and finding.onset.std < 0.05


@pytest.mark.long
def test_what_starts_in_a_later_run_was_not_in_those_before(model: Model, tmp_path: Path) -> None:
    runs = [bench.run(model, seed=0), switched(model, 1, 4.0)]
    after = bench.run(model, [bench.dry()], seed=2)
    added = add(model, runs, [bench.friction_finding(2.7, onset=bench.begin(1, 4.1))])
    (finding,) = added.findings
    told = finding.parameters["torque"]
    assert isinstance(told, dict) and isinstance(told["elbow"].std, float)
    assert told["elbow"].value == pytest.approx(3.0, abs=0.02) and told["elbow"].std < 0.02
    assert finding.onset is not None and finding.onset.time == pytest.approx(4.0, abs=0.02)
    added.model.save(tmp_path / "model")
    for corrected in (added.model, Model.load(tmp_path / "model")):
        for run in (*runs, after):
            assert np.all(torque_residual_rms(corrected, run) < FLOOR)


@pytest.mark.long
def test_what_ends_in_a_later_run_was_in_those_before(model: Model) -> None:
    worn = bench.run(model, [bench.dry()], seed=0)
    whole = bench.run(model, [bench.dry()], seed=1)
    mended = bench.run(model, seed=1)
    assert whole.torque is not None and mended.torque is not None
    ending = replace(whole, torque=np.where((whole.time < 4.0)[:, None], whole.torque, mended.torque))
    added = add(model, [worn, ending], [bench.friction_finding(2.7, end=bench.begin(1, 3.9))])
    for run in (worn, ending, bench.run(model, seed=2)):
        assert np.all(torque_residual_rms(added.model, run) < FLOOR)


def test_times_in_other_runs_are_said_in_the_effect() -> None:
    spec = replace(bench.dry(), onset=2.0, log="a", elsewhere={"b": math.inf, "c": 3.0})
    effect = make(spec)
    assert spec_of(effect) == spec
    here, before, within, later = (in_run(effect, mark) for mark in "abcd")
    assert here is effect and before is None
    assert within is not None and (within.when.onset, within.when.log) == (3.0, "c")
    assert later is not None and not later.when.timed
    ending = make(replace(spec, onset=None, end=2.0))
    before, within, later = (in_run(ending, mark) for mark in "bcd")
    assert before is not None and not before.when.timed
    assert within is not None and (within.when.onset, within.when.end) == (None, 3.0)
    assert later is None
    assert in_run(make(replace(spec, end=4.0)), "d") is None  # a push is over
    with pytest.raises(ModelError, match="not a number"):
        make(replace(spec, elsewhere={"b": math.nan}))


@pytest.mark.parametrize("moment", [0.0, 3.0])
@pytest.mark.slow
def test_a_held_out_run_may_have_an_onset_of_its_own(
    model: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: float
) -> None:
    fit, held = switched(model, 1, 4.0), switched(model, 2, moment)
    paths = [tmp_path / "fit.csv", tmp_path / "held.csv"]
    for run, path in zip((fit, held), paths, strict=True):
        write_log(run, path)
    found = [bench.friction_finding(onset=bench.begin(0, 4.0))]
    monkeypatch.setattr(few_or_whole, "name", lambda *_: bench.verdict("named", found))
    gap = run_gap(bench.arm(tmp_path), paths[:1], paths[1], tmp_path / "out")
    answer = json.loads((tmp_path / "out" / "gap.json").read_text())
    assert answer["verdict"] == "named" and answer["effects"][0]["onset"] == pytest.approx(4.0, abs=0.02)
    assert answer["gap"]["torque_rms"]["holdout"]["after"]["elbow"] < 2.0 * FLOOR
    assert any("in the held-out run, too" in note for note in gap.notes) == (moment > 0.0)
    assert elsewhere(gap.corrected, held) == ([] if moment == 0.0 else [pytest.approx(moment, abs=0.1)])
    predict(tmp_path / "out" / "model", paths[1], tmp_path / "predicted.csv")  # others see the same
    names = (tmp_path / "predicted.csv").read_text().partition("\n")[0].split(",")
    table = np.loadtxt(tmp_path / "predicted.csv", delimiter=",", skiprows=1)
    assert held.torque is not None
    left = held.torque[:, 1] - table[:, names.index("torque_predicted.elbow")]
    assert np.quantile(np.abs(left)[100:-100], 0.95) < 0.5  # white noise of 0.1 beside a friction of 3


def elsewhere(corrected: Model, held: Log) -> list[float]:
    """Times that effects have in the held-out run."""
    return [moments[fingerprint(held)] for e in corrected.effects if fingerprint(held) in (moments := e.when.elsewhere)]


@pytest.mark.long
def test_a_healthy_held_out_run_still_denies_a_name(
    model: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [tmp_path / "fit.csv", tmp_path / "held.csv"]
    for run, path in zip((switched(model, 1, 4.0), bench.run(model, seed=2)), paths, strict=True):
        write_log(run, path)
    found = [bench.friction_finding(onset=bench.begin(0, 4.0))]
    monkeypatch.setattr(few_or_whole, "name", lambda *_: bench.verdict("named", found))
    assert run_gap(bench.arm(tmp_path), paths[:1], paths[1]).verdict.verdict == "unknown"


def test_what_joints_share_is_told_of_each(model: Model) -> None:
    """A scorer looks a joint's value up by its name."""
    spec = EffectSpec("coupled_friction", list(bench.JOINTS), [], {"torque": [2.0], "damping": [1.0]})
    values = {key: {j: Estimate(1.5, 0.1, "") for j in bench.JOINTS} for key in ("torque", "damping")}
    found = Finding("coupled_friction", bench.JOINTS, (), values, 0.9)  # type: ignore[arg-type]
    (told,) = add(model, [bench.run(model, [spec], seed=1)], [found]).findings
    for key, true, unit in (("torque", 2.0, "N·m"), ("damping", 1.0, "N·m·s/rad")):
        estimates = told.parameters[key]
        assert isinstance(estimates, dict) and set(estimates) == set(bench.JOINTS)
        for estimate in estimates.values():
            assert estimate.value == pytest.approx(true, rel=0.05) and estimate.unit == unit


@pytest.mark.slow
def test_one_name_may_start_at_other_times_on_other_joints(model: Model) -> None:
    """The model has each joint's own; gap.json has one entry per name."""
    both = [EffectSpec("coulomb_friction", list(bench.JOINTS), [], {"torque": [4.0, 3.0]})]
    early = bench.run(
        model, [EffectSpec("coulomb_friction", ["shoulder"], [], {"torque": [4.0]})], seed=1, duration=12.0
    )
    late = bench.run(model, both, seed=1, duration=12.0)
    run = replace(early, torque=np.where((early.time >= 6.0)[:, None], late.motor_torque, early.motor_torque))
    found = name(model, [run]).findings
    assert {(f.name, f.joints, f.onset is None) for f in found} == {
        ("coulomb_friction", ("shoulder",), True),
        ("coulomb_friction", ("elbow",), False),
    }
    added = add(model, [run], found)
    assert np.all(torque_residual_rms(added.model, run) < FLOOR)
    (entry,) = one_per_name(added.findings, model.joints)
    assert entry.joints == model.joints
    torque = entry.parameters["torque"]
    assert isinstance(torque, dict)
    assert [torque[joint].value for joint in model.joints] == pytest.approx([4.0, 3.0], abs=0.05)


@pytest.mark.parametrize("every", [2, 3])
@pytest.mark.slow
def test_runs_may_differ_in_their_rates(model: Model, every: int) -> None:
    """Also by so little that rollouts of the same length look at one sample more."""
    a, b = (bench.run(model, [bench.dry()], seed=seed) for seed in (0, 1))
    slower = Log(b.time[::every], b.joints, b.position[::every], torque=b.motor_torque[::every])
    alike = replace(b, time=b.time * 0.985)
    for other in (slower, alike):
        (found,) = add(model, [a, other], [bench.friction_finding(2.7)]).findings
        torque = found.parameters["torque"]
        assert isinstance(torque, dict) and torque["elbow"].value == pytest.approx(3.0, abs=0.05)


@pytest.mark.slow
def test_a_push_at_the_end_of_a_run_does_not_go_on_in_the_next(model: Model) -> None:
    push = EffectSpec("external_force", [], ["lower"], {"wrench": [8.0, 0.0, -6.0, 0.0, 0.0, 0.0]})
    free, pushed, after = bench.run(model, seed=0), bench.run(model, [push], seed=0), bench.run(model, seed=1)
    run = replace(free, torque=np.where((free.time >= 6.6)[:, None], pushed.motor_torque, free.motor_torque))
    found = name(model, [run, after]).findings
    assert [f.name for f in found] == ["external_force"]
    (onset, end) = found[0].onset, found[0].end
    assert onset is not None and end is not None and onset.log == end.log == 0
    corrected = add(model, [run, after], found).model
    assert np.all(torque_residual_rms(corrected, after) < FLOOR)


def test_of_two_findings_of_a_name_the_stronger_one_is_told() -> None:
    strong = bench.friction_finding(5.0, onset=bench.begin(0, 2.0), links=("lower",))
    (entry,) = one_per_name(
        [strong, bench.friction_finding(1.0, onset=bench.begin(0, 6.0), links=("lower",))], ["elbow"]
    )
    assert entry == strong
