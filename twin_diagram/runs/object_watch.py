"""Watches objects and steps come and go while a run goes on: keeps the twin's scene, and tells of each event once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from twin_diagram.planning.tasks.step_state import FOR_WANT_OF_A_WAY
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, OWNER_SIZE, things_of
from twin_diagram.twin.twin import TwinDiagram


class ObjectWatch:
    """Looks at a twin's objects and things between steps."""

    def __init__(
        self,
        twin: TwinDiagram,
        note: Callable[[Mapping[str, Any]], None],
        no_way: Callable[[float], str | None] = lambda time: None,
    ) -> None:
        """`note` takes the events; `no_way` says why no way led to the goal at a time [s], where none did."""
        self._twin, self._note, self._no_way = twin, note, no_way
        self._newest = -1.0
        self._ring = np.zeros(0)
        self._newest_step = -1.0
        self._steps: list[dict[str, Any]] = []

    def poll(self, context: Context) -> None:
        """Keep the scene, and tell of what has happened since the last look; `context` is the whole Diagram's."""
        own = self._twin.diagram.GetMyMutableContextFromRoot(context)
        self._twin.keep_scene(own)
        ring = np.array(self._twin.diagram.GetOutputPort("object_events").Eval(own))
        if not np.array_equal(ring, self._ring):  # to find words takes a millisecond
            self._ring = ring
            # Those of one tick come together, so none is added to a time that was told of.
            for event in [event for event in self._twin.events(own) if event["time"] > self._newest]:
                self._note(event)
                self._newest = event["time"]
        steps = self._twin.step_events(own)
        fresh = [self._explained(event) for event in steps if event["time"] > self._newest_step]
        for event in fresh:
            self._note(event)
            self._newest_step = event["time"]
        self._steps += fresh

    def _explained(self, event: dict[str, Any]) -> dict[str, Any]:
        """Return what is told of a step, with what was in its way where it ended for want of one."""
        words = event.get("why")
        more = self._no_way(event["time"]) if words in FOR_WANT_OF_A_WAY else None
        return event | {"why": f"{words}: {more}"} if more else event

    def task_told(self, context: Context) -> dict[str, Any]:
        """Return how the task stands and what happened to its steps; empty where it has none."""
        runner = self._twin.runner
        if runner is None:
            return {}
        own = self._twin.diagram.GetMyContextFromRoot(context)
        standing = runner.standing(self._twin.diagram.GetSubsystemContext(runner, own))
        events = [{key: value for key, value in event.items() if key != "event"} for event in self._steps]
        if "why" in standing and events and events[-1]["what"] == "failed":
            standing["why"] = events[-1]["why"]
        return {"task": standing | {"events": events}}

    def told(self, context: Context) -> dict[str, Any]:
        """Return what there is beside the first of each object, for ``summary.json``; `context` is the whole Diagram's.

        Further instances by their names, with place [m] and status; unknown things the same, with how many pieces.
        """
        twin = self._twin.diagram
        own = twin.GetMyContextFromRoot(context)
        names = self._twin.names(own)
        further = np.asarray(twin.GetOutputPort("further_tracks").Eval(own)).reshape(-1, FURTHER_TRACK_SIZE)
        result: dict[str, Any] = {
            names.of(len(names.library), int(row[0]), int(row[1])): {
                "status": ObjectStatus(int(row[OWNER_SIZE])).name.lower(),
                "place": row[OWNER_SIZE + 6 : OWNER_SIZE + 9].round(4).tolist(),
            }
            for row in further
            if row[0] > 0
        }
        if not twin.HasOutputPort("things"):
            return result
        for thing in things_of(np.asarray(twin.GetOutputPort("things").Eval(own))):
            if thing.stands:
                result[names.of(len(names.library), thing.identity, -1)] = {
                    "status": thing.status.name.lower(),
                    "place": thing.middle.round(4).tolist(),
                    "pieces": len(thing.pieces),
                }
        return result
