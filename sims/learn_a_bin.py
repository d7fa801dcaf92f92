"""An iiwa 7 empties a bin of things that it does not know and learns each: its surface, its weight, its asset.

Kinds, poses, masses, hidden loads and friction are drawn from the seed; the arm has pictures and its own torques alone.

    python sims/learn_a_bin.py --seed 0 --objects 2
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

from twin_diagram import TwinError, load_scenario
from twin_diagram.runs.learning import learn
from twin_diagram.runs.learning.drawn_bins import draw_bin
from twin_diagram.runtime.stopping import Stopped, stoppable


def main() -> int:
    """Parse the command line and run."""
    logging.getLogger("drake").setLevel(logging.ERROR)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="bin_picking", help="file or name (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of all that is drawn (default: %(default)s)")
    parser.add_argument("--objects", type=int, default=2, help="in the bin (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/learn_a_bin"), help="folder (default: %(default)s)")
    parser.add_argument("--resume", action="store_true", help="go on with the run in that folder")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE", help="override a field")
    arguments = parser.parse_args()
    try:
        with stoppable():
            scenario = draw_bin(load_scenario(arguments.scenario, arguments.set), arguments.seed, arguments.objects)
            state = learn(scenario, arguments.out, resume=arguments.resume)
        for one in state.learned:
            mass = f", {one.figures['mass']:.3f} kg" if "mass" in one.figures else ""
            print(f"{one.name}: {one.state}{mass}{f' ({one.told})' if one.told else ''}")
        print(f"see {arguments.out / 'gallery.html'}")
        return 0
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except Stopped as stop:
        print("stopped; --resume goes on", file=sys.stderr)
        return stop.status


if __name__ == "__main__":
    sys.exit(main())
