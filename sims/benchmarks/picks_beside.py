"""Picks beside what nobody knows: `sims/pick_and_place.py` with one thing more, some centimetres from what is taken.

One of the other objects is taken out of the twin's library, and set down beside the one that is to be picked: at a
bearing and a gap drawn from the seed, so that some of the hand's turns are barred. The rest is as there.

    python sims/benchmarks/picks_beside.py --first 0 --seeds 6
"""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path

import numpy as np

SIMS = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(SIMS))

from pick_and_place import row  # noqa: E402

from twin_diagram import TwinError, load_scenario, run_scenario  # noqa: E402
from twin_diagram.assets import Asset  # noqa: E402
from twin_diagram.runs.drawn_picks import draw_picks  # noqa: E402
from twin_diagram.scenario import Pose, Scenario  # noqa: E402
from twin_diagram.scenario.resources import resolve  # noqa: E402

GAP = (0.02, 0.05)
"""Between the circles about both [m]: where a finger or the flat of the hand finds room, but not both whichever way."""


def draw(base: Scenario, seed: int) -> tuple[Scenario, str]:
    """Return the scenario of a seed, and what stands beside."""
    plan, rng = draw_picks(base, seed), np.random.default_rng([912, seed])
    target = plan.twin.task.steps[0].object
    others = [name for name in ("mug", "sugar_box") if name in plan.twin.library]
    name = others[int(rng.integers(len(others)))]
    assets = [Asset.load(resolve(plan.world.objects[key].asset, base.packages)) for key in (target, name)]
    # Of what is round, as far as its sides; of a box, as far as its corners.
    wide = [float(max(asset.size[:2]) if asset.symmetric_axis else np.hypot(*asset.size[:2])) for asset in assets]
    bearing, yaw = rng.uniform(-np.pi, np.pi, 2)
    far = 0.5 * sum(wide) + float(rng.uniform(*GAP))
    told, moved = plan.world.objects[target].X_WO, plan.world.objects[name]
    x, y = told.translation[0] + far * np.cos(bearing), told.translation[1] + far * np.sin(bearing)
    moved.X_WO = Pose([float(x), float(y), moved.X_WO.translation[2]], [0.0, 0.0, float(yaw)])
    del plan.twin.library[name]
    return plan, f"{name} {100 * far:.0f} cm at {np.degrees(bearing):.0f}°"


def main() -> int:
    """Parse the command line and run."""
    logging.getLogger("drake").setLevel(logging.WARNING)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, help="the first seed (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=6, help="how many (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/picks_beside"), help="folder (default: %(default)s)")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE", help="override a field")
    arguments = parser.parse_args()
    try:
        base = load_scenario("pick_and_place", arguments.set)
        print(" seed  object       success  time s   off mm  off °  point  surface  outcome", flush=True)
        wins = 0
        for seed in range(arguments.first, arguments.first + arguments.seeds):
            plan, beside = draw(base, seed)
            out = arguments.out / f"{seed:04d}"
            good, line = row(seed, run_scenario(plan, out=out, pictures=False, quiet=True, say=lambda text: None))
            print(f"{line}; beside it {beside}", flush=True)
            wins += good
        print(f"{wins} of {arguments.seeds} succeeded")
        return 0
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
