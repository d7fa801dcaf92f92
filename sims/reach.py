"""A Panda reaches across a table on which two things go to and fro at up to 0.5 m/s; it sees them by its camera alone.

Goal, places and ways are drawn from the seed. Success: the tool is at the goal in the end, and nothing was touched. A
run of the same scenario that is there already is read back. Seeds below 100000 are for training.

    python sims/reach.py --first 0 --count 100
    python sims/reach.py --quick
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent / "benchmarks"))

from reaching.counting import row, told
from reaching.drawing import draw_reach

from twin_diagram import TwinError, load_scenario, run_scenario
from twin_diagram.runs.many_seeds import read_back


def run(base: Any, seed: int, out: Path) -> dict[str, Any]:
    """Return a run's summary; one of the same scenario that is there is read back."""
    drawn = draw_reach(base, seed)
    if (summary := read_back(out, drawn)) is not None:
        return summary
    return run_scenario(drawn, out=out, pictures=False, quiet=True, say=lambda text: None)


def main() -> int:
    """Parse the command line and run."""
    logging.getLogger("drake").setLevel(logging.WARNING)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="tabletop", help="file or name (default: %(default)s)")
    parser.add_argument("--first", type=int, default=0, help="the first seed (default: %(default)s)")
    parser.add_argument("--count", type=int, default=100, help="seeds (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="three seeds")
    parser.add_argument("--out", type=Path, default=Path("out/reach"), help="folder (default: %(default)s)")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE", help="override a field")
    arguments = parser.parse_args()
    try:
        base, summaries = load_scenario(arguments.scenario, arguments.set), []
        print("   seed  clear mm    off mm  outcome", flush=True)
        for seed in range(arguments.first, arguments.first + (3 if arguments.quick else arguments.count)):
            summaries.append(run(base, seed, arguments.out / f"{seed:06d}"))
            print(row(seed, summaries[-1]), flush=True)
        print(told(summaries))
        return 0
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
