"""Searches in a process of their own: started with a run, ended with it, and never left behind."""

from __future__ import annotations

import logging
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import Final

from twin_diagram.planning.paths.guide import Answer, Guide, Question
from twin_diagram.planning.paths.search_worker import receive, send
from twin_diagram.planning.paths.searching import Searcher
from twin_diagram.runtime.threads import one_thread_variables


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    patience: float = 20.0
    """A search that takes longer hangs [s of the wall clock]: on a busy machine it takes up to a second."""

    grace: float = 0.2
    """After it was asked to end, the process has this long before it is ended [s]."""

    kept: int = 64
    """Answers that are kept at hand: another Context may ask the same."""


TUNING = Tuning()

WORKER: Final = (sys.executable, "-m", "twin_diagram.planning.paths.search_worker")
"""The command that searches in a process of its own."""


class SearchProcess(Searcher):
    """Searches in a process of its own.

    Use as a context manager, or `close` it: both end the process, whatever it does. Where this process is killed, that
    one ends by itself. Once it has failed there are no more answers, and one line has told why.

    Attributes:
        why: in one line what went wrong; empty while all is well.
    """

    def __init__(self, guide: Guide, *, waits: bool = True, patience: float = TUNING.patience) -> None:
        """Start the process.

        Args:
            guide: what searches; a copy of it works there.
            waits: the asker waits for an answer that is late, so that runs are alike; else it counts when it comes.
            patience: see `Tuning`.
        """
        self.why = ""
        self._waits, self._patience = waits, patience
        self._told = TemporaryFile()
        here = str(Path(__file__).resolve().parents[3])
        path = os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])
        # Not multiprocessing, which would run the user's own script once more.
        self._process = subprocess.Popen(
            WORKER,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._told,
            env={**os.environ, "PYTHONPATH": path, **one_thread_variables(os.environ)},
            start_new_session=True,  # a terminal's signal is for the run, which ends the search
        )
        self._asked: queue.Queue[bytes | None] = queue.Queue()
        self._known: dict[bytes, Answer | None] = {}
        self._since: dict[bytes, float] = {}
        self._changed = threading.Condition()
        threading.Thread(target=self._serve, args=(pickle.dumps(guide),), daemon=True).start()

    def ask(self, question: Question) -> None:
        """See `Searcher`; returns at once."""
        key = pickle.dumps(question)
        with self._changed:
            if key in self._known or self.why:
                return
            while len(self._known) >= TUNING.kept:
                oldest = next(iter(self._known))
                self._known.pop(oldest)
                self._since.pop(oldest)
            self._known[key] = None
            self._since[key] = time.monotonic()
        self._asked.put(key)

    def ready(self, question: Question) -> bool:
        """See `Searcher`; also true once what was asked hangs, which `answer` then tells."""
        if self._waits:
            return True
        key = pickle.dumps(question)
        with self._changed:
            there = bool(self.why) or self._known.get(key) is not None
            late = not there and time.monotonic() - self._since.get(key, float("inf")) > self._patience
        if late:
            self._fail(f"gave no answer within {self._patience:g} s")
        return there or late

    def answer(self, question: Question) -> Answer | None:
        """See `Searcher`."""
        self.ask(question)
        key = pickle.dumps(question)
        with self._changed:
            there = self._changed.wait_for(lambda: self.why or self._known[key] is not None, self._patience)
            if there:
                return None if self.why else self._known[key]
        self._fail(f"gave no answer within {self._patience:g} s")
        return None

    def close(self) -> None:
        """End the process."""
        with self._changed:
            self.why = self.why or "closed"
            self._changed.notify_all()
        self._asked.put(None)
        process = self._process
        assert process.stdin is not None
        try:
            process.stdin.close()
        except OSError:
            pass
        try:
            process.wait(TUNING.grace)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def __enter__(self) -> SearchProcess:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _serve(self, guide: bytes) -> None:
        """Carry questions over and answers back, one at a time; in a thread of its own."""
        to, back = self._process.stdin, self._process.stdout
        assert to is not None and back is not None
        try:
            send(to, guide)  # type: ignore[arg-type]
            while (key := self._asked.get()) is not None:
                send(to, key)  # type: ignore[arg-type]
                answer = pickle.loads(receive(back))  # type: ignore[arg-type]
                with self._changed:
                    self._known[key] = answer
                    self._changed.notify_all()
        except (OSError, EOFError, ValueError):
            if not self.why:
                self._fail(self._ending())

    def _fail(self, why: str) -> None:
        with self._changed:
            if self.why:
                return
            self.why = why
            # Told before anyone who waits goes on.
            logging.getLogger("twin_diagram").warning("the process that searches for ways %s: the arm brakes", why)
            self._changed.notify_all()
        self._process.kill()

    def _ending(self) -> str:
        status = self._process.wait()
        if status < 0:
            return f"was ended by a signal ({signal.strsignal(-status) or -status})"
        self._told.seek(0)
        lines = [line for line in self._told.read().decode(errors="replace").splitlines() if line.strip()]
        return f"ended with status {status} ({lines[-1].strip() if lines else 'it said nothing'})"
