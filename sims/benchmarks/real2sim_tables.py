"""Scores learning by handling: bins drawn from seeds are emptied, and each asset is held against the true object.

    python sims/benchmarks/real2sim_tables.py --first 0 --count 1 --quick
    python sims/benchmarks/real2sim_tables.py --first 0 --count 20 --objects 5 --noise 0.2

The world is as the score sets it: white torque noise (`--noise`), and, drawn per seed and told to nobody, gains, biases
and frictions of each joint and where cameras really stand; `--plain` leaves all but the noise out. A bin that was begun
is gone on with, one that is done is only scored. Writes `OUT/SEED/` (a run of `twin-diagram learn`; its gallery shows
the true objects, too) and `OUT/scores.jsonl`, `OUT/runs.jsonl`. `--quick`: two objects a bin. Held back: from 100000.
SIGINT and SIGTERM end it as they end `twin-diagram learn`, children with it; the same command goes on afterwards.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from pathlib import Path
from typing import Any

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

from real2sim_truth.drawn_world import fall_short  # noqa: E402
from real2sim_truth.scores import TruthNotes, left_behind, score_run, true_clouds  # noqa: E402
from real2sim_truth.tables import told  # noqa: E402

from twin_diagram import load_scenario  # noqa: E402
from twin_diagram.model import Model  # noqa: E402
from twin_diagram.runs.learning import learn  # noqa: E402
from twin_diagram.runs.learning.drawn_bins import draw_bin  # noqa: E402
from twin_diagram.runs.learning.gallery import write_gallery  # noqa: E402
from twin_diagram.runs.learning.record import STATE, LearningRecord  # noqa: E402
from twin_diagram.runtime.stopping import Stopped, stoppable  # noqa: E402


def main() -> int:
    """Parse the command line and run."""
    try:
        with stoppable():
            return tables()
    except Stopped as stop:
        print("stopped; the same command goes on", file=sys.stderr)
        return stop.status


def tables() -> int:
    """Learn and score each bin, and print the targets beside what came out."""
    logging.getLogger("drake").setLevel(logging.ERROR)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, help="the first seed (default: %(default)s)")
    parser.add_argument("--count", type=int, default=1, help="how many bins (default: %(default)s)")
    parser.add_argument("--objects", type=int, default=5, help="in each (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="two objects a bin")
    parser.add_argument("--noise", type=float, default=0.05, help="of measured torques [N·m] (default: %(default)s)")
    parser.add_argument("--plain", action="store_true", help="gains, biases, frictions and cameras are as told")
    parser.add_argument("--out", type=Path, default=Path("out/real2sim"), help="folder (default: %(default)s)")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE", help="override a field")
    arguments = parser.parse_args()
    base = load_scenario("bin_picking", arguments.set)

    joints = Model.load(base.twin.arm, dict(base.packages)).joints

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    rows: list[dict[str, Any]] = []
    runs: list[dict[str, Any]] = []
    for seed in range(arguments.first, arguments.first + arguments.count):
        scenario = draw_bin(base, seed, 2 if arguments.quick else arguments.objects)
        scenario.world.arm_defects.torque_noise = arguments.noise
        scenario = scenario if arguments.plain else fall_short(scenario, joints)
        out = arguments.out / f"{seed:06d}"
        state = learn(scenario, out, resume=(out / STATE).exists(), say=say, observer=TruthNotes(out))
        write_gallery(LearningRecord(out, scenario), state, true_clouds(scenario, out))
        rows += [{"seed": seed, **row} for row in score_run(scenario, out)]
        runs.append({"seed": seed, **left_behind(scenario, out)})
        for name, lines in (("scores", rows), ("runs", runs)):
            (arguments.out / f"{name}.jsonl").write_text("".join(json.dumps(row) + "\n" for row in lines))
    print(told(rows, runs, arguments.noise))
    return 0


if __name__ == "__main__":
    sys.exit(main())
