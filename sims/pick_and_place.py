"""A Panda picks a can or a box of hidden mass from among other objects and places it more than 60 cm away.

Everything is drawn from the seed; the arm has images alone, and contact is simulated: nothing joins object and hand.

    python sims/pick_and_place.py --first 0 --seeds 10
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path
from typing import Any

from twin_diagram import TwinError, load_scenario, run_scenario
from twin_diagram.runs.drawn_picks import draw_picks


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


def main() -> int:
    """Parse the command line and run."""
    logging.getLogger("drake").setLevel(logging.WARNING)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="pick_and_place", help="file or name (default: %(default)s)")
    parser.add_argument("--first", type=int, default=0, help="the first seed (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=1, help="how many; of one alone the replay is written")
    parser.add_argument("--out", type=Path, default=Path("out/pick_and_place"), help="folder (default: %(default)s)")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE", help="override a field")
    arguments = parser.parse_args()
    try:
        base = load_scenario(arguments.scenario, arguments.set)
        print(" seed  object       success  time s   off mm  off °  point  surface  outcome", flush=True)
        wins = 0
        for seed in range(arguments.first, arguments.first + arguments.seeds):
            one, out = arguments.seeds == 1, arguments.out / f"{seed:04d}"
            plan = draw_picks(base, seed)
            good, line = row(seed, run_scenario(plan, out=out, pictures=one, quiet=True, say=lambda text: None))
            print(line, flush=True)
            wins += good
        print(f"{wins} of {arguments.seeds} succeeded")
        return 0
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
