"""The closed loop before a camera as bad as real ones, once or over many seeds; `--scenario tabletop`: an ideal camera.

Once: runs the scenario, prints its table and writes ``summary.json``, ``replay.html``, ``diagram.svg`` and plots.
Over many seeds: object poses, textures, payload, friction and the moving object's path are drawn afresh for each.

    python sims/closed_loop.py --out out/demo
    python sims/closed_loop.py --seeds 20 --out out/seeds
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

from twin_diagram import TwinError, load_scenario, run_scenario
from twin_diagram.native import require_egl
from twin_diagram.runs import run_seeds, tell_seeds


def main() -> int:
    """Parse the command line and run."""
    logging.getLogger("drake").setLevel(logging.WARNING)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="real_camera", help="file or name (default: %(default)s)")
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
        seeds = range(arguments.first, arguments.first + arguments.seeds)
        tell_seeds(run_seeds(arguments.scenario, seeds, arguments.out, overrides=overrides, jobs=arguments.jobs))
        return 0
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
