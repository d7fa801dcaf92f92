"""Things that no library knows turn once before the twin's camera and become assets of the running twin.

    OMP_NUM_THREADS=1 python sims/benchmarks/grown_things.py --scenario real_camera --things sugar_box mug --first 0

The mean distances are between samples of the tracked asset's surface and of the true one; two samples of one and the
same surface are as far apart as the last column says.
"""

from __future__ import annotations

import argparse

import numpy as np
from grown_truth.turning import run, samples_apart


def main() -> None:
    """Print a line for each thing and seed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="tabletop", help="tabletop: an ideal camera; real_camera: a D435")
    parser.add_argument("--things", nargs="+", default=["sugar_box", "gelatin_box", "mug", "bottle"])
    parser.add_argument("--first", type=int, default=0, help="first seed: of place, turn and noise")
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=11.0)
    args = parser.parse_args()
    print(f"{'thing':>12s} {'seed':>6s} {'ready':>6s} {'asset off':>10s} {'truth off':>10s} {'samples':>8s}", end="")
    print(f" | {'ms an image':>11s} {'p95':>5s} {'wall s':>6s} | why not")
    for thing in args.things:
        for seed in range(args.first, args.first + args.count):
            one = run(args.scenario, thing, seed, args.seconds)
            off = ("–", "–") if one.off is None else tuple(f"{1e3 * x:.1f} mm" for x in one.off)
            ready = "–" if one.ready is None else f"{one.ready:.1f} s"
            why = "; ".join(event["why"] for event in one.events if event["event"] == "growth_failed")
            print(f"{thing:>12s} {seed:6d} {ready:>6s} {off[0]:>10s} {off[1]:>10s}", end=" ")
            spent = one.milliseconds if len(one.milliseconds) else np.zeros(1)
            print(f"{1e3 * samples_apart(thing):5.1f} mm | {np.median(spent):11.0f}", end=" ")
            print(f"{np.percentile(spent, 95):5.0f} {one.wall:6.0f} | {why}", flush=True)


if __name__ == "__main__":
    main()
