"""A run from its scenario to its files: trial, score, outputs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.runs.filtering import filter_log
    from twin_diagram.runs.many_seeds import run_seeds, tell_seeds
    from twin_diagram.runs.run import beliefs, replay_log, replay_scenario, run_scenario

__all__ = [
    "beliefs",
    "filter_log",
    "replay_log",
    "replay_scenario",
    "run_scenario",
    "run_seeds",
    "tell_seeds",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
