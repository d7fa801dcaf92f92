"""What a second camera is worth: the same worlds seen by one of `two_cameras`' cameras and by both.

    OMP_NUM_THREADS=1 python sims/benchmarks/two_cameras.py --first 1 --count 3 --jobs 1

Poses, textures and the moving box's path are drawn afresh for each seed. Counted are all objects at all times from the
second second on, in sight or not: each one's median error, the worst of them; and the seconds, over all objects, in
which one was not known to be where it is: never seen, stale, lost, gone, or 3 cm and more off.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
from pydrake.systems.analysis import Simulator

from twin_diagram import load_scenario, make_closed_loop
from twin_diagram.runs.randomization import vary
from twin_diagram.signals.layouts import TRACK_SIZE, ObjectStatus

STEP, START, FAR = 0.1, 1.0, 0.03
UNKNOWN = (ObjectStatus.UNSEEN, ObjectStatus.STALE, ObjectStatus.LOST, ObjectStatus.GONE)


def run(task: tuple[int, int, float]) -> str:
    """Run one seed with one camera or two; return its line."""
    seed, count, duration = task
    begin = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        plan = vary(load_scenario("two_cameras"), seed, folder)
        if count == 1:
            plan.twin.cameras = {}
        loop = make_closed_loop(plan)
        simulator = Simulator(loop.diagram)
        simulator.Initialize()
        twin = loop.twin.diagram.GetMyContextFromRoot(simulator.get_context())
        station = loop.station.GetMyContextFromRoot(simulator.get_context())
        index = [list(plan.world.objects).index(name) for name in plan.twin.library]
        errors, unknown, squares = [], [], []
        for now in np.arange(START, duration + 1e-9, STEP):
            simulator.AdvanceTo(now)
            tracks = np.array(loop.twin.diagram.GetOutputPort("tracks").Eval(twin)).reshape(-1, TRACK_SIZE)
            true = np.array(loop.station.GetOutputPort("truth.object_poses").Eval(station)).reshape(-1, 7)[index]
            off = tracks[:, 6:9] - true[:, 4:]
            spread = tracks[:, 15:].reshape(-1, 6, 6)[:, 3:, 3:]
            errors.append(np.linalg.norm(off, axis=1))
            squares.append(np.einsum("ki,kij,kj->k", off, np.linalg.inv(spread), off) / 3.0)
            unknown.append(np.isin(tracks[:, 0], UNKNOWN) | (errors[-1] > FAR))
    middle, lost = 1e3 * np.median(errors, axis=0), STEP * np.sum(unknown, axis=0)
    each = " ".join(f"{name} {m:.1f}/{s:.1f}" for name, m, s in zip(plan.twin.library, middle, lost, strict=True))
    claim, spent = float(np.mean(np.median(squares, axis=0))), time.process_time() - begin
    return (
        f"seed {seed}, {count} camera(s): worst median {middle.max():.1f} mm, mean of medians {middle.mean():.1f} mm, "
        f"unknown {lost.sum():.1f} s, squared errors {claim:.2f} of the claim, {spent:.0f} s of a core; {each} (mm/s)"
    )


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--count", type=int, default=3)
    parser.add_argument("--duration", type=float, default=10.0, help="[s]")
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.count)
    tasks = [(seed, count, args.duration) for seed in seeds for count in (1, 2)]
    # Drake's systems are never freed: each run in a process of its own.
    with ProcessPoolExecutor(args.jobs, mp_context=get_context("spawn"), max_tasks_per_child=1) as pool:
        for line in pool.map(run, tasks):
            print(line, flush=True)


if __name__ == "__main__":
    main()
