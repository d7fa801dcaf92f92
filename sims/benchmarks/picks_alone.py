"""Empties drawn bins pick by pick, without showing or weighing anything, and scores each try in the true world.

    python sims/benchmarks/picks_alone.py --seeds 720 721 --objects 5
    python sims/benchmarks/picks_alone.py --seeds 1 2 3 --across

What is lifted is brought before the camera, and then is gone. A bin takes two to five minutes of a core. Bins, sensors
and joints are drawn as `real2sim_tables.py` draws them. For each try: which true thing was brought, or what went wrong,
and which other things were shoved, by how much [m]; then contacts that no step asked for, and what was left. Writes
`OUT/SEED/events.jsonl` and `OUT/picks.jsonl`. Held back: from 100000.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from pathlib import Path

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

from real2sim_truth.drawn_world import fall_short  # noqa: E402
from real2sim_truth.laid_across import lay_across  # noqa: E402
from real2sim_truth.picks import pick_bin  # noqa: E402

from twin_diagram import load_scenario  # noqa: E402
from twin_diagram.model import Model  # noqa: E402
from twin_diagram.runs.learning.drawn_bins import draw_bin  # noqa: E402
from twin_diagram.runtime.stopping import Stopped, stoppable  # noqa: E402


def main() -> int:
    """Parse the command line and run."""
    try:
        with stoppable():
            return picks()
    except Stopped as stop:
        return stop.status


def picks() -> int:
    """Empty each bin, and tell what became of it."""
    logging.getLogger("drake").setLevel(logging.ERROR)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[720], help="of the bins (default: 720)")
    parser.add_argument("--objects", type=int, default=5, help="in each (default: %(default)s)")
    parser.add_argument("--across", action="store_true", help="a cracker box flat across one other thing instead")
    parser.add_argument("--noise", type=float, default=0.05, help="of measured torques [N·m] (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/picks"), help="new folder (default: %(default)s)")
    arguments = parser.parse_args()
    base = load_scenario("bin_picking")
    joints = Model.load(base.twin.arm, dict(base.packages)).joints
    for seed in arguments.seeds:
        scenario = lay_across(base, seed) if arguments.across else draw_bin(base, seed, arguments.objects)
        scenario.world.arm_defects.torque_noise = arguments.noise
        told = pick_bin(
            fall_short(scenario, joints), arguments.out / f"{seed:06d}", lambda text: print(text, file=sys.stderr)
        )
        with (arguments.out / "picks.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps({"seed": seed, **told}) + "\n")
        for row in told["rows"]:
            why = f": {row['told']}" if row["told"] else ""
            shoved = "".join(f"; shoved {name} by {1000 * far:.0f} mm" for name, far in row["shoved"].items())
            print(f"{seed}: {row['thing'] or 'nothing'} after {row['failed']} tries that failed{why}{shoved}")
        left = " ".join(told["left"]) or "nothing"
        print(f"{seed}: {told['failed']} tries failed, left {left}, {told['contacts']} contacts, {told['sim_s']} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
