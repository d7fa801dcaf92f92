"""The closed loop, once on the default scenario or over many seeds.

Once: runs the scenario, prints its table and writes ``summary.json``, ``replay.html``, ``diagram.svg`` and plots.
Over many seeds: object poses, textures, payload, friction and the moving object's path are drawn afresh for each.

    python sims/closed_loop.py --out out/demo
    python sims/closed_loop.py --seeds 20 --out out/seeds
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from twin_diagram import atomic_file
from twin_diagram.errors import TwinError
from twin_diagram.runs.run import run_scenario
from twin_diagram.runs.score import within
from twin_diagram.runtime.native import require_egl
from twin_diagram.scenario.file import dump_scenario, load_scenario


def main() -> int:
    """Parses the command line and runs."""
    logging.getLogger("drake").setLevel(logging.WARNING)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="tabletop", help="file or name (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/closed_loop"), help="folder (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=0, help="number of seeds; 0: the scenario as it stands")
    parser.add_argument("--first", type=int, default=1, help="the first seed (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=2, help="runs at a time (default: %(default)s)")
    parser.add_argument("--duration", type=float, help="[s]")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE", help="override a field")
    arguments = parser.parse_args()
    overrides = [*arguments.set, *([f"duration={arguments.duration}"] if arguments.duration else [])]
    try:
        require_egl()
        if arguments.seeds == 0:
            run_scenario(load_scenario(arguments.scenario, overrides), out=arguments.out, say=print)
            return 0
        return _many(arguments, overrides)
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def _many(arguments: argparse.Namespace, overrides: list[str]) -> int:
    load_scenario(arguments.scenario, overrides)  # what is wrong with it is said before anything starts
    arguments.out.mkdir(parents=True, exist_ok=True)
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    jobs = [(arguments.scenario, overrides, seed, str(arguments.out / f"seed_{seed:04d}")) for seed in seeds]
    print(f"{'seed':>5} {'worst position':>22} {'worst rotation':>22} {'clear':>6} {'goal':>7} {'payload':>16}  kept")
    results: list[dict[str, bool]] = []
    # A process per run: Drake never frees a Diagram that holds Python systems.
    with get_context("spawn").Pool(arguments.jobs, maxtasksperchild=1) as pool:
        for summary in pool.imap(_one, jobs):
            results.append(_row(summary))
    print()
    for name, meaning in (
        ("tracked", "every visible object within 5 mm and 5° (median; about a symmetric axis excepted)"),
        ("untouched", "no contact"),
        ("reached", "goal reached"),
        ("weighed", "payload mass within 15 %"),
    ):
        print(f"{sum(r[name] for r in results):>4} of {len(results)}  {meaning}")
    return 0


def _one(job: tuple[str, list[str], int, str]) -> dict[str, Any]:
    """One seed, in a process of its own; a run that was finished before is read back."""
    from twin_diagram.runs.randomization import vary

    name, overrides, seed, folder = job
    done = Path(folder) / "summary.json"
    if done.is_file():
        return dict(json.loads(done.read_text()))
    base = load_scenario(name, overrides)
    scenario = vary(base, seed, Path(folder) / "assets")
    atomic_file.write(Path(folder) / "scenario.yaml", dump_scenario(scenario))
    return run_scenario(scenario, out=Path(folder), pictures=False, quiet=True, say=lambda text: None)


def _row(summary: dict[str, Any]) -> dict[str, bool]:
    kept = within(summary)

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
    print(
        f"{summary['seed']:>5} {worst('position_error_mm') + ' mm':>22} {worst('rotation_error_deg') + ' °':>22} "
        f"{summary['clearance_min_mm'] or 0:>6.0f} {goal['error_mm'] or 0:>7.1f} "
        f"{weighed:>16}  " + (", ".join(name for name, good in kept.items() if not good) or "all"),
        flush=True,
    )
    return kept


if __name__ == "__main__":
    sys.exit(main())
