"""Convex pieces of unknown things seen once, from one side: true volume inside them, their volume over the true one.

    python sims/benchmarks/unknown_pieces.py --views 20 --sigma 0.0038

Ray-cast: boxes, cans, a ball, the objects of `models/objects`, and scanned YCB objects where their data is. Open
vessels count as full: what could be put into them is no room for an arm.
"""

from __future__ import annotations

import argparse

import numpy as np
from tabletop.casting import Table, meshes
from tabletop.volumes import inside_and_excess

from twin_diagram.perception.segmentation.pieces import convex_pieces
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.scenario import Perception


def main() -> None:
    """Print a line for each thing and the worst of all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--views", type=int, default=20, help="poses and cameras of each thing")
    parser.add_argument(
        "--sigma", type=float, default=0.0008, help="depth noise at 1 m, half of it shared by pixels [m]"
    )
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    print(
        f"{'thing':24s} {'inside [%]':>21s} {'pieces / true':>19s} {'pieces':>7s}\n"
        f"{'':24s}   median  p5  worst  median p95 worst"
    )
    rows = []
    for name, mesh in meshes().items():
        rng = np.random.default_rng(args.seed)
        found = []
        for _ in range(args.views):
            table = Table.with_one(mesh, rng)
            rgb, depth = table.shot(rng, args.sigma)
            seen = segment(rgb, depth, 0.0, Grid.of(table.view, 2), Perception())
            pieces = [
                piece
                for k in range(seen.count)
                for piece in convex_pieces(seen.points_W[seen.labels == k], table.view.p_WC, seen.planes[0])
            ]
            found.append((*inside_and_excess(table.thing, pieces, rng), len(pieces)))
        inside, excess, count = np.array(found).T
        rows.append((inside, excess))
        print(
            f"{name:24s} {100 * np.median(inside):8.1f} {100 * np.percentile(inside, 5):5.1f} {100 * inside.min():5.1f}"
            f" {np.median(excess):8.2f} {np.percentile(excess, 95):4.2f} {excess.max():5.2f} {count.mean():7.1f}"
        )
    inside, excess = (np.concatenate(column) for column in zip(*rows, strict=True))
    print(
        f"all: mean {100 * inside.mean():.1f} % inside, in {100 * np.mean(inside >= 0.95):.0f} % of views ≥ 95 %;",
        end=" ",
    )
    print(f"mean {excess.mean():.2f}, in {100 * np.mean(excess <= 2.5):.0f} % ≤ 2.5")


if __name__ == "__main__":
    main()
