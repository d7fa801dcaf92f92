"""A label for each of 640 × 480 pixels, beside Open3D's RANSAC plane and DBSCAN on the same pixels in the same run.

    OMP_NUM_THREADS=1 python sims/benchmarks/segmentation.py --scenes 10 --sigma 0.0015

Ray-cast boxes, cans, bottles and mugs that do not touch: what touches, DBSCAN cannot part. Milliseconds of processor
time, the least of several runs of ours and the least of one run each of Open3D; IoU is the mean over things.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from tabletop.casting import Table, meshes
from tabletop.peers import intersection_over_union, ransac_and_dbscan
from threadpoolctl import threadpool_limits

from twin_diagram.perception.segmentation.segmentation import Grid, label_pixels
from twin_diagram.scenario import Perception


def main() -> None:
    """Print a line for each scene, and the ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument(
        "--sigma", type=float, default=0.0015, help="depth noise at 1 m, half of it shared by pixels [m]"
    )
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rng = np.random.default_rng(args.seed)
    things = list(meshes().values())
    print(f"{'scene':>5s} {'things':>6s} | ours: found   ms   IoU | Open3D: found     ms   IoU | times")
    rows = []
    for scene in range(args.scenes):
        table = Table.with_some(things, int(rng.integers(3, 7)), rng)
        _, depth = table.shot(rng, args.sigma)
        _, owner = table.cast()
        grid = Grid.of(table.view, 1)
        params = Perception(stride=1, workspace=[[-0.2, -0.7, -0.02], [1.2, 0.7, 0.6]], smallest=240)
        spent = []
        with threadpool_limits(1):
            for _ in range(20):
                start = time.thread_time()
                apart = label_pixels(depth, grid, params)
                spent.append(1e3 * (time.thread_time() - start))
        peer_label, peer_count, peer_spent = ransac_and_dbscan(depth, grid, params)
        ours, theirs = (intersection_over_union(label, owner) for label in (apart.label_image, peer_label))
        rows.append((min(spent), ours, peer_spent, theirs))
        print(
            f"{scene:5d} {len(table.things):6d} | {apart.count:11d} {min(spent):5.1f} {ours:.3f} |"
            f" {peer_count:13d} {peer_spent:6.0f} {theirs:.3f} | {peer_spent / min(spent):5.0f}"
        )
    spent_, ours_, peers_, theirs_ = np.array(rows).T
    print(f"median: {np.median(spent_):.1f} ms, {np.median(peers_ / spent_):.0f} times faster; IoU", end=" ")
    print(f"{ours_.mean():.3f} against {theirs_.mean():.3f}")


if __name__ == "__main__":
    main()
