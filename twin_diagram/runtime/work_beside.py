"""Work that is done in a process of its own before its result is due, the same to the bit as if it were done here.

A result counts at a declared time in the loop's own clock. Until then it may be worked out anywhere: whoever will want
it says so early and takes it when it is due, so how loaded the machine is shows in no figure.
"""

from __future__ import annotations

import logging
import pickle
import threading
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from twin_diagram.runtime.worker_process import WorkerProcess

Question = TypeVar("Question")
Answer = TypeVar("Answer")
Asked = TypeVar("Asked", contravariant=True)
Told = TypeVar("Told", covariant=True)


class Answering(Protocol[Asked, Told]):
    """What answers questions: the answer is a function of the question alone. It and the questions can be pickled.

    Questions are kept until they are answered, so nobody changes them. One may have a method `warm_up`: its process
    calls it before it counts as begun.
    """

    def answer(self, question: Asked, /) -> Told:
        """Return the answer."""
        ...


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    patience: float = 20.0
    """What takes longer hangs [s of the wall clock]: on a busy machine an answer takes up to a second …"""

    beginning: float = 180.0
    """… but for the first one [s of the wall clock]: a process takes seconds to begin, and after an installation it
    compiles loops for half a minute of a core, of which others may take most."""

    kept: int = 8
    """Answers that are kept at hand: another Context may ask the same."""


TUNING = Tuning()


@dataclass
class _Asked:
    """A question, the bytes of it that were sent, and its answer as soon as that is there."""

    question: Any
    sent: bytes
    answer: Any = None


class WorkBeside(Generic[Question, Answer]):
    """Answers questions in a process of its own.

    Use as a context manager, or `close` it: both end the process, whatever it does. Where this process is killed, that
    one ends by itself. When it fails one line tells why, and there are no answers any more: who asks works them out.

    Attributes:
        why: in one line what is wrong; empty while all is well.
    """

    def __init__(self, answering: Answering[Question, Answer], does: str, patience: float | None = None) -> None:
        """Start the process.

        Args:
            answering: a copy of it works there.
            does: what it does, for the line that tells of its failure: `takes pictures`.
            patience: with each answer [s of the wall clock]; None: see `Tuning`.
        """
        self.why = ""
        self._does = does
        self._patience = TUNING.beginning if patience is None else patience
        self._later = TUNING.patience if patience is None else patience
        self._known: list[_Asked] = []
        self._changed = threading.Condition()
        self._worker = WorkerProcess(pickle.dumps(answering), self._answered, self._fail)

    def wait(self) -> None:
        """Wait until the process has begun: what is asked after that waits for nothing that is done once."""
        if not self._worker.begun.wait(self._patience):
            self._fail(self._worker, f"did not begin within {self._patience:g} s")

    def ask(self, question: Question) -> None:
        """Tell that an answer will be wanted; returns at once."""
        with self._changed:
            if self.why or self._find(question) is not None:
                return
            asked = _Asked(question, pickle.dumps(question, protocol=pickle.HIGHEST_PROTOCOL))
            self._known = [*self._known[max(0, len(self._known) - TUNING.kept + 1) :], asked]
        self._worker.ask(asked.sent)

    def answer(self, question: Question) -> Answer | None:
        """Return the answer, waiting for it; None where nobody asked for it, or what answers has failed."""
        with self._changed:
            asked = self._find(question)
            if asked is None:
                return None
            if self._changed.wait_for(lambda: self.why or asked.answer is not None, self._patience):
                return asked.answer  # type: ignore[no-any-return]
        self._fail(self._worker, f"gave no answer within {self._patience:g} s")
        return None

    def _find(self, question: Question) -> _Asked | None:
        """Return what was asked alike; the newest first."""
        return next((asked for asked in reversed(self._known) if alike(asked.question, question)), None)

    def close(self) -> None:
        """End the process."""
        with self._changed:
            self.why = self.why or "closed"
            self._changed.notify_all()
        self._worker.end()

    def __enter__(self) -> WorkBeside[Question, Answer]:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _answered(self, sent: bytes, answer: Any) -> None:
        with self._changed:
            self._patience = self._later
            for asked in self._known:
                if asked.sent is sent:
                    asked.answer, asked.sent = answer, b""
            self._changed.notify_all()

    def _fail(self, worker: WorkerProcess, why: str) -> None:
        with self._changed:
            if self.why:
                return
            self.why = why
            logging.getLogger("twin_diagram").warning(
                "the process that %s %s: it goes on here, slower", self._does, why
            )
            self._changed.notify_all()
        worker.process.kill()


def alike(one: object, other: object) -> bool:
    """Return whether two questions are the same to the bit: an image's million numbers are not packed to compare them.

    Args:
        one: a question or a part of one.
        other: likewise.
    """
    if one is other:
        return True
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray) and not one.dtype.hasobject:
        return one.dtype == other.dtype and one.shape == other.shape and _same_bits(one, other)
    if is_dataclass(one):
        return all(alike(getattr(one, field.name), getattr(other, field.name)) for field in fields(one))
    return pickle.dumps(one) == pickle.dumps(other)


def _same_bits(one: npt.NDArray[Any], other: npt.NDArray[Any]) -> bool:
    """Return whether two arrays of one kind and shape are the same to the bit; those of images without a copy."""
    if one.flags.c_contiguous and other.flags.c_contiguous and one.nbytes % 8 == 0:
        return bool(np.array_equal(one.reshape(-1).view(np.uint64), other.reshape(-1).view(np.uint64)))
    return one.tobytes() == other.tobytes()
