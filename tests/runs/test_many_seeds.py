"""Many seeds: the table's lines, how many kept each bound, and that a finished run is read back."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from twin_diagram.errors import TwinError
from twin_diagram.runs import many_seeds
from twin_diagram.runs.many_seeds import read_back, run_seeds, seed_line, tell_seeds
from twin_diagram.scenario import Scenario


def entry(position: float | None, rotation: float | None, share: float = 1.0) -> dict[str, Any]:
    return {
        "position_error_mm": {"median": position, "p95": position},
        "rotation_error_deg": {"median": rotation, "p95": rotation},
        "visible_share": share,
    }


def summary(**changes: Any) -> dict[str, Any]:
    values: dict[str, Any] = {
        "seed": 12,
        "objects": {"box": entry(1.5, 0.25), "can": entry(0.75, 2.5)},
        "payload": {"mass_true": 0.8, "mass_estimated": 0.84},
        "goal": {"reached": True, "error_mm": 2.25},
        "clearance_min_mm": 43.6,
        "contacts": 0,
    }
    return values | changes


GOOD = {"tracked": True, "untouched": True, "reached": True, "weighed": True}


def test_a_line_tells_the_worst() -> None:
    line = seed_line(summary(), GOOD)
    assert line.split() == ["12", "box", "1.50", "mm", "can", "2.50", "°", "44", "2.2", "0.800", "+5.0%", "all"]
    kept = {**GOOD, "untouched": False, "reached": False}
    assert seed_line(summary(), kept).endswith("  untouched, reached")


def test_a_line_tells_what_is_missing() -> None:
    hidden = {"box": entry(9.0, 9.0, share=0.0), "can": entry(0.75, 2.5, share=0.001)}
    assert "can 0.75 mm" in seed_line(summary(objects=hidden), GOOD)
    assert seed_line(summary(objects={"box": entry(1.0, 1.0, 0.0)}), GOOD).split()[1:5] == ["–", "mm", "–", "°"]
    lost = {"box": entry(99.0, 99.0), "can": entry(None, None)}
    assert seed_line(summary(objects=lost), GOOD).split()[1:7] == ["can", "lost", "mm", "can", "lost", "°"]
    for payload in ({"mass_true": None, "mass_estimated": 0.1}, {"mass_true": 0.8, "mass_estimated": None}):
        assert seed_line(summary(payload=payload), GOOD).split()[-2:] == ["–", "all"]
    nothing = seed_line(summary(goal={"reached": False, "error_mm": None}, clearance_min_mm=None), GOOD)
    assert nothing.split()[7:9] == ["0", "0.0"]


def test_bounds_that_were_kept_are_counted() -> None:
    said: list[str] = []
    touched = summary(seed=7, contacts=2)
    tell_seeds([summary(), touched, summary(objects={"box": entry(6.0, 1.0)})], said.append)
    assert said[0].split()[:2] == ["seed", "worst"] and said[4] == ""
    assert said[1] == seed_line(summary(), GOOD) and said[2].endswith("untouched") and said[3].endswith("tracked")
    told = [line.split()[:4] for line in said[5:]]
    assert told == [[k, "of", "3", word] for k, word in (("2", "every"), ("2", "no"), ("3", "goal"), ("3", "payload"))]


def test_a_finished_run_is_read_back_and_others_are_varied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[Any, ...]] = []

    def vary(base: Any, seed: int, folder: Path) -> Any:
        calls.append((base.duration, seed, folder))
        base.seed = seed
        return base

    def run_scenario(scenario: Any, **how: Any) -> dict[str, Any]:
        calls.append((scenario.seed, how["out"], how["pictures"], how["quiet"]))
        return {"seed": scenario.seed}

    monkeypatch.setattr(many_seeds, "vary", vary)
    monkeypatch.setattr(many_seeds, "run_scenario", run_scenario)
    folder = tmp_path / "seed_0003"
    task = ("tabletop", ["duration=0.5"], 3, str(folder))
    folder.mkdir()
    assert many_seeds.run_one(task) == {"seed": 3}
    assert calls == [(0.5, 3, folder / "assets"), (3, folder, False, True)]
    assert "seed: 3" in (folder / "scenario.yaml").read_text()
    (folder / "summary.json").write_text(json.dumps({"seed": 99}))
    assert many_seeds.run_one(task) == {"seed": 99} and len(calls) == 2


def test_a_finished_run_of_another_scenario_is_made_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was read back whatever was asked for: a bound that was changed seemed to change nothing."""
    folder = tmp_path / "seed_0003"

    def run_scenario(scenario: Any, **how: Any) -> dict[str, Any]:
        assert not (folder / "summary.json").exists(), "what is there is of what is asked"
        done = {"duration_s": scenario.duration}
        (folder / "summary.json").write_text(json.dumps(done))
        return done

    monkeypatch.setattr(many_seeds, "vary", lambda base, seed, folder: base)
    monkeypatch.setattr(many_seeds, "run_scenario", run_scenario)
    for seconds in (0.5, 0.5, 0.7, 0.5):
        found = many_seeds.run_one(("tabletop", [f"duration={seconds}"], 3, str(folder)))
        assert found == {"duration_s": seconds}


def test_each_seed_has_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    monkeypatch.setattr(many_seeds, "_summaries", lambda tasks, jobs: seen.append((tasks, jobs)) or iter(()))
    run_seeds("tabletop", [5, 12], tmp_path / "deep" / "out", overrides=["duration=1.0"], jobs=3)
    out = tmp_path / "deep" / "out"
    folders = {5: "seed_0005", 12: "seed_0012"}
    tasks = [("tabletop", ["duration=1.0"], seed, str(out / name)) for seed, name in folders.items()]
    assert seen == [(tasks, 3)] and out.is_dir()


ODD_RUN = """
import json, os, signal, sys, time
from pathlib import Path

name, _, seed, folder = json.loads(sys.argv[1])["task"]
if name == "sleeps" and seed > 1:
    Path(folder).write_text(str(os.getpid()))
    time.sleep(600.0)
if name == "killed":
    os.kill(os.getpid(), signal.SIGKILL)
if name == "fails":
    raise ValueError
if name == "wrong":
    print(name, "world: nothing in it", sep="\\n", file=sys.stderr)
    sys.exit(2)
Path(folder).mkdir()
(Path(folder) / "summary.json").write_text(json.dumps({"seed": seed}))
"""
"""In place of a run: one that comes to its end, and others that do not."""


@pytest.fixture
def odd_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(many_seeds, "WORKER", (sys.executable, "-c", ODD_RUN))


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("killed", "seed 4: its process was ended by a signal: Killed"),
        ("fails", "seed 4: its process ended with status 1: ValueError"),
        ("wrong", "world: nothing in it"),
    ],
)
def test_a_run_that_does_not_end_by_itself_ends_all(name: str, told: str, tmp_path: Path, odd_run: None) -> None:
    """A pool waited forever for one that was killed."""
    with pytest.raises(TwinError) as error:
        list(many_seeds._summaries([("fine", [], 3, str(tmp_path / "3")), (name, [], 4, "")], 2))
    assert str(error.value) == told


@pytest.mark.long
def test_a_script_needs_no_guard_and_its_effects_are_known(tmp_path: Path) -> None:
    """Each run's process did once more what the script does, down to starting runs."""
    folder = tmp_path / "out" / "seed_0003"
    folder.mkdir(parents=True)
    (folder / "summary.json").write_text('{"seed": 3}')
    (tmp_path / "my_effect.py").write_text(
        "from pathlib import Path\n\nfrom twin_diagram.model import Effect, register\n\n\n"
        '@register\nclass Mine(Effect):\n    """Mine."""\n\n    name = "mine"\n    kinds = {}\n\n\n'
        'with (Path(__file__).parent / "told").open("a") as file:\n    file.write("x")\n'
    )
    script = tmp_path / "script.py"
    script.write_text(
        "import my_effect\nfrom pathlib import Path\nfrom twin_diagram.runs import run_seeds\n"
        'print(list(run_seeds("tabletop", [3], Path(__file__).parent / "out")))\n'
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=100, check=False)
    assert done.stdout == "[{'seed': 3}]\n", done.stderr
    assert (tmp_path / "told").read_text() == "xx", "once by the script, once by the run's process"


def test_runs_end_where_nobody_wants_them_any_more(tmp_path: Path, odd_run: None) -> None:
    summaries = many_seeds._summaries([("sleeps", [], seed, str(tmp_path / str(seed))) for seed in range(1, 9)], 2)
    assert next(summaries) == {"seed": 1}
    pid = ""
    while not pid:
        time.sleep(0.05)
        pid = (tmp_path / "2").read_text() if (tmp_path / "2").exists() else ""
    summaries.close()  # type: ignore[attr-defined]
    assert not Path("/proc", pid).exists()
    assert {path.name for path in tmp_path.iterdir()} <= {"1", "2", "3"}, "those that had not begun never do"


def test_a_run_that_was_stopped_is_made_anew(tmp_path: Path) -> None:
    plan = Scenario()
    assert read_back(tmp_path, plan) is None  # and what is asked is kept
    for stopped, found in (({"stopped": True}, None), ({}, {"seed": 0})):
        (tmp_path / "summary.json").write_text(json.dumps({"seed": 0} | stopped))
        assert read_back(tmp_path, plan) == found
        assert (tmp_path / "summary.json").exists() == (found is not None)
