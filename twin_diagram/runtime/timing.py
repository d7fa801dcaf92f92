"""Where the computing time goes: a stopwatch for the callbacks of systems.

Time is exclusive: what a callback spends in another timed callback (evaluating an input port runs the system upstream)
counts for the inner one alone. Diagnostics only; nothing in the twin reads it.
"""

from __future__ import annotations

import functools
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])

_seconds: defaultdict[str, float] = defaultdict(float)
_running: list[list[float]] = []


def timed(name: str) -> Callable[[Function], Function]:
    """Decorate a callback: its exclusive time is added to `name`."""

    def decorate(function: Function) -> Function:
        @functools.wraps(function)
        def wrapper(*args: Any, **kwargs: Any) -> Any:
            inner = [0.0]
            _running.append(inner)
            start = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                spent = time.perf_counter() - start
                _running.pop()
                _seconds[name] += spent - inner[0]
                if _running:
                    _running[-1][0] += spent

        return wrapper  # type: ignore[return-value]

    return decorate


def snapshot() -> dict[str, float]:
    """Return the seconds spent so far in this process, by name."""
    return dict(_seconds)


def since(before: dict[str, float]) -> dict[str, float]:
    """Return the seconds spent since a snapshot, by name; names that spent none are left out."""
    return {
        name: seconds - before.get(name, 0.0) for name, seconds in _seconds.items() if seconds > before.get(name, 0.0)
    }
