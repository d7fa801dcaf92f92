"""Runs reconstructions beside the picking, one at a time; each ends with the run, however that ends."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from twin_diagram.runs.learning.shape_worker import SHAPE
from twin_diagram.runtime.child_process import BAD_INPUT, ChildProcess

WORKER: Final = (sys.executable, "-m", "twin_diagram.runs.learning.shape_worker")
"""The command that makes a shape in a process of its own."""
TOLD: Final = "shape.log"
"""In the folder: what the process said."""


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


class ShapeProcess(ChildProcess[Done]):
    """One reconstruction, of the frames in an object's folder."""

    def __init__(self, name: str, folder: Path) -> None:
        """Start the process; `name`: of the object, `folder`: where its frames are and its shape appears."""
        self.name, self.folder = name, folder
        super().__init__([*WORKER, str(folder)], folder / TOLD)

    def _read(self, status: int) -> Done:
        if status == 0 and (self.folder / SHAPE).is_file():
            return Done(self.name, None)
        why = self.why_it_failed("the reconstruction", status)
        return Done(self.name, f"the reconstruction failed: {why}" if status == BAD_INPUT else why)


class ShapeJobs:
    """A queue of reconstructions."""

    def __init__(self, longest: float = TUNING.longest) -> None:
        """`longest`: that one may take [s]."""
        self._longest = longest
        self._waiting: list[tuple[str, Path]] = []
        self._running: ShapeProcess | None = None

    @property
    def pending(self) -> list[str]:
        """Return the names of what is under way or waits."""
        now = [self._running.name] if self._running else []
        return now + [name for name, _ in self._waiting]

    def add(self, name: str, folder: Path) -> None:
        """Put an object's folder into the queue."""
        self._waiting.append((name, folder))

    def poll(self) -> list[Done]:
        """Start what waits, and return what has ended since the last call."""
        done: list[Done] = []
        if self._running is not None:
            ended = self._running.poll()
            # What has ended in time is not late because nobody looked for a while.
            if ended is None and self._running.age > self._longest:
                self._running.stop()
                ended = Done(self._running.name, f"the reconstruction took more than {self._longest:g} s")
            if ended is not None:
                self._running = None
                done.append(ended)
        if self._running is None and self._waiting:
            self._running = ShapeProcess(*self._waiting.pop(0))
        return done

    def close(self) -> None:
        """End what runs."""
        if self._running is not None:
            self._running.stop()
        self._running, self._waiting = None, []
