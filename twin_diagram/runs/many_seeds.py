"""A scenario over many seeds: a process for each run, a line for each seed, and how many kept each bound."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event
from typing import Any, Final

from twin_diagram.errors import TwinError
from twin_diagram.model.effects.serialisation import users_effects
from twin_diagram.runs.randomization import vary
from twin_diagram.runs.run import run_scenario
from twin_diagram.runs.score import within
from twin_diagram.runtime import atomic_file
from twin_diagram.runtime.child_process import BAD_INPUT, ChildProcess
from twin_diagram.runtime.threads import one_thread
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.file import dump_scenario, load_scenario, save_scenario

Task = tuple[str, list[str], int, str]
"""Scenario, overrides, seed and folder, as they cross to another process."""

WORKER: Final = (sys.executable, "-m", "twin_diagram.runs.seed_worker")
"""The command that runs one seed in a process of its own."""

ASKED: Final = "asked.yaml"
"""In a seed's folder: the scenario that its run was drawn from."""

BOUNDS = {
    "tracked": "every visible object within 5 mm and 5° (median; about a symmetric axis excepted)",
    "untouched": "no contact",
    "reached": "goal reached",
    "weighed": "payload mass within 15 %",
}
"""What `score.within` holds a run against, in words."""


def _print(text: str) -> None:
    print(text, flush=True)  # each line as soon as its run has ended, into pipes, too


def run_seeds(
    scenario: str, seeds: Sequence[int], out: Path, *, overrides: Sequence[str] = (), jobs: int = 2
) -> Iterator[dict[str, Any]]:
    """Run a scenario once per seed, with poses, textures, payload, friction and path drawn afresh.

    A run of the same scenario whose ``summary.json`` is there already is read back, so that an interrupted call can be
    repeated; one of another is made anew. What lies in files that the scenario names is not looked at.

    Args:
        scenario: file or name.
        seeds: one run each, in this order.
        out: gets a folder ``seed_0001`` for each.
        overrides: ``dotted.field=value`` each.
        jobs: runs at a time.

    Returns:
        The summaries, in order, each as soon as it is there.

    Raises:
        TwinError: the scenario does not fit, before `out` is made; or a run finds out that it does not, or its process
            was ended from outside, as where memory is short.
    """
    load_scenario(scenario, overrides)  # what is wrong with it is said before anything starts
    out.mkdir(parents=True, exist_ok=True)
    tasks = [(scenario, list(overrides), seed, str(out / f"seed_{seed:04d}")) for seed in seeds]
    return _summaries(tasks, jobs)


def tell_seeds(summaries: Iterable[dict[str, Any]], say: Callable[[str], None] = _print) -> None:
    """Say a line for each summary as it comes, then how many runs kept each bound."""
    say(f"{'seed':>5} {'worst position':>22} {'worst rotation':>22} {'clear':>6} {'goal':>7} {'payload':>16}  kept")
    results: list[dict[str, bool]] = []
    for summary in summaries:
        results.append(within(summary))
        say(seed_line(summary, results[-1]))
    say("")
    for name, meaning in BOUNDS.items():
        say(f"{sum(kept[name] for kept in results):>4} of {len(results)}  {meaning}")


def seed_line(summary: Mapping[str, Any], kept: Mapping[str, bool]) -> str:
    """Return the table's line about one run: worst objects, clearance, goal, payload, and the bounds not kept."""

    def worst(kind: str) -> str:
        medians = {
            name: entry[kind]["median"] for name, entry in summary["objects"].items() if entry["visible_share"] > 0
        }
        if not medians:
            return "–"
        name = max(medians, key=lambda key: float("inf") if medians[key] is None else medians[key])
        return f"{name} {'lost' if medians[name] is None else format(medians[name], '.2f')}"

    payload, goal = summary["payload"], summary["goal"]
    true, estimated = payload["mass_true"], payload["mass_estimated"]
    weighed = "–" if not true or estimated is None else f"{true:.3f} {100 * (estimated / true - 1):>+7.1f}%"
    return (
        f"{summary['seed']:>5} {worst('position_error_mm') + ' mm':>22} {worst('rotation_error_deg') + ' °':>22} "
        f"{summary['clearance_min_mm'] or 0:>6.0f} {goal['error_mm'] or 0:>7.1f} "
        f"{weighed:>16}  " + (", ".join(name for name, good in kept.items() if not good) or "all")
    ) + (f": {goal['why']}" if "why" in goal else "")


def _summaries(tasks: list[Task], jobs: int) -> Iterator[dict[str, Any]]:
    stopped = Event()
    with ThreadPoolExecutor(jobs) as pool:
        runs = [pool.submit(_beside, task, stopped) for task in tasks]
        try:
            for run in runs:
                yield run.result()
        finally:
            stopped.set()
            pool.shutdown(cancel_futures=True)


def _beside(task: Task, stopped: Event) -> dict[str, Any]:
    """Return the summary of a run in a process of its own, which is ended where all is stopped.

    A process per run, for Drake never frees a Diagram that holds Python systems.
    """
    with TemporaryDirectory() as place, SeedProcess(task, Path(place) / "told.txt") as process:
        while (summary := process.wait(0.2)) is None:
            if stopped.is_set():
                raise TwinError(f"seed {task[2]}: stopped")
        return summary


class SeedProcess(ChildProcess[dict[str, Any]]):
    """One run; the user's own script is not run once more, and need not say `if __name__ == "__main__"`."""

    def __init__(self, task: Task, told: Path) -> None:
        """Start it.

        Args:
            task: what to run.
            told: file that gets what it says.
        """
        self._task = task
        super().__init__([*WORKER, json.dumps({"task": task, "modules": users_effects()})], told)

    def _read(self, status: int) -> dict[str, Any]:
        if status != 0:
            why = self.why_it_failed("its process", status)
            raise TwinError(why if status == BAD_INPUT else f"seed {self._task[2]}: {why}")
        return dict(json.loads((Path(self._task[3]) / "summary.json").read_text(encoding="utf-8")))


def read_back(folder: Path, scenario: Scenario) -> dict[str, Any] | None:
    """Return the summary of a run of a scenario that was finished in a folder; None: there is none.

    Then the folder is made ready for one: what is asked is kept there, and what another scenario left is gone. Earlier
    versions did not keep what was asked; their runs are taken as they are.
    """
    done, kept, asked = folder / "summary.json", folder / ASKED, dump_scenario(scenario)
    if done.is_file() and (not kept.is_file() or kept.read_text(encoding="utf-8") == asked):
        summary = dict(json.loads(done.read_text(encoding="utf-8")))
        if not summary.get("stopped"):
            return summary
    done.unlink(missing_ok=True)  # it is of another scenario than what is kept from here on
    atomic_file.write(kept, asked)
    return None


@one_thread()
def run_one(task: Task) -> dict[str, Any]:
    """Run one seed; a run of the same scenario that was finished before is read back."""
    name, overrides, seed, folder = task
    base = load_scenario(name, overrides)
    if (summary := read_back(Path(folder), base)) is not None:
        return summary
    scenario = vary(base, seed, Path(folder) / "assets")
    save_scenario(scenario, Path(folder) / "scenario.yaml")
    return run_scenario(
        scenario, out=Path(folder), pictures=False, quiet=True, spare_cores=False, say=lambda text: None
    )
