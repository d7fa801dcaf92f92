"""Where searches run: here, or in a process of their own, with the same answers to the bit.

An answer counts at a declared latency in the loop's own time. Until then it may be worked out anywhere: whoever asks
says so early and takes it when it is due, so how loaded the machine is shows in no figure.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

from twin_diagram.planning.paths.guide import Answer, Guide, Question


class Searcher(ABC):
    """Something that answers questions of a guide."""

    @abstractmethod
    def ask(self, question: Question) -> None:
        """Tell that an answer will be wanted."""

    def ready(self, question: Question) -> bool:
        """Return whether an answer that is due may be taken, at once or by waiting for it."""
        return True

    @abstractmethod
    def answer(self, question: Question) -> Answer | None:
        """Return the answer; None where there will be none: what searches has failed."""

    @property
    def last_failure(self) -> str:
        """What went wrong the last time, in one line; empty where nothing has."""
        return ""

    def works(self) -> bool:
        """Return whether what is asked from now on will be answered; what has failed may begin anew here."""
        return True


class Here(Searcher):
    """Searches in this process, when an answer is due."""

    def __init__(self, guide: Guide) -> None:
        self._guide = guide

    def ask(self, question: Question) -> None:
        """See `Searcher`."""

    def answer(self, question: Question) -> Answer | None:
        """See `Searcher`."""
        return self._guide.answer(question)
