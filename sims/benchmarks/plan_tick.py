"""What a tick of the planner costs: a Panda among eight objects of eight convex pieces each, three of which move.

    python sims/benchmarks/plan_tick.py --first 0 --count 10
    python sims/benchmarks/plan_tick.py --quick --profile

Horizon, samples, clearance and rate are those of scenarios, unless `--rate` says otherwise. The arm goes to and fro
between two places and does what it is told, late by a lag; tracks are noisy. Processor time of the control tick alone,
of one core: what the route search takes in a process of its own is not in it. Writes `OUT/ticks.jsonl`, a line per
seed, and goes on where it stopped. Seeds below 100000 are for training.
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

from planning_worlds.crowd import Crowd, crowded_scene  # noqa: E402
from result_lines import append, read  # noqa: E402

from twin_diagram import scenario  # noqa: E402
from twin_diagram.planning import MotionPlanner  # noqa: E402
from twin_diagram.planning.mpc.warm_up import warm_up  # noqa: E402
from twin_diagram.planning.paths.search_process import SearchProcess  # noqa: E402
from twin_diagram.signals.arrays import Array  # noqa: E402

AIMS = {"median": 5.0, "p95": 10.0, "p99.9": 20.0}
"""Processor time of a tick [ms]."""
VELOCITY = np.array([2.175] * 4 + [2.61] * 3)
"""The Panda's limits [rad/s]."""
LAG = 0.06
"""Of the arm behind its command [s]."""


def ticks(planner: MotionPlanner, crowd: Crowd, seed: int, seconds: float) -> Iterator[tuple[float, bool]]:
    """Run the arm among things; yield each tick's processor time [s], and whether its programs were solved."""
    rng = np.random.default_rng([11, seed])
    period = 1.0 / planner.params.rate
    q, v = crowd.home.copy(), np.zeros(len(crowd.home))
    memory = planner.initial(q)
    for number in range(round(seconds / period)):
        now = number * period
        tracks, goal = crowd.tracks(now, rng), crowd.goal(now)
        begin = time.process_time()
        memory, report = planner.tick(memory, now, np.concatenate([q, v]), tracks, goal)
        yield time.process_time() - begin, report.solved
        to = memory.trajectory.position(now + period)
        moved: Array = q + (1.0 - np.exp(-period / LAG)) * (to - q)
        q, v = moved, (moved - q) / period


def told(name: str, spent: list[float]) -> str:
    """Return a line with the figures of some ticks' times [s], beside their aims."""
    found = 1e3 * np.array([np.median(spent), np.percentile(spent, 95), np.percentile(spent, 99.9), max(spent)])
    aims = "/".join(f"{aim:g}" for aim in AIMS.values())
    return f"{name}: {found[0]:.2f} / {found[1]:.2f} / {found[2]:.2f} ms (aim {aims}), worst {found[3]:.2f}"


def main() -> None:
    """Run what is not there yet and print median, p95 and p99.9."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, help="first seed (default: %(default)s)")
    parser.add_argument("--count", type=int, default=10, help="seeds (default: %(default)s)")
    parser.add_argument("--seconds", type=float, default=20.0, help="simulated, a seed (default: %(default)s)")
    parser.add_argument("--rate", type=float, default=scenario.Planner().rate, help="ticks a second (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/plan_tick"))
    parser.add_argument("--quick", action="store_true", help="two seeds of 4 s, nothing kept")
    parser.add_argument("--profile", action="store_true", help="print where the time goes; nothing kept")
    args = parser.parse_args()
    count, seconds = (2, 4.0) if args.quick else (args.count, args.seconds)
    scene = crowded_scene()
    planner = MotionPlanner(scene, VELOCITY, replace(scenario.Planner(), rate=args.rate, velocity_share=0.4))
    warm_up(planner)
    beside = SearchProcess(planner.guide)
    planner.searcher = beside
    file = args.out / f"ticks_{args.rate:g}Hz_{seconds:g}s.jsonl"
    keep = not (args.quick or args.profile)
    rows = read(file) if keep else []
    done = {row["seed"]: row for row in rows}
    profile = cProfile.Profile()
    for seed in range(args.first, args.first + count):
        if seed in done:
            continue
        if args.profile:
            profile.enable()
        spent = list(ticks(planner, Crowd(scene, seed), seed, seconds))
        profile.disable()
        done[seed] = {"seed": seed, "seconds": [s for s, _ in spent], "unsolved": sum(not ok for _, ok in spent)}
        if keep:
            args.out.mkdir(parents=True, exist_ok=True)
            append(file, done[seed])
        print(told(f"seed {seed}", done[seed]["seconds"]), f"unsolved {done[seed]['unsolved']}", flush=True)
    beside.close()
    wanted = [done[seed] for seed in range(args.first, args.first + count)]
    every = [s for row in wanted for s in row["seconds"]]
    print(told(f"{len(wanted)} seeds from {args.first}, {len(every)} ticks at {args.rate:g} Hz", every))
    if args.profile:
        pstats.Stats(profile).sort_stats("tottime").print_stats(28)


if __name__ == "__main__":
    main()
