"""A Panda picks a can or a box of hidden mass from among other objects and places it more than 60 cm away.

Everything is drawn from the seed; the arm has images alone, and contact is simulated: nothing joins object and hand.

    python sims/pick_and_place.py --first 0 --seeds 10
"""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from twin_diagram import TwinError, load_scenario, run_scenario
from twin_diagram.runs.drawn_picks import draw_picks
from twin_diagram.scenario import Scenario

Draw = Callable[[Scenario, int], tuple[Scenario, str]]
"""Makes a scenario for a seed, and says what else its line tells."""


def row(seed: int, summary: dict[str, Any]) -> tuple[bool, str]:
    """Return whether a run succeeded, and its figures on a line."""
    task = summary["task"]
    name, off = next(iter(task["placed"].items()))
    touched = task["collisions"]
    good = task["outcome"] == "done" and off["off_mm"] <= 10.0 and off["off_deg"] <= 5.0 and not any(touched.values())
    took = task["events"][-1]["time"] - task["events"][0]["time"]
    why = f" ({task['why']})" if "why" in task else ""
    told = f"{seed:5d}  {name:12s} {'yes' if good else 'no':7s} {took:6.2f} {off['off_mm']:8.1f} {off['off_deg']:6.1f}"
    return good, f"{told} {touched['point']:6d} {touched['surface']:8d}  {task['outcome']}{why}"


def drawn(base: Scenario, seed: int) -> tuple[Scenario, str]:
    """Return the scenario of a seed, and what else is said of it."""
    return draw_picks(base, seed), ""


def main(about: str | None = __doc__, name: str = "pick_and_place", draw: Draw = drawn) -> int:
    """Parse the command line and run what `draw` makes of each seed; `about` it, and the `name` of its folder."""
    logging.getLogger("drake").setLevel(logging.WARNING)
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="pick_and_place", help="file or name (default: %(default)s)")
    parser.add_argument("--first", type=int, default=0, help="the first seed (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=1, help="how many; of one alone the replay is written")
    parser.add_argument("--out", type=Path, default=Path("out") / name, help="folder (default: %(default)s)")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE", help="override a field")
    arguments = parser.parse_args()
    try:
        base = load_scenario(arguments.scenario, arguments.set)
        print(" seed  object       success  time s   off mm  off °  point  surface  outcome", flush=True)
        wins = 0
        for seed in range(arguments.first, arguments.first + arguments.seeds):
            one, out = arguments.seeds == 1, arguments.out / f"{seed:04d}"
            plan, more = draw(base, seed)
            good, line = row(seed, run_scenario(plan, out=out, pictures=one, quiet=True, say=lambda text: None))
            print(line + more, flush=True)
            wins += good
        print(f"{wins} of {arguments.seeds} succeeded")
        return 0
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
