"""What a report is about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from twin_diagram.gap.experiments.trajectories import Experiment
from twin_diagram.gap.findings import Verdict
from twin_diagram.gap.report.comparison import Shown
from twin_diagram.gap.report.gap_json import of_files
from twin_diagram.model.model import Model


@dataclass(frozen=True)
class Subject:
    """What the report is about.

    Attributes:
        verdict: what was found.
        shown: the gap before and after.
        given: the given model.
        corrected: the corrected one; the same object where nothing was corrected.
        name: of the model, for people.
        experiments: with the names of their files, relative to the report.
        notes: warnings about the logs, and what else the reader should know.
        seconds: that it took.
        version: of this package.
    """

    verdict: Verdict
    shown: Shown
    given: Model
    corrected: Model
    name: str
    experiments: Sequence[tuple[Experiment, str]] = ()
    notes: Sequence[str] = ()
    seconds: float = 0.0
    version: str = ""
    title: str = "Gap report"

    @property
    def files(self) -> list[int]:
        """Of each fitted run, which of the given files it is of."""
        return of_files(self.shown)

    @property
    def changed(self) -> bool:
        """Whether there is a corrected model that differs."""
        return self.corrected is not self.given


def called(model: Path) -> str:
    """Return what a report calls a model: its description's name, also where it was corrected before."""
    if not model.is_dir():
        return model.name
    names = sorted(path.name for path in model.iterdir() if path.suffix in (".urdf", ".sdf", ".xml"))
    return f"{names[0]}, corrected before" if names else model.name
