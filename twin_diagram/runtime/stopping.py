"""SIGINT and SIGTERM as an ordinary end of a command: once, it closes what is open; twice, it ends at once."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Final


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    patience: float = 0.3
    """A step that takes longer after a signal is broken off [s]; closing has the rest of the 2 s that all may take."""

    again: float = 0.02
    """What must not be broken off is looked at again after this [s]: importing pydrake takes a quarter of a second."""


TUNING = Tuning()


class Stopped(KeyboardInterrupt):
    """A signal asked the command to end.

    Attributes:
        status: that the command exits with, as shells have it.
    """

    def __init__(self, number: int) -> None:
        super().__init__(f"stopped by {signal.Signals(number).name}")
        self.status = 128 + number


@dataclass
class _State:
    """What signals have said to this process."""

    asked: int = 0
    """The signal that came; 0: none."""

    stepping: bool = False
    """Whether steps are taken, after each of which `check` is called."""

    until: float = 0.0
    """While what is open is closed, `check` lets steps pass up to this time of the monotonic clock [s]."""


_state: Final = _State()


@contextmanager
def stoppable() -> Iterator[None]:
    """Have SIGINT and SIGTERM raise `Stopped`; a second one ends the process, and children with it, whose pipes break.

    Elsewhere than in the main thread, which alone may handle signals, nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {signal.SIGINT: _on_signal, signal.SIGTERM: _on_signal, signal.SIGALRM: _on_alarm}
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    except (ImportError, SystemError) as error:
        if not _state.asked:
            raise
        raise Stopped(_state.asked) from error  # which a module in C that was being imported made into another error
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        _state.asked, _state.until = 0, 0.0
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


@contextmanager
def steps() -> Iterator[None]:
    """Have a signal wait for the next `check`, so that a step is taken whole, unless it takes too long."""
    _state.stepping = True
    try:
        yield
    finally:
        _state.stepping = False


@contextmanager
def closing(seconds: float) -> Iterator[None]:
    """Let steps pass `check` once more after a signal, for as long as closing what is open may take [s]."""
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    _state.stepping, _state.until = False, time.monotonic() + seconds
    try:
        yield
    finally:
        _state.until = 0.0


def check() -> None:
    """Raise `Stopped` if a signal came."""
    if _state.asked and time.monotonic() >= _state.until:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        _state.stepping = False
        raise Stopped(_state.asked)


def _on_signal(number: int, frame: FrameType | None) -> None:
    if _state.asked:
        os._exit(128 + number)
    _state.asked = number
    if _state.stepping:
        signal.setitimer(signal.ITIMER_REAL, TUNING.patience)
    elif _swallows(frame):
        signal.setitimer(signal.ITIMER_REAL, TUNING.again)
    else:
        raise Stopped(number)


def _swallows(frame: FrameType | None) -> bool:
    """Return whether what is raised now is swallowed.

    By a log, as Drake's, by pydrake while it is imported, or by ctypes, where LLVM calls back while it compiles loops.
    """
    if getattr(getattr(sys.modules.get("pydrake"), "__spec__", None), "_initializing", False):
        return True
    while frame is not None:
        code, frame = frame.f_code, frame.f_back
        if code.co_filename == logging.__file__ or code.co_name in _CALLED_BACK:
            return True
    return False


_CALLED_BACK: Final = ("_raw_object_cache_notify", "_raw_object_cache_getbuffer")
"""What llvmlite has LLVM call: what they raise is printed and forgotten."""


def _on_alarm(number: int, frame: FrameType | None) -> None:
    if not _state.stepping and _swallows(frame):
        signal.setitimer(signal.ITIMER_REAL, TUNING.again)
    elif _state.stepping or _state.asked:
        _state.stepping = False
        raise Stopped(_state.asked)
