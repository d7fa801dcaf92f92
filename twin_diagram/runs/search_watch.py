"""Tells while a run goes on when the search for ways failed and the arm rested for it, and when it went on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from pydrake.systems.framework import Context

from twin_diagram.twin.twin import TwinDiagram

REASON: Final = "search_failed"
"""The word of ``summary.json`` and ``events.jsonl``."""


class SearchWatch:
    """Looks between steps whether a twin's planner rests because nothing searches for ways."""

    def __init__(self, twin: TwinDiagram, note: Callable[[Mapping[str, Any]], None]) -> None:
        """`note` takes the events."""
        self._twin, self._note = twin, note
        self._since: float | None = None
        self._lacks: list[dict[str, Any]] = []

    def poll(self, context: Context) -> None:
        """Tell what has changed since the last look; `context` is the whole Diagram's."""
        mpc = self._twin.mpc
        if mpc is None:
            return
        own = self._twin.diagram.GetMyContextFromRoot(context)
        braked, now = mpc.braked(self._twin.diagram.GetSubsystemContext(mpc, own)), round(context.get_time(), 4)
        if braked and self._since is None:
            self._since, why = now, mpc.planner.searcher.last_failure
            self._note({"time": now, "event": REASON, "why": why})
            self._lacks.append({"reason": REASON, "what": why, "first": now, "last": now})
        elif not braked and self._since is not None:
            self._note({"time": now, "event": "search_resumed", "after_s": round(now - self._since, 4)})
            self._since = None
        if braked:
            self._lacks[-1]["last"] = now

    def told(self) -> list[dict[str, Any]]:
        """Return each failure as ``health`` of ``summary.json`` has it; empty where there was none."""
        return list(self._lacks)
