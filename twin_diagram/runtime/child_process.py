"""A process with one task beside this one: started, asked after, ended; it never outlives the one that started it."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

from twin_diagram.runtime.threads import one_thread_variables

BAD_INPUT: Final = 2
"""Exit status of a child that cannot use what it was given, as of the command line; its last line says why."""
ORPHANED: Final = 3
"""Exit status of a child whose starter is gone."""

Outcome = TypeVar("Outcome")
"""What a task comes to."""
Child = TypeVar("Child", bound="ChildProcess[Any]")
"""A kind of child."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    grace: float = 0.5
    """After it was asked to end, a process has this long before it is ended [s]; a stopped run closes within 2 s."""


TUNING = Tuning()


class ChildProcess(ABC, Generic[Outcome]):
    """One task in a process of its own.

    Use as a context manager, or `stop` it: both end the process, whatever it does. Where its starter is killed, it ends
    by itself, as its program calls `end_with_starter`.
    """

    def __init__(self, command: Sequence[str], told: Path) -> None:
        """Start the process.

        Args:
            command: to run.
            told: file that gets what it says.
        """
        self._told, self._outcome = told, None
        self._begin = time.perf_counter()
        with told.open("wb") as file:
            # Not multiprocessing, which would run the user's own script once more.
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=file,
                stderr=subprocess.STDOUT,
                env=environment(),
                start_new_session=True,  # Ctrl-C on a terminal is for the run, which ends its children
            )

    _outcome: Outcome | None

    @abstractmethod
    def _read(self, status: int) -> Outcome:
        """Return what became of the task, whose process ended with a status."""

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    @property
    def age(self) -> float:
        """How long ago it was started [s]."""
        return time.perf_counter() - self._begin

    def poll(self) -> Outcome | None:
        """Return what became of it; None while it runs."""
        if self._outcome is None and self._process.poll() is not None:
            self.stop()
            self._outcome = self._read(self._process.returncode)
        return self._outcome

    def wait(self, seconds: float) -> Outcome | None:
        """Return what `poll` does, after waiting for it so long at most."""
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            pass
        return self.poll()

    def stop(self) -> None:
        """End the process, if it has not ended."""
        end(self._process, TUNING.grace)

    def why_it_failed(self, task: str, status: int) -> str:
        """Return what went wrong, in one line; `task`: what the process did, as `the search`."""
        return why_it_failed(task, status, self._told.read_text(encoding="utf-8", errors="replace"))

    def __enter__(self: Child) -> Child:
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()


def environment() -> dict[str, str]:
    """Return this process's own, with this package on the path, and one thread unless the user said otherwise.

    What lies where the user works is not: from Python 3.11 on a `queue.py` there is none of the child's modules.
    """
    here = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "PYTHONPATH": path, "PYTHONSAFEPATH": "1", **one_thread_variables(os.environ)}


def end(process: subprocess.Popen[bytes], grace: float) -> None:
    """End a process that ends with its standard input.

    Args:
        process: with a pipe for its standard input.
        grace: how long it has to end by itself [s].
    """
    assert process.stdin is not None
    try:
        process.stdin.close()
    except OSError:
        pass
    try:
        process.wait(grace)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def why_it_failed(task: str, status: int, told: str) -> str:
    """Return what went wrong with a process, in one line.

    Args:
        task: what it did, as `the search`.
        status: that it ended with; negative: the signal that ended it.
        told: all that it said.
    """
    # Of a traceback, the indented lines say where, the last of the others says what.
    lines = [line for line in told.splitlines() if line.strip() and not line[0].isspace()]
    last = lines[-1].strip() if lines else ""
    if status == BAD_INPUT and last:
        return last
    if status < 0:
        return f"{task} was ended by a signal: {signal.strsignal(-status) or -status}"
    return f"{task} ended with status {status}: {last or 'it said nothing'}"


def end_with_starter() -> None:
    """End this process as soon as its standard input ends, which its starter holds open."""
    threading.Thread(target=_wait_for_the_end, daemon=True).start()


def _wait_for_the_end() -> None:
    # Not through sys.stdin: whoever holds its lock when the interpreter ends brings it down.
    while os.read(0, 4096):
        pass
    os._exit(ORPHANED)
