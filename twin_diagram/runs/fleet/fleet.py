"""Runs `gap` on a fleet, some robots at a time, and goes on where it stopped."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from twin_diagram.errors import TwinError
from twin_diagram.runs.fleet.page import page, table
from twin_diagram.runs.fleet.robots import Visit, read_fleet
from twin_diagram.runs.fleet.work import VisitResult, end_running, known, work
from twin_diagram.runtime import atomic_file
from twin_diagram.runtime.one_at_work import one_at_work
from twin_diagram.runtime.output_place import why_not

ROBOTS = "robots"
"""Folder of the visits' folders."""

LOCK = ".fleet_at_work"
"""File that keeps a second call out."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    patience: float = 0.05
    """Between two attempts at ending what runs [s]; a stopped command closes within 2 s."""

    longest: float = 1e6
    """A robot is never given more [s], be it asked for `inf`: what waits for a process knows no more than 24 days."""


TUNING = Tuning()


def run_fleet(
    path: Path,
    out: Path,
    jobs: int = 1,
    timeout: float = 3600.0,
    dask: str = "",
    options: tuple[str, ...] = (),
    say: Callable[[str], None] = lambda text: None,
) -> list[VisitResult]:
    """Run `gap` on each visit of a table; write `fleet.csv` and `fleet.html` after each of them.

    Args:
        path: the table, see `read_fleet`.
        out: folder; what an earlier call found there of the same inputs is taken over.
        jobs: robots at a time.
        timeout: after which one is given up [s].
        dask: address of a Dask scheduler whose workers see the same files; empty: this computer.
        options: further ones of each `gap`.
        say: told of each robot.

    Returns:
        One line per visit, in the table's order.

    Raises:
        TwinError: table or folder cannot be used, or another call is at work in the folder.
    """
    visits = read_fleet(path.resolve())
    if why := why_not(out, folder=True):
        raise TwinError(f"--out {out}: {why}")
    if jobs < 1:
        raise TwinError(f"--jobs {jobs}: at least one robot at a time")
    if not timeout > 0.0:
        raise TwinError(f"--timeout {timeout:g}: it is positive [s]")
    timeout, robots = min(timeout, TUNING.longest), out.resolve() / ROBOTS
    out.mkdir(parents=True, exist_ok=True)
    with one_at_work(out / LOCK) as alone:
        if not alone:
            raise TwinError(f"--out {out}: another fleet is at work in it; wait for its end, or give another --out")
        lines = {visit: line for visit in visits if (line := known(visit, robots, options))}
        _write(out, visits, lines)
        asked = [visit for visit in visits if visit not in lines]
        with _executor(jobs, dask) as executor:
            futures = {executor.submit(work, visit, robots, options, timeout): visit for visit in asked}
            try:
                for count, future in enumerate(as_completed(futures), 1):
                    visit = futures[future]
                    lines[visit] = _line(visit, future)
                    _write(out, visits, lines)
                    say(f"{count}/{len(asked)} {visit.robot} {visit.date}: {lines[visit].verdict}")
            finally:
                _end_all(futures)
    return [lines[visit] for visit in visits]


def _end_all(futures: Iterable[Future[VisitResult]]) -> None:
    """Start nothing more, and end what runs here: what a cluster's workers are at ends by its timeout."""
    going = [future for future in futures if not future.cancel() and not future.done()]
    while going:  # more than once, since one may be about to start its process
        end_running()
        going = list(wait(going, TUNING.patience).not_done)


def _line(visit: Visit, future: Future[VisitResult]) -> VisitResult:
    """Return what work found; what it could not even try is a line, too."""
    error = future.exception()
    if error is None:
        return VisitResult(**vars(future.result()))
    return VisitResult(visit.robot, visit.date, "failed", headline=f"{type(error).__name__}: {error}")


def _write(out: Path, visits: list[Visit], lines: dict[Visit, VisitResult]) -> None:
    there = [visit for visit in visits if visit in lines]
    told = [lines[visit] for visit in there]
    atomic_file.write(out / "fleet.csv", table(told))
    atomic_file.write(out / "fleet.html", page(told, [f"{ROBOTS}/{visit.folder}" for visit in there]))


@contextmanager
def _executor(jobs: int, dask: str) -> Iterator[Executor]:
    """Give threads, each of which waits for a process, or a Dask cluster's workers."""
    if not dask:
        with ThreadPoolExecutor(jobs) as executor:
            yield executor
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise TwinError('--dask: needs the package "distributed": pip install "twin-diagram[fleet]"') from error
    try:
        client = Client(dask, timeout=10)
    except (OSError, ValueError) as error:
        raise TwinError(f"--dask {dask}: no scheduler answers there: {error}") from error
    with client:
        yield client.get_executor(pure=False)
