"""`gap` on one robot, in a process of its own: what hangs or fails there costs its own line and nothing more."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

from twin_diagram.runs.fleet.robots import Visit
from twin_diagram.runtime import atomic_file
from twin_diagram.runtime.child_process import environment, why_it_failed

LINE_FILE = "fleet_line.json"
"""In a visit's folder: what the fleet's table says of it, and what it was made of."""
COMMAND: Final = (sys.executable, "-m", "twin_diagram.runs.fleet.child", "gap")
"""`gap` in a process that ends with this one."""

_running: Final[set[subprocess.Popen[bytes]]] = set()
_running_lock: Final = threading.Lock()


@dataclass
class VisitResult:
    """What is said of one robot on one day.

    Attributes:
        robot, date: of the visit.
        verdict: of `gap`; `failed` or `timeout` where there is none.
        effects: names, with joints and links.
        headline: one line for people, or what went wrong.
        left: held-out residual torque after over before, mean over joints; None: not known.
        seconds: that it took.
        mark: of its inputs, options among them.
    """

    robot: str
    date: str
    verdict: str
    effects: list[str] = field(default_factory=list)
    headline: str = ""
    left: float | None = None
    seconds: float = 0.0
    mark: str = ""


def known(visit: Visit, out: Path, options: tuple[str, ...] = ()) -> VisitResult | None:
    """Return what an earlier call found of a visit; None where inputs have changed, or it did not come to an end.

    Args:
        visit: robot and day.
        out: folder of all visits' folders.
        options: further ones of the command.
    """
    try:
        line = VisitResult(**json.loads((out / visit.folder / LINE_FILE).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None
    return line if line.mark == visit.mark(options) and line.verdict not in ("failed", "timeout") else None


def work(visit: Visit, out: Path, options: tuple[str, ...], timeout: float) -> VisitResult:
    """Run `gap` on a visit and write its line.

    Args:
        visit: robot and day.
        out: folder of all visits' folders.
        options: further ones of the command.
        timeout: after which it is stopped [s].
    """
    folder = out / visit.folder
    folder.mkdir(parents=True, exist_ok=True)
    command = [*COMMAND, "--model", str(visit.model), "--out", str(folder), *visit.asked(options)]
    command += [part for log in visit.fit for part in ("--fit", str(log))] + ["--holdout", str(visit.holdout)]
    begin, mark = time.perf_counter(), visit.mark(options)
    try:
        status, said, complaint = _run(command, timeout)
    except subprocess.TimeoutExpired:
        line = VisitResult(visit.robot, visit.date, "timeout", headline=f"stopped after {timeout:g} s")
    else:
        if status == 0:
            line = _read(visit, folder, said)
        else:
            why = why_it_failed("gap", status, complaint)
            line = VisitResult(visit.robot, visit.date, "failed", headline=why)
    line.seconds, line.mark = round(time.perf_counter() - begin, 2), mark
    atomic_file.write(folder / LINE_FILE, json.dumps(asdict(line), ensure_ascii=False, indent=1) + "\n")
    return line


def end_running() -> None:
    """End the processes that `work` waits for in this one, and those that they have started."""
    with _running_lock:
        for process in _running:
            _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        with suppress(ProcessLookupError):  # another thread has just seen it end
            os.killpg(process.pid, signal.SIGKILL)


def _run(command: list[str], timeout: float) -> tuple[int, str, str]:
    """Return status, first line of output and last of complaints; all its processes end with it."""
    # A pipe of its own, since `communicate` would close that of the process, by whose end it knows that we are gone.
    theirs, ours = os.pipe()
    try:
        process = subprocess.Popen(
            command,
            stdin=theirs,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
            env=environment(),
        )
    except BaseException:
        os.close(ours)
        raise
    finally:
        os.close(theirs)
    with _running_lock:
        _running.add(process)
    try:
        out, error = process.communicate(timeout=timeout)
    finally:
        if process.poll() is None:
            _end(process)
            process.communicate()
        with _running_lock:
            _running.discard(process)
        os.close(ours)
    said, complaints = (x.decode("utf-8", "replace").strip().splitlines() for x in (out, error))
    return process.returncode, said[0] if said else "", complaints[-1] if complaints else "ended without a word"


def _read(visit: Visit, folder: Path, headline: str) -> VisitResult:
    answer: dict[str, Any] = json.loads((folder / "gap.json").read_text(encoding="utf-8"))
    effects = [" ".join([e["name"], *e["joints"], *e["links"]]) for e in answer["effects"]]
    held = answer["gap"]["torque_rms"]["holdout"]
    ratios = [held["after"][j] / before for j, before in held["before"].items() if before and held["after"].get(j)]
    verdict = answer["verdict"] + (" with remainder" if answer["remainder"] else "")
    left = round(sum(ratios) / len(ratios), 4) if ratios else None
    return VisitResult(visit.robot, visit.date, verdict, effects, headline, left)
