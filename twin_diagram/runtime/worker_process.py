"""One process that works beside this one, and the thread that carries questions over to it and answers back."""

from __future__ import annotations

import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from tempfile import TemporaryFile
from typing import Any, Final

from twin_diagram.runtime.child_process import end, environment
from twin_diagram.runtime.worker import receive, send


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    grace: float = 0.2
    """After it was asked to end, the process has this long before it is ended [s]."""


TUNING = Tuning()

WORKER: Final = (sys.executable, "-m", "twin_diagram.runtime.worker")
"""The command that works in a process of its own."""

IMAGE_THREADS: Final = {"OPENCV_FOR_THREADS_NUM": "1"}
"""As everywhere in a run, a second thread for small images costs more than it gives."""


class WorkerProcess:
    """A process that answers questions until it ends, by itself or by `end`; it is never started again.

    Attributes:
        process: the process.
        begun: set once it has read what answers and warmed it up, or has ended.
    """

    def __init__(
        self, answering: bytes, answered: Callable[[bytes, Any], None], failed: Callable[[WorkerProcess, str], None]
    ) -> None:
        """Start the process.

        Args:
            answering: what has a method `answer`, pickled; a copy of it works there.
            answered: takes a question, pickled, and its answer; called in a thread of its own.
            failed: takes what went wrong where the process ended without being asked to; called likewise.
        """
        self._answered, self._failed = answered, failed
        self.begun = threading.Event()
        self._told = TemporaryFile()
        # Not multiprocessing, which would run the user's own script once more.
        self.process = subprocess.Popen(
            WORKER,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._told,
            env={**environment(), **IMAGE_THREADS},
            start_new_session=True,  # a terminal's signal is for the run, which ends the worker
        )
        self._asked: queue.Queue[bytes | None] = queue.Queue()
        self._ended = False
        threading.Thread(target=self._serve, args=(answering,), daemon=True).start()

    def ask(self, key: bytes) -> None:
        """Hand a question over, pickled; returns at once."""
        self._asked.put(key)

    def end(self, grace: float = TUNING.grace) -> None:
        """End the process, which has so long to do so by itself [s]."""
        self._ended = True
        self._asked.put(None)
        end(self.process, grace)

    def _serve(self, answering: bytes) -> None:
        """Carry questions over and answers back, one at a time; in a thread of its own."""
        to, back = self.process.stdin, self.process.stdout
        assert to is not None and back is not None
        try:
            send(to, answering)  # type: ignore[arg-type]
            receive(back)  # type: ignore[arg-type]
            self.begun.set()
            while (key := self._asked.get()) is not None:
                send(to, key)  # type: ignore[arg-type]
                self._answered(key, pickle.loads(receive(back)))  # type: ignore[arg-type]
        except (OSError, EOFError, ValueError):
            if not self._ended:
                self._failed(self, self._ending())
            self.begun.set()

    def _ending(self) -> str:
        status = self.process.wait()
        if status < 0:
            return f"was ended by a signal ({signal.strsignal(-status) or -status})"
        self._told.seek(0)
        lines = [line for line in self._told.read().decode(errors="replace").splitlines() if line.strip()]
        return f"ended with status {status} ({lines[-1].strip() if lines else 'it said nothing'})"
