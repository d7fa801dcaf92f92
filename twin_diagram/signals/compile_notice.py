"""Tells that loops are being compiled: the first run is silent for half a minute else."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from numba.core import event

PATIENCE = 3.0
"""Compiling is told once it has taken this long [s]: on an idle core one loop takes less, all of the planner's more."""

SAID = "compiling loops; this takes half a minute or more the first time, and is kept for later runs"
"""What is told, once in a process."""


def _on_stderr(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


class CompileNotice(event.Listener):  # type: ignore[misc]  # Numba has no types
    """Tells once in a process that loops are being compiled, where that takes long."""

    def __init__(self, say: Callable[[str], None] = _on_stderr, clock: Callable[[], float] = time.monotonic) -> None:
        """`say`: is told; `clock`: [s]."""
        self._say, self._clock = say, clock
        self._depth, self._begin, self._taken = 0, 0.0, 0.0
        self._told = False

    def on_start(self, event: event.Event) -> None:
        """Count from the outermost loop's start: those that it calls are compiled within."""
        if self._depth == 0:
            self._begin = self._clock()
        self._depth += 1
        self._tell(self._clock() - self._begin)

    def on_end(self, event: event.Event) -> None:
        """Add up what is done."""
        self._depth -= 1
        taken = self._clock() - self._begin
        self._tell(taken)
        if self._depth == 0:
            self._taken += taken

    def _tell(self, taken: float) -> None:
        if not self._told and self._taken + taken >= PATIENCE:
            self._told = True
            self._say(SAID)


def install() -> None:
    """Listen to Numba from now on, in this process; what children say on stderr is kept from the terminal."""
    event.register("numba:compile", CompileNotice())
