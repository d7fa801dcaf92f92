"""Tells while a run goes on when and why the arm was stopped, once each, and at its end how often and how long."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from pydrake.systems.framework import Context

from twin_diagram.twin.twin import TwinDiagram


class BrakeWatch:
    """Looks at a twin's stop monitor between steps."""

    def __init__(self, twin: TwinDiagram, note: Callable[[Mapping[str, Any]], None]) -> None:
        """`note` takes the events."""
        self._twin, self._note = twin, note
        self._newest = -1.0
        self._events: list[dict[str, Any]] = []

    def poll(self, context: Context) -> None:
        """Tell of what has happened since the last look; `context` is the whole Diagram's."""
        own = self._twin.diagram.GetMyContextFromRoot(context)
        for event in [event for event in self._twin.brakes(own) if event["time"] > self._newest]:
            self._note(event)
            self._events.append(event)
            self._newest = event["time"]

    def told(self, context: Context) -> dict[str, Any]:
        """Return count, seconds, whether it brakes now, and causes, for ``summary.json``; empty without a monitor."""
        monitor = self._twin.monitor
        if monitor is None:
            return {}
        own = self._twin.diagram.GetMyContextFromRoot(context)
        standing = monitor.standing(self._twin.diagram.GetSubsystemContext(monitor, own))
        causes = [event["cause"] for event in self._events if event["event"] == "brake"]
        return {"brakes": standing | {"causes": {cause: causes.count(cause) for cause in dict.fromkeys(causes)}}}
