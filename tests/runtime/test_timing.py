"""A callback's time is its own: what it spends in another timed one counts there."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from twin_diagram.runtime import timing


def test_time_counts_for_the_innermost_callback_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [5.0]
    monkeypatch.setattr(timing, "time", SimpleNamespace(perf_counter=lambda: now[0]))

    @timing.timed("test: inner")
    def inner(seconds: float) -> None:
        now[0] += seconds
        if seconds > 2.0:
            raise ValueError

    @timing.timed("test: outer")
    def outer() -> None:
        now[0] += 1.0
        inner(2.0)
        with pytest.raises(ValueError):
            inner(3.0)
        now[0] += 4.0

    before = timing.snapshot()
    outer()
    assert timing.since(before) == {"test: inner": 5.0, "test: outer": 5.0}
    before = timing.snapshot()
    inner(0.5)
    assert timing.since(before) == {"test: inner": 0.5}
