"""How far a run is: a bar on a terminal, a line from time to time elsewhere."""

from __future__ import annotations

import io
import sys

import numpy as np
import pytest

from twin_diagram.runtime.progress import Progress


def test_elsewhere_than_on_a_terminal_a_line_comes_every_two_seconds(capsys: pytest.CaptureFixture[str]) -> None:
    progress = Progress(5.0)
    # Products and sums of steps fall short of a whole second by rounding.
    for time in (0.02, 1.98, np.nextafter(2.0, 0.0), 2.4, 3.98, 4.5, 5.0):
        progress(float(time))
    progress.done()
    assert capsys.readouterr().err.splitlines() == ["2.0 of 5.0 s simulated", "4.5 of 5.0 s simulated"]
    Progress(5.0, quiet=True)(4.0)
    assert capsys.readouterr().err == ""


def test_on_a_terminal_a_bar_is_drawn_over(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = io.StringIO()
    monkeypatch.setattr(terminal, "isatty", lambda: True)
    monkeypatch.setattr(sys, "stderr", terminal)
    progress = Progress(4.0)
    for time in (1.0, 1.01, 2.0):
        progress(time)
    progress.done()
    first, second, *end = terminal.getvalue().split("\r")[1:]
    assert first == "█" * 7 + "░" * 23 + "   1.0 / 4.0 s" and second == "█" * 15 + "░" * 15 + "   2.0 / 4.0 s\n"
    assert not end
