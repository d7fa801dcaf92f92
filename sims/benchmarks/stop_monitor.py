"""Lets planners that go wrong loose among things that stand or creep, and counts what the stop monitor lets them touch.

    python sims/benchmarks/stop_monitor.py --first 0 --count 100
    python sims/benchmarks/stop_monitor.py --quick

Each seed draws a table, a speed below 0.1 m/s for what creeps, and one of four planners in turn: one that drives into
things, one that freezes at speed, one that sends no numbers, one that jumps. A contact counts where the arm, not the
thing, was the one that came: see `braking_bench.counting.ArmCame`. `stood`: the thing came to an arm that stood.
Then ordinary runs of the twin's own planner from goal to goal among the same things: every brake there is a false one.
Poses are the true ones with noise, by 15 images a second, 50 ms late; contact is Drake's. `--bare`: without a monitor.
Writes `OUT/trials.jsonl` and goes on where it stopped. Seeds below 100000 are for training.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

from braking_bench import worlds  # noqa: E402
from braking_bench.counting import ArmCame, wilson  # noqa: E402
from braking_bench.rogues import KINDS  # noqa: E402
from braking_bench.told_perception import ToldPerception  # noqa: E402
from result_lines import append, read  # noqa: E402

from twin_diagram.model.model import Model  # noqa: E402
from twin_diagram.runs.true_clearance import TrueClearance  # noqa: E402
from twin_diagram.runtime import timing  # noqa: E402
from twin_diagram.scenario import Scenario, TaskStep  # noqa: E402
from twin_diagram.scenario.models import Pose  # noqa: E402
from twin_diagram.station import ports  # noqa: E402
from twin_diagram.twin.closed_loop import ClosedLoop, make_closed_loop  # noqa: E402

DURATION = 4.0
"""Of a run with a planner that goes wrong [s]."""
ORDINARY = 20.0
"""Of an ordinary run [s]."""
LOOK = 0.005
"""Between two looks at contacts [s]."""
NEAR = 0.03
"""Distances beyond this are not told apart [m]."""


def rogue_run(kind: str, seed: int, bare: bool) -> dict[str, Any]:
    """Return what a planner that goes wrong touched, and what the monitor did."""
    speed = float(np.random.default_rng([22, seed]).uniform(0.0, 0.1))
    scenario = worlds.draw(seed, DURATION, speed)
    model = Model.load(scenario.twin.arm)
    controller = worlds.rogue(kind, scenario, model, seed)
    return watched(scenario, seed, bare, controller=controller) | {"kind": kind, "speed": speed}


def ordinary_run(seed: int, bare: bool) -> dict[str, Any]:
    """Return what happened while the twin's own planner went from goal to goal."""
    rng = np.random.default_rng([23, seed])
    scenario = worlds.draw(seed, ORDINARY, float(rng.uniform(0.0, 0.1)), share=float(rng.choice([0.2, 0.4])))
    scenario.twin.task.steps = [
        TaskStep(
            goal=Pose(
                translation=[
                    float(rng.uniform(0.35, 0.65)),
                    float(rng.uniform(-0.4, 0.4)),
                    float(rng.uniform(0.3, 0.45)),
                ],
                rpy=[float(np.pi), 0.0, float(rng.uniform(-0.8, 0.8))],
            ),
            time_limit=2 * ORDINARY,
        )
        for _ in range(20)
    ]
    return watched(scenario, seed, bare) | {"kind": "ordinary"}


def watched(scenario: Scenario, seed: int, bare: bool, **own: Any) -> dict[str, Any]:
    """Run a loop and count contacts and brakes."""
    if bare:
        scenario.twin.stop_monitor = None
    perception = ToldPerception(scenario.world, list(scenario.twin.library), seed)
    loop = make_closed_loop(scenario, perception=perception, **own)
    simulator = Simulator(loop.diagram)
    simulator.Initialize()
    context = simulator.get_mutable_context()
    station, twin = (each.GetMyContextFromRoot(context) for each in (loop.station, loop.twin.diagram))
    true, before = TrueClearance(loop.station), timing.snapshot()
    touched, stood, nearest, brakes = NOT_YET, NOT_YET, np.inf, []
    n, begin, started = len(loop.model.joints), time.process_time(), time.perf_counter()
    to_follow = loop.station.GetInputPort(ports.POSITION_COMMANDED)
    came = ArmCame(LOOK, to_follow.Eval(station))
    for k in range(1, round(scenario.duration / LOOK) + 1):
        simulator.AdvanceTo(k * LOOK)
        distance, contacts = true.evaluate(station, NEAR)
        v = np.asarray(loop.station.GetOutputPort(ports.ARM_STATE).Eval(station))[n:]
        itself = came.look(k * LOOK, contacts > 0, v, to_follow.Eval(station))
        nearest = min(nearest, distance)
        if contacts and itself:
            touched = k * LOOK if touched == NOT_YET else touched
        elif contacts:
            stood = k * LOOK if stood == NOT_YET else stood
        if k % 20 == 0:
            brakes += [e for e in loop.twin.brakes(twin) if e["event"] == "brake" and e not in brakes]
    spent, cpu, wall = timing.since(before), time.process_time() - begin, time.perf_counter() - started
    return {
        "seed": seed, "bare": bare, "touched": touched, "stood": stood, "nearest_mm": 1e3 * nearest, "brakes": brakes,
        "seconds": scenario.duration, "visits": visits(loop, twin), "cpu_s": cpu,
        "monitor_s": spent.get("StopMonitor", 0.0) * cpu / wall,
        "looks": 0 if bare else scenario.duration * loop.scenario.twin.stop_monitor.rate,  # type: ignore[union-attr]
    }  # fmt: skip


def visits(loop: ClosedLoop, context: Context) -> int:
    """Return how many goals were reached."""
    runner = loop.twin.runner
    if runner is None:
        return 0
    return int(runner.standing(loop.twin.diagram.GetSubsystemContext(runner, context))["done"])


def report(rows: list[dict[str, Any]]) -> None:
    """Print contacts by planner, false brakes, and what a look costs."""
    for bare in sorted({row["bare"] for row in rows}):
        print("without the monitor" if bare else "with the monitor")
        own = [row for row in rows if row["bare"] == bare]
        bad = [row for row in own if row["kind"] != "ordinary"]
        for kind in KINDS:
            some = [row for row in bad if row["kind"] == kind]
            if some:
                hit = [row["seed"] for row in some if row["touched"] != NOT_YET]
                late = sum(row["stood"] != NOT_YET and row["touched"] == NOT_YET for row in some)
                causes = [brake["cause"] for row in some for brake in row["brakes"]]
                told = ", ".join(f"{cause} {causes.count(cause)}" for cause in sorted(set(causes)))
                print(f"  {kind:8} {len(hit)} of {len(some)} touch {hit or ''}, {late} stood; brakes: {told or 'none'}")
        if bad:
            hits = sum(row["touched"] != NOT_YET for row in bad)
            low, high = wilson(hits, len(bad))
            least = min(row["nearest_mm"] for row in bad)
            print(
                f"  all      {hits} of {len(bad)} touch ({100 * low:.1f} to {100 * high:.1f} %); nearest {least:.1f} mm"
            )
        calm = [row for row in own if row["kind"] == "ordinary"]
        if calm:
            minutes = sum(row["seconds"] for row in calm) / 60
            false = [(row["seed"], b) for row in calm for b in row["brakes"]]
            reached, hit = (
                sum(int(f(row)) for row in calm) for f in (lambda r: r["visits"], lambda r: r["touched"] >= 0)
            )
            print(f"  ordinary {len(false)} brakes in {minutes:.1f} min, {reached} goals reached, {hit} runs touch")
            for seed, brake in false:
                print(f"    seed {seed}: {json.dumps({k: v for k, v in brake.items() if k not in ('event', 'why')})}")
        looks = sum(row["looks"] for row in own)
        if looks:
            print(f"  a look takes {1e3 * sum(row['monitor_s'] for row in own) / looks:.2f} ms of processor time")


NOT_YET = -1.0
"""In the place of a time."""


def main() -> None:
    """Run what is not there yet and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, help="first seed; those below 100000 are for training")
    parser.add_argument("--count", type=int, default=100, help="runs with a planner that goes wrong")
    parser.add_argument("--ordinary", type=int, default=90, help="ordinary runs, of 20 s each")
    parser.add_argument("--out", type=Path, default=Path("out/stop_monitor"))
    parser.add_argument("--quick", action="store_true", help="8 runs and 2 ordinary ones")
    parser.add_argument("--bare", action="store_true", help="without the monitor")
    args = parser.parse_args()
    counts = (8, 2) if args.quick else (args.count, args.ordinary)
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "trials.jsonl"
    rows = read(file)
    done = {(row["kind"], row["seed"], row["bare"]) for row in rows}
    wanted = [(KINDS[seed % len(KINDS)], seed) for seed in range(args.first, args.first + counts[0])]
    wanted += [("ordinary", seed) for seed in range(args.first, args.first + counts[1])]
    for kind, seed in wanted:
        if (kind, seed, args.bare) in done:
            continue
        row = ordinary_run(seed, args.bare) if kind == "ordinary" else rogue_run(kind, seed, args.bare)
        rows.append(row)
        append(file, row)
        print(
            f"{kind} {seed}: touched {row['touched']:.2f}, {len(row['brakes'])} brakes, {row['cpu_s']:.0f} s",
            flush=True,
        )
    report([row for row in rows if (row["kind"], row["seed"]) in wanted])


if __name__ == "__main__":
    main()
