"""Sets the twin's pick and place beside the same done blindly: by the first image, at four speeds.

    python sims/benchmarks/open_loop_picks.py --first 40 --seeds 10

Worlds are those of `sims/pick_and_place.py`, and success and collisions are counted as there. Grasps, ways and limits
of the blind arm are the twin's own; it looks once, before it begins, stops where a way ends, knows of no payload and
never plans anew. Held back: from 700000.
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path
from typing import Any

SIMS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(SIMS / "benchmarks"), str(SIMS)]

import numpy as np  # noqa: E402
from braking_bench.counting import wilson  # noqa: E402
from pick_and_place import row  # noqa: E402
from picking_blind.playing import look, play  # noqa: E402
from picking_blind.script import write_script  # noqa: E402

from twin_diagram import TwinError, load_scenario, run_scenario  # noqa: E402
from twin_diagram.runs.drawn_picks import draw_picks  # noqa: E402
from twin_diagram.twin.closed_loop import make_closed_loop  # noqa: E402

OURS = "twin"
SUCCEEDS = 0.82
"""Share of successes from which on a speed can be used: what the open loop of Hybrid Reality Twins 5.5 has."""


def took(summary: Any) -> float:
    """Return from when to when a task went on [s]."""
    events = summary["task"]["events"]
    return float(events[-1]["time"] - events[0]["time"])


def told(results: dict[str, list[tuple[bool, float, int]]]) -> str:
    """Return the figures of all seeds, on lines.

    Args:
        results: by who did it: success, time [s] and collisions of each seed.
    """
    lines, fastest = [], np.inf
    for name, rows in results.items():
        good, times = [good for good, _, _ in rows], [time for good, time, _ in rows if good]
        low, high = wilson(sum(good), len(rows))
        mean = float(np.mean(times)) if times else np.nan
        touched = 100 * sum(count for _, _, count in rows) / len(rows)
        share = f"{sum(good)} of {len(rows)} ({100 * low:.0f} to {100 * high:.0f} %)"
        lines.append(f"{name:>6s}  {share:24s} mean {mean:5.2f} s, {touched:.0f} collisions in 100 runs")
        if name != OURS and sum(good) >= SUCCEEDS * len(rows):
            fastest = min(fastest, mean)
    ours = float(np.mean([time for good, time, _ in results[OURS] if good] or [np.nan]))
    if np.isfinite(fastest):
        less = 100 * (1 - ours / fastest)
        lines.append(f"the twin takes {less:.0f} % less time than the fastest that succeeds (aim 40 %)")
    else:
        lines.append(f"no blind arm succeeds in {100 * SUCCEEDS:.0f} %")
    return "\n".join(lines)


def main() -> int:
    """Parse the command line and run."""
    logging.getLogger("drake").setLevel(logging.WARNING)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="pick_and_place", help="file or name (default: %(default)s)")
    parser.add_argument("--first", type=int, default=40, help="the first seed (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=10, help="how many (default: %(default)s)")
    parser.add_argument("--speeds", type=int, nargs="+", default=[25, 50, 75, 100], metavar="PERCENT")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE", help="override a field")
    arguments = parser.parse_args()
    names = {f"{speed} %": speed / 100 for speed in arguments.speeds}
    results: dict[str, list[tuple[bool, float, int]]] = {name: [] for name in (*names, OURS)}

    def note(name: str, seed: int, summary: Any) -> None:
        good, line = row(seed, summary)
        print(f"{name:>6s} {line}", flush=True)
        results[name].append((good, took(summary), sum(summary["task"]["collisions"].values())))

    try:
        base = load_scenario(arguments.scenario, arguments.set)
        print("   arm  seed  object       success  time s   off mm  off °  point  surface  outcome", flush=True)
        for seed in range(arguments.first, arguments.first + arguments.seeds):
            plan = draw_picks(base, seed)
            loop = make_closed_loop(plan)
            script = write_script(loop, look(loop))
            for name, share in names.items():
                if script.why:
                    print(f"{name:>6s} {seed:5d}  {script.why}", flush=True)
                    results[name].append((False, np.nan, 0))
                else:
                    note(name, seed, play(loop, script.stretched(share)))
            note(OURS, seed, run_scenario(plan, pictures=False, quiet=True, say=lambda text: None))
        print(told(results))
        return 0
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
