"""The reconstruction of a grown thing in a process of its own: started, asked after, stopped; never left behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from twin_diagram.assets.building.growth import Growth
from twin_diagram.assets.building.growth_file import write_growth
from twin_diagram.runtime import atomic_file
from twin_diagram.runtime.threads import one_thread_variables
from twin_diagram.twin.growing.worker import ANSWER, PICTURES, REQUEST
from twin_diagram.twin.growing.worker import TUNING as WORKERS

TOLD: Final = "worker.txt"
"""In the folder: what the process said."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    grace: float = 0.5
    """After it was asked to end, a process has this long before it is ended [s]; a stopped run closes within 2 s."""


TUNING = Tuning()

WORKER: Final = (sys.executable, "-m", "twin_diagram.twin.growing.worker")
"""The command that builds in a process of its own."""


@dataclass(frozen=True)
class BuildOutcome:
    """What became of a reconstruction.

    Attributes:
        answer: see `worker.ANSWER`; None where it failed.
        why: in one line what went wrong, where it failed.
        seconds: that the process ran.
    """

    answer: dict[str, Any] | None
    why: str = ""
    seconds: float = 0.0


class BuildProcess:
    """One reconstruction.

    Use as a context manager, or `stop` it: both end the process, whatever it does. Where its starter is killed, it ends
    by itself. An asset that was not whole by then is not in the library.
    """

    def __init__(self, growth: Growth, name: str, library: Path, folder: Path, nice: int = 0) -> None:
        """Write the pictures and start the process.

        Args:
            growth: that is ready.
            name: of the asset.
            library: folder that gets it.
            folder: gets pictures, request and answer.
            nice: how far the process stands back behind others, as in the command of that name.
        """
        self.name, self.folder = name, folder
        folder.mkdir(parents=True, exist_ok=True)
        write_growth(folder / PICTURES, growth)
        request = {"name": name, "library": str(library.resolve()), "nice": nice}
        atomic_file.write(folder / REQUEST, json.dumps(request, indent=2))
        self._begin = time.perf_counter()
        here = str(Path(__file__).resolve().parents[3])
        path = os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])
        with (folder / TOLD).open("wb") as told:
            # Not multiprocessing, which would run the user's own script once more.
            self._process = subprocess.Popen(
                [*WORKER, str(folder)],
                stdin=subprocess.PIPE,
                stdout=told,
                stderr=subprocess.STDOUT,
                env={**os.environ, "PYTHONPATH": path, **one_thread_variables(os.environ)},
                start_new_session=True,  # Ctrl-C on a terminal is for the run, which ends the reconstruction
            )

    _outcome: BuildOutcome | None = None

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._process.pid

    @property
    def age(self) -> float:
        """How long ago it was started [s]."""
        return time.perf_counter() - self._begin

    def poll(self) -> BuildOutcome | None:
        """Return what became of it; None while it runs."""
        if self._outcome is None and self._process.poll() is not None:
            self._outcome = self._read()
        return self._outcome

    def wait(self, seconds: float) -> BuildOutcome | None:
        """Return what `poll` does, after waiting for it so long at most."""
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            pass
        return self.poll()

    def stop(self) -> None:
        """End the process, if it has not ended."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
        except OSError:
            pass
        try:
            self._process.wait(TUNING.grace)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> BuildProcess:
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    def _read(self) -> BuildOutcome:
        seconds, answer = self.age, self.folder / ANSWER
        self.stop()
        status = self._process.returncode
        if status == 0 and answer.is_file():
            return BuildOutcome(json.loads(answer.read_text(encoding="utf-8")), seconds=seconds)
        told = (self.folder / TOLD).read_text(encoding="utf-8", errors="replace")
        return BuildOutcome(None, why_it_failed(status, told), seconds)


def why_it_failed(status: int, told: str) -> str:
    """Return what went wrong, in one line.

    Args:
        status: that the process ended with; negative: the signal that ended it.
        told: all that it said.
    """
    # Of a traceback, the indented lines say where, the last of the others says what.
    lines = [line for line in told.splitlines() if line.strip() and not line[0].isspace()]
    last = lines[-1].strip() if lines else ""
    if status == WORKERS.bad_input and last:
        return last
    if status < 0:
        return f"the reconstruction was ended by a signal: {signal.strsignal(-status) or -status}"
    return f"the reconstruction ended with status {status}: {last or 'it said nothing'}"
