"""Runs reconstructions beside the picking, one at a time; each ends with the run, however that ends."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from twin_diagram.runs.learning.shape_worker import SHAPE


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    longest: float = 900.0
    """A reconstruction that takes longer has failed [s]: ten times what a hundred pictures take."""


TUNING = Tuning()


@dataclass(frozen=True)
class Done:
    """A reconstruction that has ended: of which object, and why it failed; None: it did not."""

    name: str
    why: str | None


class ShapeJobs:
    """A queue of reconstructions."""

    def __init__(self, longest: float = TUNING.longest) -> None:
        """`longest`: that one may take [s]."""
        self._longest = longest
        self._waiting: list[tuple[str, Path]] = []
        self._running: tuple[str, Path, subprocess.Popen[bytes], float] | None = None

    @property
    def pending(self) -> list[str]:
        """Names of what is under way or waits."""
        now = [self._running[0]] if self._running else []
        return now + [name for name, _ in self._waiting]

    def add(self, name: str, folder: Path) -> None:
        """Put an object's folder into the queue."""
        self._waiting.append((name, folder))

    def poll(self) -> list[Done]:
        """Start what waits, and return what has ended since the last call."""
        done: list[Done] = []
        if self._running is not None:
            name, folder, process, begun = self._running
            # What has ended in time is not late because nobody looked for a while.
            late = process.poll() is None and time.monotonic() - begun > self._longest
            if late:
                process.kill()
                process.wait()
            if process.poll() is not None:
                self._running = None
                done.append(Done(name, self._why(folder, process, late)))
        if self._running is None and self._waiting:
            name, folder = self._waiting.pop(0)
            self._running = (name, folder, self._start(folder), time.monotonic())
        return done

    def _start(self, folder: Path) -> subprocess.Popen[bytes]:
        with (folder / "shape.log").open("wb") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "twin_diagram.runs.learning.shape_worker", str(folder)],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def _why(self, folder: Path, process: subprocess.Popen[bytes], late: bool) -> str | None:
        if late:
            return f"the reconstruction took more than {self._longest:g} s"
        if process.returncode == 0 and (folder / SHAPE).is_file():
            return None
        lines = (folder / "shape.log").read_text(errors="replace").strip().splitlines()
        said = lines[-1] if lines else f"exit status {process.returncode}"
        return f"the reconstruction failed: {said}"

    def close(self) -> None:
        """End what runs."""
        if self._running is not None:
            process = self._running[2]
            process.kill()
            with contextlib.suppress(OSError, subprocess.TimeoutExpired):
                process.wait(timeout=2.0)
        self._running, self._waiting = None, []
