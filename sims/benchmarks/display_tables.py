"""How much of a mesh's surface displays show, by the method that chooses further grasps: geometry alone, some seconds.

    python sims/benchmarks/display_tables.py --seeds 4

Each object that comes along lies on a side drawn from the seed, is taken from above by its firmest grasp, shown in full
turns at three tilts, set down as it lay and taken in further grasps until 98 % of what some pose would show is seen, at
most three. Seen: in two pictures or more, within 0.8 m, less than 70° from the normal, by rays past mesh and hand.
`firmest`: the best other grasp there is. Time: simulated, by what `learn` takes for a display (22 s) and a further one
(36 s).
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

from display_truth.shown import Shown  # noqa: E402

from twin_diagram import load_scenario  # noqa: E402
from twin_diagram.planning.grasps import Grasps, Wanted, gripper_of, propose  # noqa: E402
from twin_diagram.runs.learning.coverage import tilts_of, turns_before  # noqa: E402
from twin_diagram.runs.learning.display import TUNING as DISPLAY  # noqa: E402
from twin_diagram.runs.learning.display import tool_at  # noqa: E402
from twin_diagram.runs.learning.grasp_selection import by_axes, by_pair, cameras_about, hand_in  # noqa: E402
from twin_diagram.runs.learning.thing_grasps import downward  # noqa: E402

KINDS = ("angle", "ring", "flask", "bottle", "can", "sugar_box", "gelatin_box", "cracker_box", "mug")
METHODS = ("firmest", "pca", "pair")
WANTED, MOST = 0.98, 3
FIRST, FURTHER = 22.0, 36.0


def lying(kind: str, seed: int) -> Shown:
    """Return an object as it lies: on one of four sides, turned about the vertical."""
    rng = np.random.default_rng([923, seed])
    side = ((0.0, 0.0), (np.pi / 2, 0.0), (0.0, np.pi / 2), (-np.pi / 2, 0.0))[int(rng.integers(4))]
    R = Rotation.from_euler("xyz", [*side, rng.uniform(-np.pi, np.pi)]).as_matrix()
    return Shown.of(SIMS.parents[1] / "models" / "objects" / kind / "visual.obj", R, seed)


def shares(kind: str, seed: int) -> dict[str, list[float]] | None:
    """Return by each method the shares seen after the first grasp, the second, …; None: nothing can be grasped."""
    learning = load_scenario("bin_picking").twin.learning
    p_WC = np.array(load_scenario("bin_picking").twin.cameras[learning.scan_camera].X_WC.translation)
    gripper = gripper_of(learning.gripper)

    def cameras(tilts: tuple[float, ...]) -> np.ndarray:
        return cameras_about(p_WC, [tool_at(learning, tilt) for tilt in tilts], DISPLAY.turn, learning.frames)

    def grasps(thing: Shown, number: int) -> Grasps:
        table = np.array([0.0, 0.0, 1.0, 0.004])
        middle = 0.5 * (thing.points.min(axis=0) + thing.points.max(axis=0))
        wanted = Wanted(40, number)
        return propose(thing.points, thing.normals, gripper, wanted=wanted, table=table, mass=0.5, centre=middle)

    found: dict[str, list[float]] = {}
    for method in METHODS:
        thing = lying(kind, seed)
        first = grasps(thing, 0)
        if not len(downward(first)):
            return None
        hand = hand_in(first, int(downward(first)[0]), np.eye(4), gripper)
        held, tilts, told = [hand.X_ST], DISPLAY.tilts, []
        while True:
            thing.look(hand, cameras(tilts))
            told.append(thing.as_map().seen_share)
            if told[-1] >= WANTED or len(told) > MOST:
                break
            again, tilts = grasps(thing, len(told)), DISPLAY.later_tilts
            order, turns = downward(again), turns_before(learning, p_WC)
            if method == "pca":
                order = by_axes(again, np.eye(4), thing.points, held)
            elif method == "pair":
                order, _ = by_pair(again, np.eye(4), thing.as_map(), gripper, turns)
            if not len(order):
                break
            hand = hand_in(again, int(order[0]), np.eye(4), gripper)
            if method == "pair":
                tilts = tilts_of(thing.as_map(), hand, learning, p_WC)
            held.append(hand.X_ST)
        found[method] = told
    return found


def main() -> None:
    """Print a line for each object, and the means."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--first", type=int, default=0, help="the first seed (default: %(default)s)")
    parser.add_argument("--seeds", type=int, default=4, help="how many, for each object (default: %(default)s)")
    parser.add_argument("--kinds", nargs="+", default=KINDS, help="objects (default: all)")
    given = parser.parse_args()
    print(f"{'object':12}" + "".join(f"| {m:8} in two   at last  grasps   time " for m in METHODS))
    every: dict[str, list[list[float]]] = defaultdict(list)
    begun = time.process_time()

    def row(name: str, told: dict[str, list[list[float]]]) -> str:
        text = f"{name:12}"
        for method in METHODS:
            runs = told[method]
            two, last = (100 * np.mean([r[min(k, len(r) - 1)] for r in runs]) for k in (1, MOST))
            count = float(np.mean([len(r) for r in runs]))
            text += f"| {'':8} {two:5.1f} %  {last:5.1f} %  {count:5.2f} {FIRST + FURTHER * (count - 1):6.0f} s "
        return text

    for kind in given.kinds:
        runs = [shares(kind, seed) for seed in range(given.first, given.first + given.seeds)]
        told = {method: [run[method] for run in runs if run] for method in METHODS}
        if not told["pair"]:
            print(f"{kind:12}| cannot be grasped from above")
            continue
        print(row(kind, told), flush=True)
        for method in METHODS:
            every[method] += told[method]
    print(row("all", every))
    worst = ", ".join(f"{m} {100 * min(r[min(1, len(r) - 1)] for r in every[m]):.1f} %" for m in METHODS)
    print(f"least in two grasps: {worst}; {time.process_time() - begun:.0f} s of a core")


if __name__ == "__main__":
    main()
