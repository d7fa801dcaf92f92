"""Tells while a run goes on when no way leads to the goal, and why, and when one does again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from pydrake.systems.framework import Context

from twin_diagram.planning.paths.no_way import Hindrance, HindranceKind
from twin_diagram.twin.twin import TwinDiagram


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    lasting: float = 1.0
    """Without a way for so long is told [s]: what goes by takes less."""

    over: float = 0.5
    """A way that lasts for so long ends it [s]: at the edge of what is kept, images say now this, now that."""

    again: float = 1.0
    """Why is looked at anew so often [s]: it takes some ms."""

    just: float = 0.1
    """What was so until so long ago ended a step [s]: its goal is gone a tick of the planner later."""


TUNING = Tuning()

NO_WAY: Final = "no_way"
"""The word of ``events.jsonl`` and ``summary.json``."""


class GoalWatch:
    """Looks between steps whether a twin's planner knows a way to its goal."""

    def __init__(self, twin: TwinDiagram, note: Callable[[Mapping[str, Any]], None]) -> None:
        """`note` takes the events."""
        self._twin, self._note = twin, note
        self._since: float | None = None
        self._last = self._looked = 0.0
        self._why: Hindrance | None = None
        self._told = False

    def poll(self, context: Context) -> None:
        """Tell what has changed since the last look; `context` is the whole Diagram's."""
        mpc = self._twin.mpc
        if mpc is None:
            return
        twin = self._twin.diagram.GetMyContextFromRoot(context)
        own, now = self._twin.diagram.GetSubsystemContext(mpc, twin), context.get_time()
        memory = mpc.memory(own)
        if not memory.stuck:
            there = memory.route.to_goal and bool(np.any(memory.goal))
            if self._since is not None and (not there or now - self._last >= TUNING.over):
                self._end(there)
            return
        if self._since is None:
            self._since, self._why = now, None
        self._last = now
        lasts = now - self._since >= TUNING.lasting - 1e-9
        if lasts and (self._why is None or now - self._looked >= TUNING.again):
            self._why, self._looked = mpc.why_no_way(own, self._twin.names(twin).of) or self._why, now
        if self._why is not None and not self._told:
            self._told = True
            self._note({"time": round(now, 4), "event": NO_WAY, "since": round(self._since, 4)} | figures(self._why))

    def why(self, time: float) -> str | None:
        """Return why no way led to the goal at a time not long before the newest look [s]; None where one did."""
        stood = self._why is not None and time - self._last <= TUNING.just
        return self._why.sentence() if stood and self._why is not None else None

    def health(self) -> list[dict[str, Any]]:
        """Return what is lacking now, as ``health`` of ``summary.json`` has it; what is out of reach stands there."""
        if self._since is None or self._why is None or self._why.reason is HindranceKind.OUT_OF_REACH:
            return []
        first, last = round(self._since, 4), round(self._last, 4)
        return [{"reason": NO_WAY, "what": self._why.sentence(), "first": first, "last": last}]

    def _end(self, found: bool) -> None:
        assert self._since is not None
        if self._told:
            after = round(self._last - self._since, 4)
            self._note({"time": round(self._last, 4), "event": "no_way_over", "found": found, "after_s": after})
        self._since, self._told = None, False


def figures(why: Hindrance) -> dict[str, Any]:
    """Return why no way leads to a goal, for ``events.jsonl``."""
    result: dict[str, Any] = {"reason": why.reason.value, "why": why.sentence()}
    if why.name:
        result["object"] = why.name
    if why.body is not None:
        result |= {"distance_mm": round(1e3 * why.near, 2), "kept_mm": round(1e3 * why.kept, 2)}
    return result


def explained(summary: Mapping[str, Any], why: str | None) -> dict[str, Any]:
    """Return what ``summary.json`` has of a goal that was missed: with why, where that is known."""
    goal = summary.get("goal")
    if why is None or (goal is not None and (goal["reached"] or goal["error_mm"] is None)):
        return {}
    return {"goal": dict(goal or {}) | {"why": why}}
