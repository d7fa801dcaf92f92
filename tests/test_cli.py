"""The command: bad input ends in one clear line and status 2 with nothing written; good input leaves what it says."""

from __future__ import annotations

import argparse
import errno
import json
import logging
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin_diagram
from tests.small_loop import small_scenario
from twin_diagram import cli
from twin_diagram.logs import read_log
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import load_model_for, rollout_rms, torque_residual_rms
from twin_diagram.runs.score import table
from twin_diagram.runtime import atomic_file, output_place
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.file import dump_scenario, load_scenario, override_scenario
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.compile_notice import SAID

JOINTS = [f"panda_joint{k}" for k in range(1, 8)]
HOME = np.array([0.6, 0.2, 0.0, -2.1, 0.0, 2.3, 1.4])
COMPILING = f"{SAID}\n"
"""What may stand on stderr where nothing was compiled before."""


def write_log(path: Path, joints: list[str] = JOINTS, start: float = 0.0, **columns: float) -> Path:
    """A second of slow motion with a Panda's torques; `columns` replace single values of the 20th row."""
    time = np.arange(200) * 0.005
    q = HOME + 0.1 * np.sin(3.0 * time)[:, None] * np.linspace(1, -1, 7)
    tau = np.stack([Model.load("arms/panda.urdf").inverse_dynamics(x, np.zeros(7), np.zeros(7)) for x in q[:1]])
    rows = np.column_stack([time + start, q, np.repeat(tau, len(q), axis=0)])
    names = ["time", *(f"{s}.{j}" for s in ("position_measured", "torque_measured") for j in joints)]
    for name, value in columns.items():
        rows[20, names.index(name)] = value
    path.write_text("\n".join([",".join(names), *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n")
    return path


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with everything that the bad commands below refer to."""
    folder = tmp_path_factory.mktemp("place")
    write_log(folder / "good.csv")
    write_log(folder / "nan.csv", **{"position_measured.panda_joint3": float("nan")})
    write_log(folder / "back.csv", time=0.01)
    write_log(folder / "other.csv", joints=[f"joint_{k}" for k in range(7)])
    lines = (folder / "good.csv").read_text().splitlines()
    (folder / "ragged.csv").write_text("\n".join([*lines[:30], lines[30] + ",1", *lines[31:]]) + "\n")
    (folder / "words.csv").write_text("\n".join([*lines[:30], lines[30].replace(",", ",x", 1), *lines[31:]]) + "\n")
    (folder / "short.csv").write_text("\n".join(lines[:4]) + "\n")
    (folder / "empty.csv").write_text("")
    (folder / "no_npz.npz").write_bytes(b"PK no zip at all")
    (folder / "pickled.npz").write_bytes(b"")
    np.savez(folder / "pickled.npz", time=np.array([{"a": 1}] * 20, dtype=object))
    (folder / "broken.yaml").write_text("seed: 1\nduration: [1, 2\n")
    (folder / "unknown.yaml").write_text("twin:\n  camera: {lense: wide}\n")
    (folder / "typed.yaml").write_text("twin:\n  filter: {rate: fast}\n")
    (folder / "joint.yaml").write_text("twin:\n  camera: null\n  arm: {joints: [panda_joint1, elbow]}\n")
    (folder / "model.yaml").write_text("twin:\n  camera: null\n  arm: {model: no/arm.urdf}\n")
    (folder / "asset.yaml").write_text("twin:\n  camera: null\n  library: {cup: no/cup}\n")
    (folder / "fixture.yaml").write_text("twin:\n  camera: null\n  fixtures: [{model: no/table.sdf}]\n")
    (folder / "home.yaml").write_text("twin:\n  camera: null\n  home: [1, 2]\n")
    (folder / "broken.urdf").write_text("<robot name='r'><link name='a'>")
    (folder / "no_arm.urdf").write_text("<robot name='r'><link name='a'/></robot>")
    (folder / "text.txt").write_text("hello\n")
    (folder / "full").mkdir()
    (folder / "full" / "precious.txt").write_text("keep me\n")
    (folder / "folder.csv").mkdir()
    (folder / "no_recording").mkdir()
    (folder / "no_recording" / "scenario.yaml").write_text("twin: {camera: null}\n")
    return folder


def listing(folder: Path) -> dict[str, bytes | None]:
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else None for p in sorted(folder.rglob("*"))}


Run = Callable[..., str]


@pytest.fixture
def refused(place: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Iterator[Run]:
    """Runs a command in `place` that must be refused; gives the line that it says."""
    monkeypatch.chdir(place)

    def run(*argv: str) -> str:
        before = listing(place)
        try:
            status = cli.main(argv)
        except SystemExit as end:
            status = end.code
        out, err = capfd.readouterr()
        assert status == 2, (status, out, err)
        assert err.startswith("error: ") and err.count("\n") == 1 and err.endswith("\n"), err
        assert out == ""
        assert listing(place) == before
        return err

    yield run


# What the command line itself says.


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        ([], ["COMMAND"]),
        (["fly"], ["'fly'", "run", "replay", "predict"]),
        (["run"], ["scenario"]),
        (["run", "tabletop", "--quickly"], ["--quickly"]),
        (["run", "tabletop", "--duration", "long"], ["--duration", "'long'"]),
        (["run", "tabletop", "--seed", "1.5"], ["--seed", "'1.5'"]),
        (["run", "tabletop", "--set"], ["--set"]),
        (["replay"], ["DIR_OR_LOG"]),
        (["predict", "--model", "m"], ["--log", "--out"]),
    ],
)  # fmt: skip
def test_a_wrong_command_line(argv: list[str], words: list[str], refused: Run) -> None:
    line = refused(*argv)
    assert all(word in line for word in words), line


# run


RUN_CASES: dict[str, tuple[list[str], list[str]]] = {
    "no such scenario": (["nowhere.yaml"], ["nowhere.yaml", "tabletop"]),
    "a folder": (["full"], ["full"]),
    "broken YAML": (["broken.yaml"], ["broken.yaml", "line 3"]),
    "not a scenario": (["text.txt"], ["text.txt", "mapping"]),
    "not text": (["no_npz.npz"], ["no_npz.npz"]),
    "unknown field": (["unknown.yaml"], ["twin.camera.lense"]),
    "wrong type": (["typed.yaml"], ["twin.filter.rate", "'fast'"]),
    "no such joint": (["joint.yaml"], ["twin.arm.joints", "'elbow'"]),
    "no such model": (["model.yaml"], ["twin.arm.model", "no/arm.urdf"]),
    "no such asset": (["asset.yaml"], ["twin.library.cup", "no/cup"]),
    "no such fixture": (["fixture.yaml"], ["twin.fixtures.0.model", "no/table.sdf"]),
    "home of another length": (["home.yaml"], ["twin.home", "7"]),
    "broken model": (["tabletop", "--set", "twin.camera=null", "--set", "twin.arm.model=broken.urdf"],
                     ["twin.arm.model", "broken.urdf"]),
    "unknown override": (["tabletop", "--set", "twin.filtr.rate=3"], ["twin.filtr", "'filter'"]),
    "override without value": (["tabletop", "--set", "twin.filter.rate"], ["FIELD=VALUE"]),
    "override that is no YAML": (["tabletop", "--set", "twin.home=[1"], ["twin.home"]),
    "no length of time": (["tabletop", "--duration", "0"], ["duration", "0"]),
    "endless": (["tabletop", "--duration", "inf"], ["duration"]),
    "a rate that fills the memory": (["tabletop", "--set", "twin.filter.rate=1e9"], ["twin.filter.rate", "1e+09"]),
    "steps without an end": (["tabletop", "--set", "twin.camera=null", "--set", "world.time_step=1e-9"],
                             ["world.time_step", "1e-09"]),
    "negative seed": (["tabletop", "--seed", "-3"], ["seed", "-3"]),
    "no such station": (["tabletop", "--set", "station=mars"], ["station", "'mars'"]),
    "replay of nothing": (["tabletop", "--set", "station=replay", "--set", "twin.camera=null", "--set",
                           "twin.library={}"], ["replay.log"]),
    "log of another kind": (["tabletop", "--log", "x.txt"], ["--log", "x.txt"]),
    "log in place of a folder": (["tabletop", "--log", "folder.csv"], ["--log", "folder.csv"]),
    "log below a file": (["tabletop", "--log", "text.txt/x.csv"], ["--log", "text.txt"]),
    "out in place of a file": (["tabletop", "--out", "text.txt"], ["--out", "text.txt"]),
    "out below a file": (["tabletop", "--out", "text.txt/out"], ["--out", "text.txt"]),
    "record into something else": (["tabletop", "--record", "full"], ["full"]),
    "record in place of a file": (["tabletop", "--record", "text.txt"], ["--record", "text.txt"]),
    "record below a file": (["tabletop", "--record", "text.txt/deep/rec"], ["--record", "text.txt"]),
}  # fmt: skip


@pytest.mark.parametrize("name", RUN_CASES)
def test_run_refuses(name: str, refused: Run, egl: None) -> None:
    argv, words = RUN_CASES[name]
    line = refused("run", *argv)
    assert all(word in line for word in words), line


@pytest.mark.parametrize("name", ["no such joint", "no such model", "no such asset"])
def test_run_refuses_and_leaves_nothing_where_it_was_to_write(name: str, refused: Run) -> None:
    argv, words = RUN_CASES[name]
    line = refused("run", *argv, "--out", "new/out", "--record", "new/deep/recording", "--log", "new/logs/log.csv")
    assert all(word in line for word in words), line


def test_a_missing_renderer_is_said_before_anything_starts(refused: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    from twin_diagram import native

    def missing() -> None:
        raise native.NativeLibraryError(["libEGL.so.1"])

    monkeypatch.setattr(native, "require_egl", missing)
    assert "libEGL.so.1" in refused("run", "tabletop", "--record", "new")


# replay


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["nowhere"], ["nowhere", "no such"]),
        (["full"], ["full", "scenario.yaml"]),
        (["no_recording"], ["no_recording", "manifest.yaml"]),
        (["good.csv"], ["good.csv", "--model"]),
        (["no_recording", "--model", "arms/panda.urdf"], ["--model", "no_recording"]),
        (["good.csv", "--model", "no.urdf"], ["twin.arm.model", "no.urdf"]),
        (["good.csv", "--model", "broken.urdf"], ["twin.arm.model", "broken.urdf"]),
        (["good.csv", "--model", "no_arm.urdf"], ["twin.arm.model", "no_arm.urdf"]),
        (["good.csv", "--model", "arms/ur5e.urdf"], ["good.csv", "shoulder_pan_joint"]),
        (["text.txt", "--model", "arms/panda.urdf"], ["text.txt"]),
        (["empty.csv", "--model", "arms/panda.urdf"], ["empty.csv"]),
        (["short.csv", "--model", "arms/panda.urdf"], ["short.csv", "3"]),
        (["nan.csv", "--model", "arms/panda.urdf"], ["nan.csv", "position_measured.panda_joint3", "22"]),
        (["back.csv", "--model", "arms/panda.urdf"], ["back.csv", "time", "22"]),
        (["ragged.csv", "--model", "arms/panda.urdf"], ["ragged.csv", "31"]),
        (["words.csv", "--model", "arms/panda.urdf"], ["words.csv", "31", "position_measured.panda_joint1"]),
        (["no_npz.npz", "--model", "arms/panda.urdf"], ["no_npz.npz"]),
        (["pickled.npz", "--model", "arms/panda.urdf"], ["pickled.npz"]),
        (["good.csv", "--model", "arms/panda.urdf", "--set", "twin.filter.rate=0"], ["twin.filter.rate", "0"]),
        (["good.csv", "--model", "arms/panda.urdf", "--out", "text.txt"], ["--out", "text.txt"]),
    ],
)  # fmt: skip
def test_replay_refuses(argv: list[str], words: list[str], refused: Run) -> None:
    line = refused("replay", *argv)
    assert all(word in line for word in words), line


# predict


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"--model": "no.urdf"}, ["no.urdf"]),
        ({"--model": "broken.urdf"}, ["broken.urdf"]),
        ({"--model": "no_arm.urdf"}, ["no_arm.urdf"]),
        ({"--model": "text.txt"}, ["text.txt"]),
        ({"--model": "full"}, ["full", "effects.yaml"]),
        ({"--model": "arms/ur5e.urdf"}, ["shoulder_pan_joint"]),
        ({"--log": "nowhere.csv"}, ["nowhere.csv"]),
        ({"--log": "folder.csv"}, ["folder.csv"]),
        ({"--log": "other.csv"}, ["other.csv", "panda_joint1"]),
        ({"--log": "nan.csv"}, ["nan.csv", "position_measured.panda_joint3"]),
        ({"--log": "back.csv"}, ["back.csv", "time"]),
        ({"--log": "text.txt"}, ["text.txt"]),
        ({"--out": "p.txt"}, ["p.txt", ".csv"]),
        ({"--out": "folder.csv"}, ["folder.csv"]),
        ({"--out": "text.txt/p.csv"}, ["text.txt"]),
        ({"--horizon": "0"}, ["--horizon", "0"]),
        ({"--horizon": "-1"}, ["--horizon", "-1"]),
        ({"--horizon": "nan"}, ["--horizon"]),
        ({"--horizon": "inf"}, ["horizon"]),
        ({"--horizon": "60"}, ["horizon", "60"]),
        ({"--horizon": "soon"}, ["--horizon", "'soon'"]),
    ],
)  # fmt: skip
def test_predict_refuses(changes: dict[str, str], words: list[str], refused: Run) -> None:
    arguments = {"--model": "arms/panda.urdf", "--log": "good.csv", "--out": "p.csv"} | changes
    line = refused("predict", *(word for pair in arguments.items() for word in pair))
    assert all(word in line for word in words), line


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["gap", "--holdout", "b.csv", "--holdout", "c.csv"], ["--holdout", "is given twice, as b.csv and as c.csv"]),
        (["predict", "--horizon", "0.1", "--horizon", "0.3"], ["--horizon", "twice, as 0.1 and as 0.3"]),
        (["replay", ".", "--model", "m.urdf"], ["no recording"]),  # not: it is one and names its own model
    ],
)
def test_what_is_told_twice_or_of_another_kind(argv: list[str], words: list[str], refused: Run) -> None:
    line = refused(*argv)
    assert all(word in line for word in words), line


# Outputs that cannot be written.

PLACES: dict[str, tuple[list[str], list[str]]] = {
    "run": (["tabletop"], ["--out", "--log", "--record"]),
    "replay": (["good.csv", "--model", "arms/panda.urdf"], ["--out"]),
    "predict": (["--model", "arms/panda.urdf", "--log", "good.csv"], ["--out"]),
    "gap": (["--model", "m.urdf", "--fit", "good.csv", "--holdout", "good.csv"], ["--out"]),
}


@pytest.mark.parametrize(("command", "option"), [(name, option) for name in PLACES for option in PLACES[name][1]])
def test_outputs_are_tried_before_the_work(
    command: str, option: str, refused: Run, egl: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(**_: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    def work(*_: object) -> None:
        pytest.fail("it has begun to work")

    monkeypatch.setattr(output_place.tempfile, "NamedTemporaryFile", full)
    for place in ("gap.workflow.read_log", "model.prediction.read_log", "runs.run.make_closed_loop"):
        monkeypatch.setattr(f"twin_diagram.{place}", work)
    monkeypatch.setattr("twin_diagram.runs.outputs.open_recording", work)
    if command == "replay":
        monkeypatch.setattr("twin_diagram.runs.replayed.read_log", read_log)  # how long it takes is asked first
    target = "new/x.csv" if command == "predict" or option == "--log" else "new/x"
    line = refused(command, *PLACES[command][0], option, target)
    assert f"{option} {target}: cannot be written: Read-only file system" in line


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "error: No space left on device\n"),
        (PermissionError(errno.EACCES, "Permission denied", "out/x"), "error: out/x: Permission denied\n"),
        (OSError("two\nlines"), "error: two lines\n"),
        (MemoryError("858 GiB"), "error: not enough memory: 858 GiB\n"),
    ],
)
def test_what_goes_wrong_while_it_is_written_is_one_line(
    error: Exception, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(cli, "_predict", fail)
    assert cli.main(["predict", "--model", "m", "--log", "l", "--out", "o"]) == 2
    assert capsys.readouterr().err == said


def test_output_that_nothing_takes_is_one_line(tmp_path: Path) -> None:
    script = "import sys; from twin_diagram import cli; cli._predict = lambda _: print('x') or 0; sys.exit(cli.main())"
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-c", script, "predict", "--model", "m", "--log", "l", "--out", "o"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=60,
        )
    assert (done.returncode, done.stderr) == (2, "error: No space left on device\n")


def test_output_that_is_closed_is_none() -> None:
    """A bare service, or `>&-`: it ended in a traceback, once all was done."""
    script = "import sys; from twin_diagram import cli; cli._predict = lambda _: print('x') or 0; sys.exit(cli.main())"
    argv = [sys.executable, "-c", script, "predict", "--model", "m", "--log", "l", "--out", "o"]
    done = subprocess.run(["sh", "-c", 'exec "$@" >&-', "sh", *argv], stderr=subprocess.PIPE, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("said", "heard"),
    [
        ("Meshcat: An obj referenced a material library 'x.mtl' that …; no materials will be included.", False),
        ("joint 'j' has non-zero joint friction", False),
        ("warning: Material file [ a.mtl ] not found in a path : assets\nFailed to load material file(s).", False),
        ("warning: The mesh a.obj has its own materials, but material properties have been defined as well.", False),
        ("Rigid (non-deformable) half spaces are not currently supported for deformable contact; …", False),
        ("Meshcat: something else", True),
    ],
)
def test_what_drake_says_of_paint_and_friction_is_left_out(said: str, heard: bool) -> None:
    assert cli._worth_saying(logging.LogRecord("drake", logging.WARNING, "", 0, said, None, None)) is heard


# What works.


@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_predict(suffix: str, place: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / f"p{suffix}"
    assert cli.main(["predict", "--model", "arms/panda.urdf", "--log", str(place / "good.csv"), "--out", str(out)]) == 0
    assert capfd.readouterr().err == ""
    assert [p.name for p in tmp_path.iterdir()] == [out.name]
    if suffix == ".npz":
        with np.load(out, allow_pickle=False) as file:
            columns = dict(file)
    else:
        names, *rows = out.read_text().splitlines()
        columns = dict(zip(names.split(","), np.array([row.split(",") for row in rows], dtype=float).T, strict=True))
    assert set(columns) == {"time"} | {f"{s}_predicted.{j}" for s in ("torque", "position") for j in JOINTS}
    measured = read_log(place / "good.csv")
    assert np.array_equal(columns["time"], measured.time)
    assert all(np.all(np.isfinite(values)) for values in columns.values())
    torque = np.stack([columns[f"torque_predicted.{joint}"] for joint in JOINTS], axis=1)
    assert np.abs(torque - measured.motor_torque)[20:-20].max() < 3.0


def foreign(place: Path, folder: Path) -> tuple[Path, Path]:
    """The good log in degrees and millinewtonmetres, in columns of other names; and the map of them."""
    _, *rows = (place / "good.csv").read_text().splitlines()
    values = np.array([row.split(",") for row in rows], dtype=float)
    values[:, 1:8] *= 180.0 / np.pi
    values[:, 8:] *= 1e3
    head = ",".join(["clock", *(f"{letter}{k}" for letter in "qt" for k in range(7))])
    log, meaning = folder / "foreign.csv", folder / "map.yaml"
    log.write_text("\n".join([head, *(",".join(map(repr, row)) for row in values.tolist())]) + "\n")
    meaning.write_text(
        "time: {column: clock}\nposition_measured: {column: 'q{i}', unit: deg}\n"
        f"torque_measured: {{column: 't{{i}}', unit: mN·m}}\njoints: [{', '.join(JOINTS)}]\n"
    )
    return log, meaning


def test_predict_of_a_foreign_log_says_each_joints_misfit(
    place: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    log, meaning = foreign(place, tmp_path)
    plain = [
        "predict",
        "--model",
        "arms/panda.urdf",
        "--log",
        str(place / "good.csv"),
        "--out",
        str(tmp_path / "a.csv"),
    ]
    assert cli.main(plain) == 0
    said = capfd.readouterr().out
    given = ["--log", str(log), "--columns", str(meaning), "--out", str(tmp_path / "b.csv")]
    assert cli.main(["predict", "--model", "arms/panda.urdf", *given]) == 0
    assert capfd.readouterr().out == said
    lines = said.splitlines()
    assert [line.split()[0] for line in lines[1:]] == JOINTS
    assert all(line.split()[2] == "N·m" and line.split()[4] == "mrad" for line in lines[1:])
    loaded, measured, _ = load_model_for(read_log(place / "good.csv"), "arms/panda.urdf")
    rms = [float(line.split()[1]) for line in lines[1:]]
    assert rms == pytest.approx(torque_residual_rms(loaded, measured), rel=1e-3)
    away = [1e-3 * float(line.split()[3]) for line in lines[1:]]
    assert away == pytest.approx(rollout_rms(loaded, measured), rel=1e-3)


def test_replay_of_a_foreign_log(place: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    log, meaning = foreign(place, tmp_path)
    assert cli.main(["replay", str(log), "--model", "arms/panda.urdf", "--columns", str(meaning)]) == 0
    beliefs = json.loads(capfd.readouterr().out)
    assert np.array(list(beliefs["joints"].values())) == pytest.approx(
        read_log(place / "good.csv").position[-1], abs=5e-3
    )


@pytest.mark.parametrize("given", ["my_arm", "my_arm=nowhere", "=."])
def test_packages_that_cannot_be_are_named(
    given: str, place: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    log = str(place / "good.csv")
    out = tmp_path / "p.csv"
    assert cli.main(["predict", "--model", "m.urdf", "--log", log, "--out", str(out), "--packages", given]) == 2
    assert f"--packages {given}" in capfd.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("called", ["arm #2: new", "bras é", "arm \U0001f9be", os.fsdecode(b"arm \xff"), "arm\n#2\x7f"])
def test_a_packages_folder_is_no_yaml(tmp_path: Path, called: str) -> None:
    """Of a folder called `arm #2: new` a scenario was told `arm`."""
    folder = tmp_path / called
    folder.mkdir()
    arguments = cli._parser().parse_args(["run", "tabletop", "--packages", f"own_arm={folder}"])
    assert override_scenario(Scenario(), cli._overrides(arguments)).packages == {"own_arm": str(folder.resolve())}


def test_a_package_is_found_where_the_flag_says_and_asked_for_by_both_its_names(
    place: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "arm").mkdir()
    shutil.copy(models_dir() / "arms" / "panda.urdf", tmp_path / "arm" / "own.urdf")
    command = ["predict", "--model", "package://own_arm/own.urdf", "--log", str(place / "good.csv")]
    command += ["--out", str(tmp_path / "p.csv")]
    assert cli.main(command) == 2
    said = capfd.readouterr().err
    assert "packages: {own_arm: DIR}" in said and "--packages own_arm=DIR" in said
    assert cli.main([*command, "--packages", f"own_arm={tmp_path / 'arm'}"]) == 0
    assert (tmp_path / "p.csv").is_file()


def test_replay_of_a_bare_log_whose_clock_starts_anywhere(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    log = write_log(tmp_path / "late.csv", start=1234.5)
    assert cli.main(["replay", str(log), "--model", "arms/panda.urdf"]) == 0
    beliefs = json.loads(capfd.readouterr().out)
    assert beliefs["time_s"] == pytest.approx(0.995)
    # The filter stands no farther from the last sample than the arm moves between two.
    assert np.array(list(beliefs["joints"].values())) == pytest.approx(read_log(log).position[-1], abs=5e-3)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, egl: None) -> tuple[Path, dict[str, Any]]:
    """A second of the loop, recorded by the command: scenario.yaml, recording/, log.csv and out/summary.json."""
    folder = tmp_path_factory.mktemp("recorded")
    atomic_file.write(folder / "scenario.yaml", dump_scenario(small_scenario(objects=("can",))))
    argv = [
        "run",
        str(folder / "scenario.yaml"),
        "--duration",
        "1",
        "--seed",
        "5",
        "--record",
        str(folder / "recording"),
    ]
    assert cli.main([*argv, "--log", str(folder / "log.csv"), "--out", str(folder / "out")]) == 0
    return folder, json.loads((folder / "out" / "summary.json").read_text())


def test_run_leaves_what_it_says(recorded: tuple[Path, dict[str, Any]]) -> None:
    folder, summary = recorded
    assert {p.name for p in folder.iterdir()} == {"scenario.yaml", "recording", "log.csv", "out"}
    assert {"summary.json", "replay.html", "diagram.svg"} <= {p.name for p in (folder / "out").iterdir()}
    assert (summary["seed"], summary["duration_s"]) == (5, 1.0)
    assert load_scenario(folder / "recording" / "scenario.yaml").seed == 5


def test_the_log_is_one_that_logs_reads(recorded: tuple[Path, dict[str, Any]]) -> None:
    folder, _ = recorded
    log = read_log(folder / "log.csv")
    assert list(log.joints) == JOINTS
    assert log.time[-1] > 0.99 and len(log) > 390
    assert np.abs(np.diff(log.time)).max() == pytest.approx(1 / 400, rel=1e-6)
    assert log.velocity is not None and log.position_commanded is not None
    assert np.array_equal(log.position, read_log(folder / "recording" / "log.csv").position)


def test_a_recording_replays(recorded: tuple[Path, dict[str, Any]], capfd: pytest.CaptureFixture[str]) -> None:
    folder, summary = recorded
    assert cli.main(["replay", str(folder / "recording")]) == 0
    out, err = capfd.readouterr()
    beliefs = json.loads(out)
    assert err in ("", COMPILING)
    assert beliefs["objects"]["can"]["status"] == "tracked"
    assert beliefs["parameters"]["payload.mass"]["value"] == summary["payload"]["mass_estimated"]


def test_what_a_replay_prints_is_json_whatever_it_writes(
    recorded: tuple[Path, dict[str, Any]], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder, _ = recorded
    arguments = ["--model", "arms/panda_hand.urdf", "--duration", "0.1", "--out", str(tmp_path / "o")]
    assert cli.main(["replay", str(folder / "log.csv"), *arguments]) == 0
    out, err = capfd.readouterr()
    assert json.loads(out)["parameters"]["payload.mass"]["status"] in ("settled", "not excited", "at a bound")
    assert err == f"wrote {tmp_path / 'o'}/\n"


def test_the_log_replays_and_is_predicted(recorded: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    folder, _ = recorded
    log = str(folder / "log.csv")
    assert cli.main(["predict", "--model", "arms/panda_hand.urdf", "--log", log, "--out", str(tmp_path / "p.csv")]) == 0
    assert cli.main(["replay", log, "--model", "arms/panda_hand.urdf", "--duration", "0.2"]) == 0


@pytest.mark.parametrize("damage", ["manifest.yaml", "log.csv", "messages.csv", "gripper.csv", "camera/frames.csv"])
def test_a_recording_that_lacks_a_file_is_refused(
    damage: str, recorded: tuple[Path, dict[str, Any]], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    copy = Path(shutil.copytree(recorded[0] / "recording", tmp_path / "copy"))
    (copy / damage).unlink()
    assert cli.main(["replay", str(copy)]) == 2
    err = capfd.readouterr().err
    assert err.startswith("error: ") and err.count("\n") == 1
    assert Path(damage).name in err


def test_a_failed_run_leaves_an_earlier_recording_and_log_alone(
    recorded: tuple[Path, dict[str, Any]], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """A recording is replaced when its successor is whole, and no log is written from another run's recording."""
    copy = Path(shutil.copytree(recorded[0] / "recording", tmp_path / "copy"))
    before = listing(tmp_path)
    argv = [
        "run",
        "tabletop",
        "--set",
        "twin.arm.joints=[elbow]",
        "--record",
        str(copy),
        "--log",
        str(tmp_path / "log.csv"),
    ]
    assert cli.main(argv) == 2
    assert listing(tmp_path) == before
    assert "twin.arm.joints" in capfd.readouterr().err


# As a program.


def program(*argv: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "twin_diagram", *argv]
    return subprocess.run(
        command, cwd=cwd, env={**os.environ, **environment}, capture_output=True, text=True, timeout=300
    )


@pytest.fixture(autouse=True, scope="module")
def _importable() -> Iterator[None]:
    """The programs below run elsewhere; the checkout need not be installed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", str(Path(twin_diagram.__file__).parent.parent))
        yield


def test_version_and_help(tmp_path: Path) -> None:
    version = program("--version", cwd=tmp_path)
    assert (version.returncode, version.stdout) == (0, f"twin-diagram {twin_diagram.__version__}\n")
    text = program("--help", cwd=tmp_path)
    assert text.returncode == 0
    assert all(word in text.stdout for word in ("run", "replay", "predict"))


@pytest.mark.parametrize("command", ["run", "replay", "predict"])
def test_help_of_each_command(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        cli.main([command, "--help"])
    assert end.value.code == 0
    text = capsys.readouterr().out
    wanted = {
        "run": ["--set", "--seed", "--duration", "--meshcat", "--out", "--record", "--log"],
        "replay": ["--model", "--set", "--out", "--meshcat"],
        "predict": ["--model", "--log", "--out", "--horizon"],
    }
    assert all(word in text for word in wanted[command])


def test_help_of_a_command_begins_with_what_it_does() -> None:
    (commands,) = [action for action in cli._parser()._actions if isinstance(action, argparse._SubParsersAction)]
    (ways,) = [a for a in commands.choices["assets"]._actions if isinstance(a, argparse._SubParsersAction)]
    for several in (commands, ways):
        for listed in several._choices_actions:
            said = several.choices[listed.dest].description
            assert listed.help and said == f"{listed.help[0].upper()}{listed.help[1:]}."


def test_the_program_ends_with_one_line_and_status_two(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text("twin:\n  camera: {lense: wide}\n")
    done = program("run", "s.yaml", "--record", "rec", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: twin.camera.lense: unknown field") and done.stderr.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["s.yaml"]


@pytest.mark.slow
def test_another_process_gives_the_same_numbers(recorded: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    """Whatever order its sets have, however many threads it has, and whether it records or draws."""
    folder, summary = recorded
    argv = ["run", str(folder / "scenario.yaml"), "--duration", "1", "--seed", "5", "--log", "log.csv"]
    done = program(*argv, cwd=tmp_path, PYTHONHASHSEED="123", OMP_NUM_THREADS="2")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "log.csv").read_bytes() == (folder / "log.csv").read_bytes()
    shown = [line.rstrip() for line in done.stdout.splitlines() if not line.startswith("speed")]
    assert shown == [line.rstrip() for line in table(summary | {"timing": {}}).splitlines()]


@pytest.mark.long
def test_a_reader_that_has_enough_is_no_error(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    log = write_log(tmp_path / "log.csv")
    process = subprocess.Popen(
        [sys.executable, "-m", "twin_diagram", "replay", str(log), "--model", "arms/panda.urdf", "--duration", "0.1"],
        stdout=write,
        stderr=subprocess.PIPE,
        text=True,
    )
    os.close(write)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 0 and err in ("", COMPILING)


def test_runs_that_tell_too_little_are_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def too_short(*arguments: Any, **more: Any) -> Any:
        raise np.linalg.LinAlgError("Matrix is not positive definite")

    monkeypatch.setattr("twin_diagram.gap.workflow.run_gap", too_short)
    logs = ["--fit", "a.csv", "--holdout", "b.csv", "--out", str(tmp_path / "o")]
    assert cli.main(["gap", "--model", "arms/ur5e.urdf", *logs]) == 2
    err = capsys.readouterr().err
    assert err.startswith("error: these runs are too short") and err.count("\n") == 1


def test_a_terminal_without_our_letters_gets_the_rest(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "twin_diagram", "fields", "twin.filter"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and "encoder_std" in done.stdout, done.stderr


def test_a_python_that_reads_ascii_is_told_what_to_set(tmp_path: Path) -> None:
    argv = [sys.executable, "-m", "twin_diagram", "init", "--arm", "arms/ur5e.urdf", "--out", "a.yaml"]
    ascii_only = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(argv, cwd=tmp_path, env=ascii_only, capture_output=True, text=True)
    assert done.returncode == 2 and not list(tmp_path.iterdir())
    assert done.stderr.startswith("error: ") and "set PYTHONUTF8=1" in done.stderr and done.stderr.count("\n") == 1
