"""Lets unknown things grow into assets while a run goes on, where the scenario asks for it, and tells of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pydrake.systems.framework import Context

from twin_diagram.runs.run_folder import RunFolder
from twin_diagram.runtime import written_files
from twin_diagram.scenario import Scenario
from twin_diagram.twin.given_files import named
from twin_diagram.twin.growing import Grower
from twin_diagram.twin.twin import TwinDiagram


class GrowthWatch:
    """Polls a grower between steps; without one it does nothing. Use as a context manager."""

    def __init__(self, scenario: Scenario, twin: TwinDiagram, out: RunFolder, say: Callable[[str], None]) -> None:
        """Begin to watch.

        Args:
            scenario: whose `twin.growth` counts.
            twin: in the Diagram that runs.
            out: gets ``events.jsonl``, and ``grown/`` where no other library is named.
            say: takes what happens.

        Raises:
            ScenarioError: the twin cannot take assets in, or their folder cannot be written to.
        """
        self._out, self._say = out, say
        self._grower: Grower | None = None
        self._before: frozenset[str] = frozenset()
        growth = scenario.twin.growth
        if growth is None:
            return
        folder = None if out.path is None else out.path / "grown"
        waits = scenario.station != "lcm"
        self._grower = named("twin.growth", lambda: Grower(twin, growth, self._journal, folder, waits=waits))
        self._below = folder is not None and not growth.library

    def poll(self, context: Context) -> None:
        """Do what is due; `context` is the whole Diagram's, and may be changed."""
        if self._grower is not None:
            self._grower.poll(context)

    def told(self) -> dict[str, Any]:
        """Return what grew, for ``summary.json``; nothing where nothing was to."""
        return {} if self._grower is None else self._grower.told()

    def __enter__(self) -> GrowthWatch:
        self._before = frozenset(self._files())
        return self

    def __exit__(self, *error: object) -> None:
        if self._grower is not None:
            self._grower.close()
            self._note()

    def _journal(self, event: dict[str, Any]) -> None:
        self._say(f"{event['time']:.2f} s: {sentence(event)}")
        self._out.event(event)
        if event["event"] == "grown":
            self._note()

    def _note(self) -> None:
        """Tell the run's folder of what was written below it, and of nothing that somebody else put there."""
        self._out.note(*sorted(set(self._files()) - self._before))

    def _files(self) -> list[str]:
        """Return the files of the library, by their paths in the run's folder, where it lies in there."""
        if self._grower is None or not self._below:
            return []
        library = self._grower.library
        return [f"{library.name}/{name}" for name in written_files.files_of(library)]


def sentence(event: dict[str, Any]) -> str:
    """Return an event as `Grower` tells it, for people: one line."""
    kind, what = event["event"], event["object"]
    if kind == "growth_started":
        return f"{what} was seen from {100 * event['seen']:.0f} % of all sides: it becomes {event['asset']}"
    if kind == "grown":
        return f"{what} is {event['asset']} from now on: {event['folder']}"
    return f"{what}: {kind.replace('_', ' ')}: {event.get('why', '')}"
