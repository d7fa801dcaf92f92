"""`twin-diagram gap`: its contract, from the command line and from Python, and a user's own effect."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from tests import gap_bench as bench
from twin_diagram import cli
from twin_diagram.errors import TwinError
from twin_diagram.gap import naming, workflow
from twin_diagram.gap.correction import add_effects
from twin_diagram.gap.naming import name
from twin_diagram.gap.report import page
from twin_diagram.gap.residuals.prepared_logs import Records, prepare
from twin_diagram.gap.whole_robot import contacts, few_or_whole, mended_logs
from twin_diagram.gap.workflow import Gap, run_gap
from twin_diagram.logs import Log, read_log, write_log
from twin_diagram.model.effects import REGISTRY, Effect, ParameterKind, register
from twin_diagram.model.model import Model
from twin_diagram.runtime import atomic_file, written_files
from twin_diagram.scenario import EffectSpec, models_dir

FRICTION = 3.0


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Path]]:
    """A description, and three runs in which the elbow has dry friction."""
    folder = tmp_path_factory.mktemp("runs")
    paths = bench.write_runs(folder, [bench.dry(FRICTION)], count=3)
    return folder / "arm.urdf", paths


@pytest.fixture(scope="module")
def found(runs: tuple[Path, list[Path]], tmp_path_factory: pytest.TempPathFactory) -> tuple[Gap, Path]:
    """One whole run of the workflow."""
    out = tmp_path_factory.mktemp("found") / "out"
    model, (fit, held, _) = runs
    return run_gap(model, [fit], held, out), out


def arguments(model: Path, fit: list[Path], held: Path, out: Path) -> list[str]:
    several = [part for path in fit for part in ("--fit", str(path))]
    return ["gap", "--model", str(model), *several, "--holdout", str(held), "--out", str(out)]


@pytest.fixture
def stub(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search, which has tests of its own, answers at once."""
    monkeypatch.setattr(few_or_whole, "name", lambda *_: bench.verdict("named", [bench.friction_finding()]))


# What it finds, and writes.


@pytest.mark.long
def test_fitted_logs_are_prepared_once(
    stub: None, runs: tuple[Path, list[Path]], monkeypatch: pytest.MonkeyPatch
) -> None:
    model, (fit, held, other) = runs
    prepared: list[tuple[str, ...]] = []

    def counted(model: Model, logs: Sequence[Log]) -> Records:
        prepared.append(tuple(log.source for log in logs))
        return prepare(model, logs)

    for module in (contacts, mended_logs, naming, add_effects):
        monkeypatch.setattr(module, "prepare", counted)
    gap = run_gap(model, [fit, other], held)
    assert gap.corrected is not gap.given
    assert [len(logs) for logs in prepared] == [2, 1], "and what is held out once, for contacts in it"


def test_finds_what_is_missing(found: tuple[Gap, Path]) -> None:
    gap, out = found
    answer = json.loads((out / "gap.json").read_text())
    assert answer == gap.answer
    assert answer["verdict"] == "named" and answer["remainder"] is False
    (effect,) = answer["effects"]
    assert (effect["name"], effect["joints"]) == ("coulomb_friction", ["elbow"])
    estimate = effect["parameters"]["torque"]["elbow"]
    assert abs(estimate["value"] - FRICTION) < 4.0 * estimate["std"] + 0.01
    torque, position = answer["gap"]["torque_rms"]["holdout"], answer["gap"]["rollout_position_rms"]["holdout"]
    assert torque["after"]["elbow"] < 0.05 * torque["before"]["elbow"]
    assert position["after"]["elbow"] < 0.2 * position["before"]["elbow"]
    assert sorted(path.name for path in out.iterdir()) in (
        ["gap.json", "gap_files.txt", "model", "report.html"],
        ["experiments", "gap.json", "gap_files.txt", "model", "report.html"],
    )
    assert "The model lacks dry friction on elbow." in (out / "report.html").read_text()


@pytest.mark.long
def test_says_none_of_its_own_corrected_model(
    found: tuple[Gap, Path], runs: tuple[Path, list[Path]], tmp_path: Path
) -> None:
    _, (_, held, later) = runs
    gap = run_gap(found[1] / "model", [later], held, tmp_path / "again")
    assert gap.verdict.verdict == "none"
    assert gap.answer["effects"] == []
    assert gap.corrected is gap.given
    assert "arm.urdf, corrected before" in (tmp_path / "again" / "report.html").read_text()
    again = Model.load(tmp_path / "again" / "model")  # nothing is lost on the way
    assert [effect.name for effect in again.effects] == [effect.name for effect in gap.given.effects]


def test_the_corrected_model_loads_and_says_the_same(found: tuple[Gap, Path]) -> None:
    gap, out = found
    loaded = Model.load(out / "model")
    rng = np.random.default_rng(0)
    q, v, a = rng.normal(size=(3, 20, 2))
    np.testing.assert_allclose(loaded.inverse_dynamics(q, v, a), gap.corrected.inverse_dynamics(q, v, a), rtol=1e-9)
    # An unchanged description, effects beside it.
    assert (out / "model" / "arm.urdf").read_text() == bench.URDF


@pytest.mark.long
@pytest.mark.parametrize("suffix", [".urdf", ".sdf", ".xml"])
def test_any_description(
    stub: None, runs: tuple[Path, list[Path]], tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    _, (fit, held, more) = runs
    out = tmp_path / "out"
    assert cli.main(arguments(bench.arm(tmp_path, suffix), [fit, more], held, out)) == 0
    printed = capsys.readouterr()
    assert printed.out.splitlines()[0] == "The model lacks dry friction on elbow."
    assert "residual torque" in printed.err  # progress
    assert Model.load(out / "model").joints == bench.JOINTS
    for path in (out / "experiments").iterdir():
        lines = path.read_text().splitlines()
        assert lines[0] == "time,position_commanded.shoulder,position_commanded.elbow"
        assert np.all(np.isfinite(np.loadtxt(lines[1:], delimiter=",")))


@pytest.mark.long
def test_joints_may_come_in_any_order(stub: None, runs: tuple[Path, list[Path]], tmp_path: Path) -> None:
    model, (fit, held, _) = runs
    turned = tmp_path / "turned.csv"
    write_log(read_log(fit).select(bench.JOINTS[::-1]), turned)
    straight, other = (run_gap(model, [path], held).answer["gap"]["torque_rms"]["fit"] for path in (fit, turned))
    assert straight["before"] == pytest.approx(other["before"])


@pytest.mark.long
def test_exit_is_0_whatever_the_verdict(
    monkeypatch: pytest.MonkeyPatch, runs: tuple[Path, list[Path]], tmp_path: Path
) -> None:
    model, (fit, held, _) = runs
    monkeypatch.setattr(few_or_whole, "whole_robot", lambda *_, **__: None)
    for kind in ("none", "unknown"):
        monkeypatch.setattr(few_or_whole, "name", lambda *_, kind=kind: bench.verdict(kind))
        assert cli.main(arguments(model, [fit], held, tmp_path / kind)) == 0
        answer = json.loads((tmp_path / kind / "gap.json").read_text())
        assert answer["verdict"] == kind and answer["effects"] == []
        gap = answer["gap"]["torque_rms"]["holdout"]
        assert gap["before"] == gap["after"]
        assert (tmp_path / kind / "model" / "arm.urdf").is_file()


def test_a_name_that_the_held_out_run_denies_is_dropped(
    monkeypatch: pytest.MonkeyPatch, runs: tuple[Path, list[Path]], tmp_path: Path
) -> None:
    model, (fit, _, _) = runs
    healthy = tmp_path / "healthy.csv"
    write_log(bench.run(Model.load(model), seed=9), healthy)
    monkeypatch.setattr(few_or_whole, "name", lambda *_: bench.verdict("named", [bench.friction_finding()]))
    gap = run_gap(model, [fit], healthy)
    assert gap.verdict.verdict == "unknown" and gap.corrected is gap.given
    assert any("held-out" in note for note in gap.notes)


def test_a_name_that_cannot_be_added_is_no_error(
    monkeypatch: pytest.MonkeyPatch, runs: tuple[Path, list[Path]]
) -> None:
    model, (fit, held, _) = runs
    less = bench.friction_finding(torque=-3.0)  # there is none to take away
    monkeypatch.setattr(few_or_whole, "name", lambda *_: bench.verdict("named", [less]))
    gap = run_gap(model, [fit], held)  # the robot as a whole has what is there
    assert [effect["name"] for effect in gap.answer["effects"]] == ["coulomb_friction"]
    assert gap.answer["effects"][0]["parameters"]["torque"]["elbow"]["value"] == pytest.approx(3.0, rel=0.05)
    monkeypatch.setattr(few_or_whole, "whole_robot", lambda *_, **__: None)
    gap = run_gap(model, [fit], held)
    assert gap.verdict.verdict == "unknown" and gap.answer["effects"] == []


# The folder.


@pytest.mark.long
def test_what_else_is_in_the_folder_stays(stub: None, runs: tuple[Path, list[Path]], tmp_path: Path) -> None:
    model, (fit, held, _) = runs
    out = tmp_path / "out"
    (out / "experiments").mkdir(parents=True)
    (out / "notes.txt").write_text("mine")
    (out / "experiments" / "old.csv").write_text("old")
    (out / "gap.json").write_text("old")
    run_gap(model, [fit], held, out)
    assert (out / "notes.txt").read_text() == "mine"
    assert not (out / "experiments" / "old.csv").exists()
    assert json.loads((out / "gap.json").read_text())["verdict"] == "named"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]  # nothing temporary is left


@pytest.mark.long
def test_a_second_run_removes_what_the_first_one_wrote(
    stub: None, runs: tuple[Path, list[Path]], tmp_path: Path
) -> None:
    model, (fit, held, _) = runs
    out = tmp_path / "out"
    mine = (
        "notes.txt",
        "model/mine.urdf",
        "experiments/mine.csv",
        "experiments/1/x",
        "report.html.bak",
        "summary.json",
    )
    for file in mine:
        (out / file).parent.mkdir(parents=True, exist_ok=True)
        (out / file).write_text("mine")
    run_gap(model, [fit], held, out)
    listed = written_files.listed(out, workflow.FILES)
    assert {*listed, workflow.FILES, *mine} == set(written_files.files_of(out))
    assert {"gap.json", "report.html", "model/arm.urdf", "model/effects.yaml"} <= set(listed)
    for file in ("experiments/9_old.csv", "model/old.urdf"):  # which another run would not write
        (out / file).write_text("of the first run")
    written_files.note(out, workflow.FILES, ["experiments/9_old.csv", "model/old.urdf", "../precious", "mine.lnk/x"])
    (tmp_path / "precious").write_text("")
    run_gap(out / "model", [fit], held, out)
    assert {*written_files.listed(out, workflow.FILES), workflow.FILES, *mine} == set(written_files.files_of(out))
    assert not (out / "model" / "old.urdf").exists() and (tmp_path / "precious").exists()
    assert all((out / file).read_text() == "mine" for file in mine)
    Model.load(out / "model")


def test_ctrl_c_leaves_what_was_there(
    stub: None, runs: tuple[Path, list[Path]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> str:
        raise KeyboardInterrupt

    monkeypatch.setattr(page, "page", interrupt)
    model, (fit, held, _) = runs
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "gap.json").write_text("old")
    assert cli.main(arguments(model, [fit], held, tmp_path / "out")) == 130
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["gap.json"]


@pytest.mark.long
def test_a_folder_that_is_there_may_be_a_disk_of_its_own(
    stub: None, runs: tuple[Path, list[Path]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is moved into place must come from the same one."""
    model, (fit, held, _) = runs
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk")
    staged: list[Path] = []
    make = atomic_file.tempfile.mkdtemp
    monkeypatch.setattr(
        atomic_file.tempfile, "mkdtemp", lambda **options: staged.append(options["dir"]) or make(**options)
    )
    run_gap(model, [fit], held, tmp_path / "out")
    assert tmp_path not in staged and tmp_path / "out" in staged
    assert {path.name for path in (tmp_path / "disk").iterdir()} >= {"gap.json", "model", "report.html"}
    assert not [path for path in (tmp_path / "disk").iterdir() if path.name.startswith(".")]


@pytest.mark.long
def test_a_model_may_be_corrected_in_place(stub: None, runs: tuple[Path, list[Path]], tmp_path: Path) -> None:
    model, (fit, held, _) = runs
    out = tmp_path / "out"
    first = run_gap(model, [fit], held, out)
    Model.load(out / "model")
    second = run_gap(out / "model", [fit], held, out)
    assert first.given.joints == second.given.joints
    Model.load(out / "model")


def test_the_same_run_held_out_is_remarked(stub: None, runs: tuple[Path, list[Path]]) -> None:
    model, (fit, _, _) = runs
    assert any("proves nothing" in note for note in run_gap(model, [fit], fit).notes)


# Bad input.


def bad_model(folder: Path) -> None:
    (folder / "arm.urdf").write_text("<robot")


def no_holdout(folder: Path) -> None:
    (folder / "run_1.csv").unlink()


def other_joints(folder: Path) -> None:
    text = (folder / "run_0.csv").read_text()
    (folder / "run_0.csv").write_text(text.replace("elbow", "wrist"))


def no_torque(folder: Path) -> None:
    text = (folder / "run_1.csv").read_text()
    (folder / "run_1.csv").write_text(text.replace("torque_measured", "temperature"))


def not_a_number(folder: Path) -> None:
    lines = (folder / "run_0.csv").read_text().splitlines()
    lines[7] = lines[7].replace(lines[7].split(",")[1], "nan")
    (folder / "run_0.csv").write_text("\n".join(lines) + "\n")


def too_short(folder: Path) -> None:
    lines = (folder / "run_0.csv").read_text().splitlines()
    (folder / "run_0.csv").write_text("\n".join(lines[:200]) + "\n")


def held_out_too_short(folder: Path) -> None:
    lines = (folder / "run_1.csv").read_text().splitlines()
    (folder / "run_1.csv").write_text("\n".join(lines[:120]) + "\n")


def nothing_logged(folder: Path) -> None:
    log = read_log(folder / "run_1.csv")
    write_log(replace(log, torque=np.zeros_like(log.position)), folder / "run_1.csv")


def out_is_a_file(folder: Path) -> None:
    (folder / "out").write_text("")


def nothing_there(folder: Path) -> None:
    (folder / "arm.urdf").unlink()


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (bad_model, "arm.urdf"),
        (nothing_there, "arm.urdf"),
        (no_holdout, "run_1.csv"),
        (other_joints, "elbow"),
        (no_torque, "run_1.csv"),
        (not_a_number, "line 8"),
        (too_short, "run_0.csv"),
        (held_out_too_short, "run_1.csv: lasts 0.472 s"),
        (nothing_logged, "run_1.csv: all torques are zero"),
        (out_is_a_file, "out"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    spoil: Callable[[Path], None],
    says: str,
    runs: tuple[Path, list[Path]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for path in (runs[0], *runs[1][:2]):
        shutil.copy(path, tmp_path)
    spoil(tmp_path)
    before = {path.name for path in tmp_path.iterdir()}
    given = [tmp_path / part for part in ("arm.urdf", "run_0.csv", "run_1.csv", "out")]
    assert cli.main(arguments(given[0], [given[1]], given[2], given[3])) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("error: ") and says in error
    assert {path.name for path in tmp_path.iterdir()} == before


def test_options_are_required(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main(["gap", "--model", "arm.urdf", "--fit", "a.csv", "--out", "out"])
    assert end.value.code == 2
    assert "--holdout" in capsys.readouterr().err


@pytest.mark.long
def test_nothing_is_left_where_writing_fails(
    stub: None, monkeypatch: pytest.MonkeyPatch, runs: tuple[Path, list[Path]], tmp_path: Path
) -> None:
    def fail(*_: object) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(page, "page", fail)
    model, (fit, held, _) = runs
    with pytest.raises(TwinError, match="No space left"):
        run_gap(model, [fit], held, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_a_single_log_needs_no_list(runs: tuple[Path, list[Path]], tmp_path: Path) -> None:
    model, (_, held, _) = runs
    for log in (tmp_path / "gone", str(tmp_path / "gone")):
        with pytest.raises(TwinError, match="gone: "):
            run_gap(model, log, held)


def test_models_are_named_as_everywhere(tmp_path: Path) -> None:
    """By what comes along and by packages; `predict` and `init` took such a name, `gap` looked for a file."""
    for known, packages in (("arms/ur5e.urdf", {}), ("package://mine/arms/ur5e.urdf", {"mine": models_dir()})):
        with pytest.raises(TwinError, match="gone: no such log file"):
            run_gap(known, tmp_path / "gone", tmp_path / "gone", packages=packages)
    with pytest.raises(TwinError, match=r"arms/none\.urdf: no such file"):
        run_gap("arms/none.urdf", tmp_path / "gone", tmp_path / "gone")


@pytest.mark.long
def test_a_joint_without_torque_is_no_crash(runs: tuple[Path, list[Path]], tmp_path: Path) -> None:
    """A drive that logs nothing: the run does not follow the model, and no catalogue says so of a motor."""
    model, (fit, held, _) = runs
    paths = [tmp_path / "fit.csv", tmp_path / "held.csv"]
    for source, path in zip((fit, held), paths, strict=True):
        log = read_log(source)
        write_log(replace(log, torque=log.motor_torque * [1.0, 0.0]), path)
    gap = run_gap(model, paths[:1], paths[1])
    assert any("torque of elbow is zero" in note for note in gap.notes)
    assert gap.verdict.verdict != "none"


# An effect of one's own: one class and one registration line.


@pytest.fixture
def own_effect() -> Iterator[None]:
    """What CONTRIBUTING.md shows, to the letter."""
    text = (Path(__file__).parents[2] / "CONTRIBUTING.md").read_text()
    (block,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(block, {"__name__": "mine"})
    yield
    del REGISTRY["quadratic_drag"]


@pytest.mark.long
def test_an_effect_of_ones_own_is_found(own_effect: None, tmp_path: Path) -> None:
    secret = EffectSpec("quadratic_drag", ["elbow"], [], {"drag": [2.0]})
    fit, held = bench.write_runs(tmp_path, [secret])
    gap = run_gap(tmp_path / "arm.urdf", [fit], held, tmp_path / "out")
    (effect,) = gap.answer["effects"]
    assert (effect["name"], effect["joints"]) == ("quadratic_drag", ["elbow"])
    estimate = effect["parameters"]["drag"]["elbow"]
    assert estimate["value"] == pytest.approx(2.0, abs=4.0 * estimate["std"] + 0.01)
    assert estimate["unit"] == "N·m·s²/rad²"
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Quadratic drag" in page and "Drag that grows with the square of the speed." in page
    assert Model.load(tmp_path / "out" / "model").effects[-1].value("drag") == pytest.approx(2.0, rel=0.02)


def test_a_law_that_is_not_linear_is_not_searched_for(tmp_path: Path) -> None:
    @register
    class Odd(Effect):
        name: ClassVar[str] = "odd"
        kinds: ClassVar = {"exponent": ParameterKind("1", lower=0.5)}

        def torque(self, model, q, v, a, tau):  # type: ignore[no-untyped-def]
            return np.abs(v) ** self.spread(model.joints, self.value("exponent"))

    try:
        model = Model.load(bench.arm(tmp_path))
        assert name(model, [bench.run(model, seed=1)]).verdict == "none"
    finally:
        del REGISTRY["odd"]


def test_each_stage_has_its_share_of_the_time() -> None:
    """What the code tells and what the table knows are the same; shares only grow."""
    sources = Path(workflow.__file__).parent.rglob("*.py")
    said = {text for source in sources for text in re.findall(r'\bsay\("([^"]+)"\)', source.read_text())}
    assert said == set(workflow.STAGES)
    shares = list(workflow.STAGES.values())
    assert shares == sorted(shares) and shares[0] == 0.0 and shares[-1] < 1.0


def test_stages_are_told_in_their_order(runs: tuple[Path, list[Path]], stub: None) -> None:
    model, (fit, held, _) = runs
    told: list[str] = []
    run_gap(model, [fit], held, None, told.append)
    stages = [text.partition(" (")[0] for text in told]
    assert stages[0] == "reading the logs" and stages[-1] == "rollouts of the held-out run before and after"
    assert [stage for stage in workflow.STAGES if stage in stages] == stages


def test_links_without_mass_are_told_and_frames_welded_to_others_are_not(tmp_path: Path) -> None:
    """Beside a link without an <inertial> an encoder's offset was named that is not there, and nothing said why."""
    body = '<inertial><mass value="2"/><inertia ixx=".02" iyy=".02" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>'
    joints = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><axis xyz="{axis}"/>'
        '<origin xyz="0 0.1 0.2"/><limit lower="-2" upper="2" velocity="2" effort="50"/></joint>'
        for k, axis in enumerate(("0 0 1", "0 1 0", "1 0 0"))
    )
    flange = '<link name="flange"/><joint name="f" type="fixed"><parent link="l3"/><child link="flange"/></joint>'
    links = f'<link name="l0"/><link name="l1">{body}</link><link name="l2"/><link name="l3">{body}</link>'
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{links}{joints}{flange}</robot>', encoding="utf-8")
    (told,) = workflow.told_of_weightless(Model.load(path))
    assert told.startswith("l2: described without any mass")
    path.write_text(
        f'<robot name="arm">{links}{joints}{flange}</robot>'.replace('"l2"/><link', f'"l2">{body}</link><link')
    )
    assert workflow.told_of_weightless(Model.load(path)) == []
    assert workflow.told_of_weightless(Model.load(models_dir() / "arms" / "panda.urdf")) == []
