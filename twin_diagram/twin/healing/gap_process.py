"""The gap workflow in a process of its own: started, asked after, stopped; never left behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from twin_diagram.logs import Log, write_log
from twin_diagram.model.description import corrected_folder
from twin_diagram.model.model import Model
from twin_diagram.runtime import atomic_file
from twin_diagram.runtime.threads import one_thread_variables

REQUEST: Final = "request.json"
"""In the folder: what is asked, by the arguments of `run_gap`, and `nice`."""
TOLD: Final = "worker.txt"
"""In the folder: what the process said."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    bad_input: int = 2
    """Exit status where logs or model cannot be used, as of the command line."""

    grace: float = 0.5
    """After it was asked to end, a process has this long before it is ended [s]; a stopped run closes within 2 s."""


TUNING = Tuning()

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


class GapProcess:
    """One search for a gap.

    Use as a context manager, or `stop` it: both end the process, whatever it does. Where its starter is killed, it ends
    by itself.
    """

    def __init__(
        self,
        model: Model,
        fit: Log,
        holdout: Log,
        folder: Path,
        packages: Mapping[str, str | Path] | None = None,
        nice: int = 0,
    ) -> None:
        """Write model and logs to the folder and starts the process.

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
        }
        atomic_file.write(folder / REQUEST, json.dumps(request, indent=2))
        self._begin, self._outcome = time.perf_counter(), None
        with (folder / TOLD).open("wb") as told:
            # Not multiprocessing, which would run the user's own script once more.
            self._process = subprocess.Popen(
                [*WORKER, str(folder)],
                stdin=subprocess.PIPE,
                stdout=told,
                stderr=subprocess.STDOUT,
                env=_environment(),
                start_new_session=True,  # Ctrl-C on a terminal is for the run, which ends the search
            )

    _outcome: SearchOutcome | None

    def poll(self) -> SearchOutcome | None:
        """Return what became of it; None while it runs."""
        if self._outcome is None and self._process.poll() is not None:
            self._outcome = self._read()
        return self._outcome

    def wait(self, seconds: float) -> SearchOutcome | None:
        """Return what `poll` does, after waiting for it so long at most."""
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            pass
        return self.poll()

    @property
    def age(self) -> float:
        """How long ago it was started [s]."""
        return time.perf_counter() - self._begin

    def stop(self) -> None:
        """End the process, if it has not ended."""
        process = self._process
        assert process.stdin is not None
        try:
            process.stdin.close()
        except OSError:
            pass
        try:
            process.wait(TUNING.grace)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def __enter__(self) -> GapProcess:
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    def _read(self) -> SearchOutcome:
        seconds, answer = self.age, self.folder / "gap.json"
        self.stop()
        if self._process.returncode != 0 or not answer.is_file():
            told = (self.folder / TOLD).read_text(encoding="utf-8", errors="replace")
            return SearchOutcome("failed", why=why_it_failed(self._process.returncode, told), seconds=seconds)
        contents = json.loads(answer.read_text(encoding="utf-8"))
        named = contents["verdict"] == "named"
        return SearchOutcome(contents["verdict"], contents, self.folder / "model" if named else None, seconds=seconds)


def why_it_failed(status: int, told: str) -> str:
    """Return what went wrong, in one line.

    Args:
        status: that the process ended with; negative: the signal that ended it.
        told: all that it said.
    """
    # Of a traceback, the indented lines say where, the last of the others says what.
    lines = [line for line in told.splitlines() if line.strip() and not line[0].isspace()]
    last = lines[-1].strip() if lines else ""
    if status == TUNING.bad_input and last:
        return last
    if status < 0:
        return f"the search was ended by a signal: {signal.strsignal(-status) or -status}"
    return f"the search ended with status {status}: {last or 'it said nothing'}"


def _environment() -> dict[str, str]:
    """This one's, with this package on the path, and one thread unless the user said otherwise."""
    here = str(Path(__file__).resolve().parents[3])
    path = os.pathsep.join([here, *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**os.environ, "PYTHONPATH": path, **one_thread_variables(os.environ)}
