"""What is told on stderr while a run goes on: lines, and how far it is."""

from __future__ import annotations

import sys

QUIET_PERIOD = 2.0
"""Where output is not a terminal, a line this often [s of simulated time]."""


def say_beside(text: str) -> None:
    """Print a line on stderr, at once: stdout is for what a command answers."""
    print(text, file=sys.stderr, flush=True)


class Progress:
    """A bar on a terminal that is redrawn; elsewhere a line from time to time. On stderr."""

    def __init__(self, duration: float, quiet: bool = False) -> None:
        """`duration`: of the run [s]; `quiet`: shows nothing."""
        self._duration, self._shown = duration, 0
        self._quiet = quiet
        self._terminal = sys.stderr.isatty() and not quiet
        self._period = 0.1 if self._terminal else QUIET_PERIOD

    def __call__(self, time: float) -> None:
        """Show that `time` [s] has been reached."""
        step = int(time / self._period + 1e-9)
        if step == self._shown or self._quiet:
            return
        self._shown = step
        if self._terminal:
            filled = int(30 * time / self._duration)
            bar = "█" * filled + "░" * (30 - filled)
            print(f"\r{bar} {time:5.1f} / {self._duration:.1f} s", end="", file=sys.stderr, flush=True)
        else:
            print(f"{time:.1f} of {self._duration:.1f} s simulated", file=sys.stderr, flush=True)

    def done(self) -> None:
        """End the bar's line."""
        if self._terminal:
            print(file=sys.stderr)
