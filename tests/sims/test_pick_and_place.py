"""`sims/pick_and_place.py`: an object of hidden mass is taken, carried and put down by a loop that has images alone."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parent.parent.parent / "sims" / "pick_and_place.py"


@pytest.mark.slow
def test_one_table(tmp_path: Path) -> None:
    command = [sys.executable, str(SCRIPT), "--first", "0", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1500, check=True)
    assert "1 of 1 succeeded" in done.stdout, done.stdout
    folder = tmp_path / "0000"
    assert (folder / "replay.html").is_file() and (folder / "events.jsonl").is_file()


@pytest.mark.long
def test_what_cannot_be_drawn_is_one_line(tmp_path: Path) -> None:
    command = [sys.executable, str(SCRIPT), "--scenario", "tabletop", "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 2 and done.stderr.startswith("error: twin.task.steps") and done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()
