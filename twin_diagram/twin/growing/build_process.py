"""The reconstruction of a grown thing in a process of its own: started, asked after, stopped; never left behind."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from twin_diagram.assets.building.growth import Growth
from twin_diagram.assets.building.growth_file import write_growth
from twin_diagram.runtime import atomic_file
from twin_diagram.runtime.child_process import ChildProcess
from twin_diagram.twin.growing.worker import ANSWER, PICTURES, REQUEST

TOLD: Final = "worker.txt"
"""In the folder: what the process said."""


WORKER: Final = (sys.executable, "-m", "twin_diagram.twin.growing.worker")
"""The command that builds in a process of its own."""


@dataclass(frozen=True)
class BuildOutcome:
    """What became of a reconstruction.

    Attributes:
        answer: see `worker.ANSWER`; None where it failed.
        why: in one line what went wrong, where it failed.
        seconds: that the process ran.
    """

    answer: dict[str, Any] | None
    why: str = ""
    seconds: float = 0.0


class BuildProcess(ChildProcess[BuildOutcome]):
    """One reconstruction; an asset that is not whole when it is stopped is not in the library."""

    def __init__(self, growth: Growth, name: str, library: Path, folder: Path, nice: int = 0) -> None:
        """Write the pictures and start the process.

        Args:
            growth: that is ready.
            name: of the asset.
            library: folder that gets it.
            folder: gets pictures, request and answer.
            nice: how far the process stands back behind others, as in the command of that name.
        """
        self.name, self.folder = name, folder
        folder.mkdir(parents=True, exist_ok=True)
        write_growth(folder / PICTURES, growth)
        request = {"name": name, "library": str(library.resolve()), "nice": nice}
        atomic_file.write(folder / REQUEST, json.dumps(request, indent=2))
        super().__init__([*WORKER, str(folder)], folder / TOLD)

    def _read(self, status: int) -> BuildOutcome:
        seconds, answer = self.age, self.folder / ANSWER
        if status == 0 and answer.is_file():
            return BuildOutcome(json.loads(answer.read_text(encoding="utf-8")), seconds=seconds)
        return BuildOutcome(None, self.why_it_failed("the reconstruction", status), seconds)
