"""The script that runs the loop over many seeds: two of them whole, and what its table says."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from twin_diagram.runs.score import within
from twin_diagram.scenario.file import load_scenario

CHECKOUT = Path(__file__).resolve().parents[2]
OBJECTS = {"cracker_box", "sugar_box", "gelatin_box", "can", "mug", "mover"}


def closed_loop(*argv: str, out: Path, timeout: float = 300.0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(CHECKOUT / "sims" / "closed_loop.py"), *argv, "--out", str(out)]
    # Where the package is not installed the script finds it in the checkout.
    environment = {**os.environ, "PYTHONPATH": str(CHECKOUT)}
    return subprocess.run(command, cwd=CHECKOUT, env=environment, capture_output=True, text=True, timeout=timeout)


@pytest.mark.slow
def test_two_seeds_keep_every_bound_and_are_told_in_a_table(egl: None, tmp_path: Path) -> None:
    done = closed_loop("--seeds", "2", out=tmp_path, timeout=1200.0)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].split()[0] == "seed" and lines[0].split()[-1] == "kept"
    rows = [line for line in lines if re.match(r"\s+\d+\s+\w+ \d+\.\d+ mm", line)]
    assert [int(row.split()[0]) for row in rows] == [1, 2]
    totals = {line.strip() for line in lines if " of 2  " in line}
    assert totals == {
        "2 of 2  every visible object within 5 mm and 5° (median; about a symmetric axis excepted)",
        "2 of 2  no contact",
        "2 of 2  goal reached",
        "2 of 2  payload mass within 15 %",
    }, done.stdout
    assert all(row.endswith("  all") for row in rows)

    summaries, scenarios = [], []
    for seed in (1, 2):
        folder = tmp_path / f"seed_{seed:04d}"
        summary = json.loads((folder / "summary.json").read_text())
        assert all(within(summary).values())
        assert (summary["seed"], summary["duration_s"]) == (seed, 10.0)
        assert set(summary["objects"]) == OBJECTS
        assert summary["objects"]["can"]["symmetric_axis"] == "z"
        scenario = load_scenario(folder / "scenario.yaml")
        assert 0.2 <= summary["payload"]["mass_true"] <= 1.5
        assert scenario.world.arm.effects[0].parameters["mass"] == [summary["payload"]["mass_true"]]
        summaries.append(summary)
        scenarios.append(scenario)
    # Drawn afresh: poses, textures, payload and path.
    first, second = scenarios
    assert summaries[0]["payload"]["mass_true"] != summaries[1]["payload"]["mass_true"]
    for name in OBJECTS - {"mover"}:
        assert first.world.objects[name].X_WO != second.world.objects[name].X_WO
    assert first.world.objects["mover"].path != second.world.objects["mover"].path
    assert first.twin.library["mug"] != second.twin.library["mug"]
    textures = [sorted(Path(s.twin.library["mug"]).glob("*.png")) for s in scenarios]
    assert textures[0][0].read_bytes() != textures[1][0].read_bytes()
    # And of all this the twin is told the textures alone.
    first.twin.library = second.twin.library = {}
    assert first.twin == second.twin


@pytest.mark.long
def test_bad_input_ends_in_one_line(tmp_path: Path) -> None:
    done = closed_loop("--seeds", "1", "--set", "twin.filtr.rate=3", out=tmp_path / "out")
    assert done.returncode == 2
    assert done.stderr.startswith("error: twin.filtr") and done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_what_only_a_run_finds_out_ends_in_one_line_too(tmp_path: Path) -> None:
    """An error crosses from the process of the run to that of the command."""
    done = closed_loop("--seeds", "1", "--set", "twin.filter.rate=-1", "--set", "twin.camera=null", out=tmp_path)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("error: twin.filter.rate: ")
