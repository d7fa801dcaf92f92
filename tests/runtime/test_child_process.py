"""A process with one task beside this one: it ends with its starter, and what went wrong is told in one line."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from twin_diagram.runtime import child_process
from twin_diagram.runtime.child_process import ORPHANED, ChildProcess, environment, why_it_failed

FAITHFUL = (
    "import time; from twin_diagram.runtime.child_process import end_with_starter; end_with_starter(); time.sleep(1000)"
)


class Task(ChildProcess[str]):
    """A child that runs a line of Python; its outcome says how that ended."""

    def __init__(self, script: str, folder: Path) -> None:
        super().__init__([sys.executable, "-c", script], folder / "told.txt")

    def _read(self, status: int) -> str:
        return self.why_it_failed("the task", status) if status else "done"


def test_its_outcome_is_read_once_it_has_ended(tmp_path: Path) -> None:
    with Task("import sys; sys.stdin.read()", tmp_path) as task:
        assert task.poll() is None and task.wait(0.05) is None
        task.stop()
        assert task.poll() == "done" and task.age > 0.05


def test_it_ends_by_itself_as_soon_as_it_is_stopped(tmp_path: Path) -> None:
    task = Task(FAITHFUL, tmp_path)
    time.sleep(0.5)  # its imports
    task.stop()
    assert task._process.returncode in (ORPHANED, -9)


def test_it_ends_with_a_starter_that_is_gone(tmp_path: Path) -> None:
    starter = (
        "import os, subprocess, sys; "
        f"p = subprocess.Popen([sys.executable, '-c', {FAITHFUL!r}], stdin=-1, stdout=-3); "
        "print(p.pid, flush=True); os._exit(9)"
    )
    done = subprocess.run([sys.executable, "-c", starter], capture_output=True, text=True, env=environment())
    pid, deadline = int(done.stdout), time.monotonic() + 60.0
    while time.monotonic() < deadline:
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.02)
    pytest.fail("it lives")


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 always looks there")
def test_files_where_the_user_works_are_none_of_its_modules(tmp_path: Path) -> None:
    (tmp_path / "queue.py").write_text("raise SystemExit('the user's own')")
    done = subprocess.run(
        [sys.executable, "-m", "twin_diagram.runtime.worker"],
        cwd=tmp_path, env=environment(), stdin=subprocess.DEVNULL, capture_output=True, text=True,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (ORPHANED, ""), "it began, and ended with its input"


@pytest.mark.parametrize(
    ("script", "told"),
    [
        ("raise KeyError('no such joint')", "the task ended with status 1: KeyError: 'no such joint'"),
        ("import os; os.kill(os.getpid(), 9)", "the task was ended by a signal: Killed"),
        ("import sys; print('a.csv: too short'); sys.exit(2)", "a.csv: too short"),
        ("import sys; sys.exit(2)", "the task ended with status 2: it said nothing"),
    ],
)
def test_what_went_wrong_is_one_line(script: str, told: str, tmp_path: Path) -> None:
    with Task(script, tmp_path) as task:
        assert task.wait(30.0) == told


def test_one_that_does_not_end_is_ended(tmp_path: Path) -> None:
    task = Task("import time; time.sleep(1000)", tmp_path)
    child_process.end(task._process, 0.05)
    assert task._process.returncode == -9
    task.stop()


def test_of_a_traceback_the_line_that_says_what() -> None:
    told = "reading\nTraceback (most recent call last):\n  File x\n    y()\nValueError: bad\n  note\n"
    assert why_it_failed("the search", 1, told) == "the search ended with status 1: ValueError: bad"
    assert why_it_failed("the search", 2, "RuntimeWarning: …\nfit.npz: too short\n") == "fit.npz: too short"
    assert "Segmentation fault" in why_it_failed("the search", -11, told)
