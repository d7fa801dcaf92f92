"""A run does not grow: resident memory from second 10 to second 60, in a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).resolve().parents[2]

SCRIPT = """
import json, os, pathlib, sys
from twin_diagram.runs import run
from twin_diagram.scenario.file import load_scenario

def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE")

out, marks, sizes, original = sys.argv[1], [float(t) for t in sys.argv[2:]], {}, run.run_trial

def trial(loop, simulator, duration, progress, each):
    def between(context):
        each(context)
        if marks and context.get_time() >= marks[0] - 1e-9:
            sizes[marks.pop(0)] = resident()
    return original(loop, simulator, duration, progress, between)

run.run_trial = trial
scenario = load_scenario("tabletop", [f"duration={marks[-1]}"])
summary = run.run_scenario(scenario, out=pathlib.Path(out) if out else None, say=lambda text: None)
print(json.dumps({"sizes": sizes, "contacts": summary["contacts"]}))
"""


@pytest.mark.slow
@pytest.mark.parametrize("page", [False, True], ids=["bare", "with a page"])
def test_memory_grows_less_than_5_percent_from_second_10_to_60(page: bool, egl: None, tmp_path: Path) -> None:
    marks = [10.0, 20.0, 30.0, 40.0, 50.0, 60.0]
    argv = [str(tmp_path / "out") if page else "", *map(str, marks)]
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *argv], cwd=CHECKOUT, capture_output=True, text=True, timeout=1200
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    sizes = {float(time): size for time, size in result["sizes"].items()}
    assert set(sizes) == set(marks)
    growth = sizes[60.0] / sizes[10.0] - 1.0
    assert growth < 0.05, {time: f"{size / 1e6:.0f} MB" for time, size in sizes.items()}
