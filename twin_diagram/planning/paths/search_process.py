"""Searches in a process of their own: started with a run, anew when it fails, ended with it, never left behind."""

from __future__ import annotations

import logging
import pickle
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

from twin_diagram.planning.paths.guide import Answer, Guide, Question
from twin_diagram.planning.paths.searching import Searcher
from twin_diagram.runtime.worker_process import WorkerProcess


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    patience: float = 20.0
    """A search that takes longer hangs [s of the wall clock]: on a busy machine it takes up to a second …"""

    beginning: float = 180.0
    """… but for a process's first [s of the wall clock], which may compile loops; as `work_beside` has it."""

    pauses: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0, 8.0)
    """Between a failure and the next start [s of the wall clock], one for each start anew: what fails by chance is soon
    back, what fails always does not take up the machine, and is given up after the last."""

    kept: int = 64
    """Answers that are kept at hand: another Context may ask the same."""


TUNING = Tuning()


class SearchProcess(Searcher):
    """Searches in a process of its own.

    Use as a context manager, or `close` it: both end the process, whatever it does. Where this process is killed, that
    one ends by itself. When it fails one line tells why, and there are no answers until `works` has started another.

    Attributes:
        why: in one line what is wrong; empty while all is well.
        failures: what went wrong so far, oldest first.
    """

    def __init__(
        self,
        guide: Guide,
        *,
        waits: bool = True,
        patience: float | None = None,
        pauses: Sequence[float] | None = None,
    ) -> None:
        """Start the process.

        Args:
            guide: what searches; a copy of it works there.
            waits: the asker waits for an answer that is late, so that runs are alike; else it counts when it comes.
            patience: see `Tuning`; None: what stands there.
            pauses: likewise.
        """
        self.why = ""
        self.failures: list[str] = []
        self._waits = waits
        self._first = TUNING.beginning if patience is None else patience
        self._later = TUNING.patience if patience is None else patience
        self._patience = self._first
        self._pauses = TUNING.pauses if pauses is None else tuple(pauses)
        self._known: dict[bytes, Answer | None] = {}
        self._since: dict[bytes, float] = {}
        self._failed_at = 0.0
        self._closed = False
        self._changed = threading.Condition()
        self._guide = pickle.dumps(guide)
        self._child = WorkerProcess(self._guide, self._answered, self._fail)

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
        self._child.ask(key)

    def ready(self, question: Question) -> bool:
        """See `Searcher`; also true once what was asked hangs, which `answer` then tells."""
        if self._waits:
            return True
        key = pickle.dumps(question)
        with self._changed:
            there = bool(self.why) or self._known.get(key) is not None
            late = not there and time.monotonic() - self._since.get(key, float("inf")) > self._patience
        if late:
            self._fail(self._child, f"gave no answer within {self._patience:g} s")
        return there or late

    def answer(self, question: Question) -> Answer | None:
        """See `Searcher`."""
        self.ask(question)
        key = pickle.dumps(question)
        with self._changed:
            there = self._changed.wait_for(lambda: self.why or self._known[key] is not None, self._patience)
            if there:
                return None if self.why else self._known[key]
        self._fail(self._child, f"gave no answer within {self._patience:g} s")
        return None

    @property
    def last_failure(self) -> str:
        """See `Searcher`."""
        return self.failures[-1] if self.failures else ""

    def works(self) -> bool:
        """See `Searcher`: where the process has failed and its pause is over, another is started."""
        with self._changed:
            if not self.why:
                return True
            tries = len(self.failures)
            if self._closed or tries > len(self._pauses):
                return False
            if time.monotonic() - self._failed_at < self._pauses[tries - 1]:
                return False
        self._child.end(0.0)
        with self._changed:
            # What was asked of the one before nobody answers any more.
            self._known = {key: answer for key, answer in self._known.items() if answer is not None}
            self._since = {key: self._since[key] for key in self._known}
            self._child = WorkerProcess(self._guide, self._answered, self._fail)
            self._patience = self._first
            self.why = ""
        return True

    def close(self) -> None:
        """End the process."""
        with self._changed:
            self._closed = True
            self.why = self.why or "closed"
            self._changed.notify_all()
        self._child.end()

    def __enter__(self) -> SearchProcess:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _answered(self, key: bytes, answer: Answer) -> None:
        with self._changed:
            self._known[key] = answer
            self._patience = self._later
            self._changed.notify_all()

    def _fail(self, child: WorkerProcess, why: str) -> None:
        with self._changed:
            if self.why or child is not self._child:
                return
            self.why = why
            self.failures.append(why)
            self._failed_at = time.monotonic()
            count, most = len(self.failures), len(self._pauses)
            again = f"it is started anew in {self._pauses[count - 1]:g} s, " if count <= most else ""
            often = f" ({count} times in all, it is not started again)" if count > most > 0 else ""
            # Told before anyone who waits goes on.
            logging.getLogger("twin_diagram").warning(
                "the process that searches for ways %s%s: %sthe arm brakes", why, often, again
            )
            self._changed.notify_all()
        child.process.kill()
