"""The folder of ``run --out``: what a run writes there, and what of the run before goes first."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from twin_diagram.estimation.drift.alarm_events import append_lines
from twin_diagram.runtime import atomic_file, written_files

FILES: Final = "run_files.txt"
"""Tells what else was written; see `written_files`."""
EVENTS: Final = "events.jsonl"
"""Alarms and what they led to, one JSON object to a line."""
SUMMARY: Final = "summary.json"
"""The run's figures."""


class RunFolder:
    """Notes each file in a list before it is written; without a folder, nothing is written."""

    def __init__(self, path: Path | None) -> None:
        """`path`: may exist; it is not touched before `clear`."""
        self.path = path
        self._events_begun = False

    def clear(self) -> None:
        """Remove what the run before wrote."""
        if self.path is not None and self.path.is_dir():
            # Versions without lists began the events anew, and wrote all else over.
            written_files.remove(self.path, FILES, [EVENTS] if (self.path / SUMMARY).exists() else [])

    def note(self, *names: str) -> None:
        """Tell of files that are written by others, by their paths in the folder."""
        if self.path is not None:
            self.path.mkdir(parents=True, exist_ok=True)
            written_files.note(self.path, FILES, names)

    def note_all(self, folder: Path) -> None:
        """Tell of all files in a folder below, which this run has made."""
        if self.path is not None:
            below = folder.relative_to(self.path).as_posix()
            self.note(*(f"{below}/{name}" for name in written_files.files_of(folder)))

    def event(self, event: Mapping[str, Any]) -> None:
        """Append to the events."""
        if self.path is None:
            return
        if not self._events_begun:
            self.note(EVENTS)
            (self.path / EVENTS).unlink(missing_ok=True)
            self._events_begun = True
        append_lines(self.path / EVENTS, [dict(event)])

    def summary(self, summary: Mapping[str, Any]) -> None:
        """Write the figures."""
        if self.path is not None:
            self.note(SUMMARY)
            atomic_file.write(self.path / SUMMARY, json.dumps(summary, indent=2, ensure_ascii=False) + "\n")

    def stopped_early(self) -> None:
        """Write in a folder without a summary that the user ended the run before there was anything to sum up."""
        if self.path is not None and not (self.path / SUMMARY).exists():
            self.summary({"stopped": True})
