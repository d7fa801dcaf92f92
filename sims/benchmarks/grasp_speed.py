"""How long the first ten ranked grasps take, from a mesh's triangles, on one thread.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python sims/benchmarks/grasp_speed.py

For the objects that come along and the YCB meshes of the data folder (`$TWIN_DIAGRAM_DATA`, or `../shared/data`), with
both grippers. Processor time, imports left out: reading the file once; then the median over seeds of all that comes
after it, from sampling the surface to the list. Beside it, as what the machine gives: a k-d tree of the same 3000
points, built and asked for 24 neighbours of each.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from real_data import DATA
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from twin_diagram.planning.grasps import PANDA_HAND, WSG50, Gripper, KnownObject, grasps_of, read_known

CHECKOUT = Path(__file__).resolve().parents[2]
Made = TypeVar("Made")


def timed(make: Callable[[], Made]) -> tuple[Made, float]:
    """Return what is made and the milliseconds of processor time that it took."""
    start = time.thread_time()
    return make(), 1e3 * (time.thread_time() - start)


def bare_cost(known: KnownObject) -> float:
    """Return the milliseconds of a k-d tree on the object's cloud, asked for each point's neighbours."""
    points = known.target().points
    return float(np.median([timed(lambda: cKDTree(points).query(points, k=24))[1] for _ in range(5)]))


def main() -> None:
    """Print a line for each gripper and object, and the worst."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=7, help="0, 1, … of which the median is told")
    seeds = range(parser.parse_args().seeds)
    sources = sorted(path.parent for path in (CHECKOUT / "models" / "objects").glob("*/asset.yaml"))
    sources += sorted((DATA / "ycb").glob("*.gltf"))
    print(f"{'object':30} {'triangles':>9} {'read':>7} {'tree':>6} | gripper: grasps, median and worst of seeds [ms]")
    medians = []

    def spent(known: KnownObject, gripper: Gripper) -> str:
        runs = [timed(partial(grasps_of, known, gripper, count=10, seed=seed, keep=False)) for seed in seeds]
        took = [ms for _, ms in runs]
        medians.append(float(np.median(took)))
        return f"{gripper.name}: {min(len(grasps) for grasps, _ in runs):2} {np.median(took):5.0f} {max(took):5.0f}"

    with threadpool_limits(1):
        grasps_of(read_known(sources[0]), PANDA_HAND, keep=False)  # what is imported late
        for source in sources:
            known, read = timed(partial(read_known, source))
            rows = "   ".join(spent(known, gripper) for gripper in (PANDA_HAND, WSG50))
            print(f"{known.name:30} {len(known.triangles):9} {read:7.0f} {bare_cost(known):6.1f} | {rows}", flush=True)
    print(f"median of all {np.median(medians):.0f} ms, worst median {max(medians):.0f} ms; the aim is 150 ms")


if __name__ == "__main__":
    main()
