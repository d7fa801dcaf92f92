"""The gap workflow in a process of its own: started, asked after, stopped; never left behind."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from twin_diagram.logs import Log, write_log
from twin_diagram.model.description import corrected_folder
from twin_diagram.model.effects.serialisation import users_effects
from twin_diagram.model.model import Model
from twin_diagram.runtime import atomic_file
from twin_diagram.runtime.child_process import ChildProcess

REQUEST: Final = "request.json"
"""In the folder: what is asked, by the arguments of `run_gap`, with `nice` and the `modules` of users' effects."""
TOLD: Final = "worker.txt"
"""In the folder: what the process said."""


WORKER: Final = (sys.executable, "-m", "twin_diagram.twin.healing.worker")
"""The command that searches in a process of its own."""


@dataclass(frozen=True)
class SearchOutcome:
    """What became of a search.

    Attributes:
        verdict: `named`, `none` or `unknown`, as in gap.json; `failed` where there is no gap.json.
        answer: the contents of gap.json; empty where there is none.
        model: folder of the corrected model; None where nothing was named.
        why: in one line what went wrong, where it failed.
        seconds: that the process ran.
    """

    verdict: str
    answer: dict[str, Any] = field(default_factory=dict)
    model: Path | None = None
    why: str = ""
    seconds: float = 0.0


class GapProcess(ChildProcess[SearchOutcome]):
    """One search for a gap."""

    def __init__(
        self,
        model: Model,
        fit: Log,
        holdout: Log,
        folder: Path,
        packages: Mapping[str, str | Path] | None = None,
        nice: int = 0,
    ) -> None:
        """Write model and logs to the folder and start the process.

        Args:
            model: the one in use.
            fit: a run in which to look.
            holdout: another one, as proof.
            folder: gets what `twin-diagram gap --out` writes, besides what it was given.
            packages: local folders for `package://` names.
            nice: how far the process stands back behind others, as in the command of that name.
        """
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        # Of a corrected model, what it is known to leave goes along: it is no news.
        model.save(folder / "given", corrected_folder.standing_of(Path(model.arm.spec.model).parent))
        write_log(fit, folder / "fit.npz")
        write_log(holdout, folder / "holdout.npz")
        request = {
            "model": str(folder / "given"),
            "fit": [str(folder / "fit.npz")],
            "holdout": str(folder / "holdout.npz"),
            "packages": {name: str(path) for name, path in (packages or {}).items()},
            "nice": nice,
            "modules": users_effects(),
        }
        atomic_file.write(folder / REQUEST, json.dumps(request, indent=2))
        super().__init__([*WORKER, str(folder)], folder / TOLD)

    def _read(self, status: int) -> SearchOutcome:
        seconds, answer = self.age, self.folder / "gap.json"
        if status != 0 or not answer.is_file():
            return SearchOutcome("failed", why=self.why_it_failed("the search", status), seconds=seconds)
        contents = json.loads(answer.read_text(encoding="utf-8"))
        named = contents["verdict"] == "named"
        return SearchOutcome(contents["verdict"], contents, self.folder / "model" if named else None, seconds=seconds)
