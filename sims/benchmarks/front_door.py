"""What hurt newcomers, in eight points: the figures of then beside those of now, and whether each aim is met.

    python sims/benchmarks/front_door.py --quick          # minutes: every point in short
    python sims/benchmarks/front_door.py                  # an hour on two idle cores
    python sims/benchmarks/front_door.py --only 2 5

Point 6 counts what `several_joints.py run --first 1000 --count 50 --out out/several_joints` has left, if it was run.
Status 1 where an aim is missed; a figure without an aim says nothing of that.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from pydrake.systems.analysis import Simulator

BENCHMARKS = Path(__file__).resolve().parent
CHECKOUT = BENCHMARKS.parents[1]
sys.path[:0] = [str(BENCHMARKS), str(CHECKOUT)]

import cli_threads  # noqa: E402
import several_joints  # noqa: E402
import stopping  # noqa: E402

from tests.estimation.drift import test_wild_motion as wild  # noqa: E402
from twin_diagram import load_scenario, make_closed_loop  # noqa: E402
from twin_diagram.runs.trial import sample_times  # noqa: E402
from twin_diagram.runtime.threads import one_thread  # noqa: E402

SEVERAL = Path("out/several_joints")
RIGHT, WRONG, NONE = 45, 1, 0.98
"""Aims of point 6: of 50 cases, and the share of second runs that say `none`."""


@dataclass(frozen=True)
class Row:
    """One figure.

    Attributes:
        what: it is.
        old: as a newcomer met it.
        new: as it is now.
        met: whether the aim is; None where the figure has none.
    """

    what: str
    old: str
    new: str
    met: bool | None = None


def command(folder: Path, *argv: str) -> tuple[int, float, str]:
    """Runs ``twin-diagram`` in a folder; its status, how long it took [s], and what it printed."""
    begin = time.perf_counter()
    env = {**os.environ, "PYTHONPATH": str(CHECKOUT)}
    done = subprocess.run(
        [sys.executable, "-m", "twin_diagram", *argv], cwd=folder, env=env, capture_output=True, text=True
    )
    return done.returncode, time.perf_counter() - begin, done.stdout + done.stderr


def threads(folder: Path, quick: bool) -> Iterator[Row]:
    """Commands without any thread variable beside one thread by variable."""
    old = {"gap": "110 s of 34 s: 3.2×", "run": "0.17× real time of 0.49×: 2.9×"}
    cli_threads.write_logs(folder, 3.0 if quick else 10.0)
    for name in ("predict",) if quick else cli_threads.commands():
        (free, _), (best, _) = cli_threads.compared(folder, 1 if quick else 2, name)
        ratio = free / best
        yield Row(f"{name}, time without and with", old.get(name, "–"), f"{free:.1f} s of {best:.1f} s: {ratio:.2f}×",
                  ratio <= 1.2)  # fmt: skip


def blindness(folder: Path, quick: bool) -> Iterator[Row]:
    """A bus on which nobody speaks, and a run that lacks nothing."""
    silent = ("--set", "station=lcm", "--set", "lcm.url=memq://")
    calm = ("--set", "twin.healing=null", "--duration", "0.5" if quick else "2")
    status, _, _ = command(folder, "run", "fault", *silent, *calm, "--out", "silent")
    summary = json.loads((folder / "silent" / "summary.json").read_text())
    reasons = ", ".join(lack["reason"] for lack in summary["health"])
    good = status == 3 and summary["joints"] is None
    yield Row("silent bus", "joints 0.6, 0.2, … (the home), exit 0", f"joints {summary['joints']}, exit {status}", good)
    yield Row("silent bus, health", "–", reasons, "no_arm_message" in reasons)
    status, _, _ = command(folder, "run", "fault", *calm, "--out", "healthy")
    lacks = json.loads((folder / "healthy" / "summary.json").read_text())["health"]
    yield Row("healthy run, health", "–", f"{lacks}, exit {status}", status == 0 and lacks == [])


def stops(folder: Path, quick: bool) -> Iterator[Row]:
    """SIGINT and SIGTERM: time to close. Kill -9: does what is left replay?"""
    draw = random.Random(18)
    closed, killed, until = [], [], []
    numbers = [*[signal.SIGINT, signal.SIGTERM] * (1 if quick else 3), *[signal.SIGKILL] * (1 if quick else 20)]
    for k, number in enumerate(numbers):
        place = folder / f"stop{k}"
        place.mkdir()
        status, took = stopping.ended(place, number, draw.uniform(0.0, 1.0 if quick else 8.0))
        fine, reached = stopping.replays(place)
        if number == signal.SIGKILL:
            killed.append(fine)
            until.append(reached)
        else:
            closed.append((took, fine and status == 128 + number))
    worst, fine = max(took for took, _ in closed), all(fine for _, fine in closed)
    yield Row("SIGINT, SIGTERM: closed after", "recording and log lost", f"≤ {worst:.2f} s, all replay: {fine}",
              worst <= 2.0 and fine)  # fmt: skip
    yield Row("kill -9: recording replays", "no", f"{sum(killed)} of {len(killed)}, to {min(until):.2f} s and more",
              all(killed))  # fmt: skip


def outputs(folder: Path, quick: bool) -> Iterator[Row]:
    """Outputs below a file: how long until the refusal."""
    cli_threads.write_logs(folder, 1.0)
    (folder / "file").write_text("in the way\n")
    model = cli_threads.commands()["gap"][:2]
    tried = {
        "run --out": ("run", "tabletop", "--duration", "600", "--out", "file/out"),
        "run --record": ("run", "tabletop", "--duration", "600", "--record", "file/out"),
        "run --log": ("run", "tabletop", "--duration", "600", "--log", "file/log.csv"),
        "gap --out": ("gap", *model, "--fit", "fit.csv", "--holdout", "held.csv", "--out", "file/out"),
        "predict --out": ("predict", *model, "--log", "fit.csv", "--out", "file/p.csv"),
    }
    for name, argv in tried.items():
        status, took, said = command(folder, *argv)
        good = status == 2 and said.startswith("error: ") and said.count("\n") == 1
        yield Row(f"{name} that cannot be", "after the work", f"exit {status} after {took:.1f} s", good)


def score(folder: Path, quick: bool) -> Iterator[Row]:
    """The joint error of the tabletop, sampled on the plant's steps and, as once, at 60 Hz in between."""
    duration = 2.0 if quick else 10.0
    blind = ["twin.camera=null", "twin.library={}"] if quick else []
    plan = load_scenario("tabletop", [*blind, f"duration={duration}"])
    loop = make_closed_loop(plan)
    simulator = Simulator(loop.diagram)
    context = simulator.get_mutable_context()
    station, twin = (part.GetMyContextFromRoot(context) for part in (loop.station, loop.twin.diagram))
    n, grids = len(loop.model.joints), {}
    grids[False] = [k / 60.0 for k in range(1, int(60 * duration))]
    grids[True] = sample_times(duration, plan.world.time_step)
    errors: dict[bool, list[np.ndarray]] = {False: [], True: []}
    for t, on_steps in sorted((t, on_steps) for on_steps, times in grids.items() for t in times):
        simulator.AdvanceTo(t)
        truth = np.array(loop.station.GetOutputPort("truth.arm_state").Eval(station))[:n]
        errors[on_steps].append(np.array(loop.twin.diagram.GetOutputPort("arm_state").Eval(twin))[:n] - truth)
    between, steps = (float(np.sqrt(np.mean(np.square(errors[which])))) for which in (False, True))
    yield Row("joint error, sampled on the plant's steps", "1.4e-4 rad (6.7e-4 of 2.2e-5)", f"{steps:.1e} rad RMS",
              None if quick else steps <= 2.2e-5)  # fmt: skip
    yield Row("the same run at 60 Hz", "the score", f"{between:.1e} rad RMS: {between / steps:.0f}×")


def naming(folder: Path, quick: bool) -> Iterator[Row]:
    """Several effects on several joints: the count of a run of `several_joints.py`."""
    results = SEVERAL / "results.jsonl"
    records = several_joints.result_lines.read(results)
    counted = [r for r in several_joints.apart(records) if r["seed"] >= 1000 and "error" not in r]
    if not counted:
        yield Row("right, wrong, unknown sets of 50", "five at 5 %, seven at 58 %", f"no results in {SEVERAL}")
        return
    right, wrong, unknown = (sum(r["set"] == kind for r in counted) for kind in ("right", "wrong", "unknown"))
    again = [r["again"]["verdict"] == "none" for r in counted if "again" in r]
    whole = len(counted) >= 50
    sets = f"{right}, {wrong}, {unknown} of {len(counted)}"
    yield Row("right, wrong, unknown sets", "five at 5 %, seven at 58 %", sets,
              right >= RIGHT and wrong <= WRONG if whole else None)  # fmt: skip
    yield Row("second run says none", "unknown", f"{sum(again)} of {len(again)}",
              sum(again) >= NONE * len(again) if whole else None)  # fmt: skip
    rules = {key: sum(r[key] for r in counted) for key in ("above", "over", "guess")}
    yield Row(
        "alternative above the named, sums over 1, guesses", "58 % above 5 %", f"{rules}", not any(rules.values())
    )


def faults(folder: Path, quick: bool) -> Iterator[Row]:
    """A fault that begins while the arm works: `twin-diagram run fault`."""
    short = ("--duration", "4", "--set", "twin.healing=null") if quick else ()
    status, took, said = command(folder, "run", "fault", *short, "--out", "fault")
    if status:
        yield Row("onset in world.arm.effects", "refused", said.splitlines()[-1][:60], False)
        return
    summary = json.loads((folder / "fault" / "summary.json").read_text())
    (onset,) = [effect.onset for effect in load_scenario("fault").world.arm.effects]
    alarm = min((alarm["time"] for alarm in summary["alarms"]), default=float("inf"))
    yield Row("onset in world.arm.effects", "refused", f"runs, exit {status} after {took:.0f} s", status == 0)
    yield Row("alarm after the onset", "–", f"{alarm - (onset or 0.0):.3f} s", 0.0 < alarm - (onset or 0.0) < 0.1)
    if not quick:
        events = [json.loads(line) for line in (folder / "fault" / "events.jsonl").read_text().splitlines()]
        swaps = [f"{'; '.join(e['effects'])} at {e['time']:.1f} s" for e in events if e["event"] == "model_swapped"]
        yield Row("healing", "–", swaps[0] if swaps else "none", bool(swaps))


def motion(folder: Path, quick: bool) -> Iterator[Row]:
    """An exact pendulum at 5 to 30 rad/s: false alarms, and mass that is not there."""
    duration = 30.0 if quick else 600.0
    for peak in (20.0,) if quick else (5.0, 12.0, 20.0, 30.0):
        for kind in (wild.spinning, wild.to_and_fro):
            with one_thread():
                seen = wild.watch(wild.swing(kind(peak), duration, seed=1))
            share = seen.mass / wild.MASS
            name = f"pendulum, {kind.__name__.replace('_', ' ')}, {peak:g} rad/s, {duration / 60.0:g} min"
            said = f"{seen.alarms} alarms, {100 * share:.2f} % of its mass"
            yield Row(name, "alarms, 3 kg" if peak > 10.0 else "–", said,
                      seen.armed and seen.alarms == 0 and share <= 0.01)  # fmt: skip


POINTS: dict[int, tuple[str, Callable[[Path, bool], Iterator[Row]]]] = {
    1: ("speed without variables (aim: 1.2×)", threads),
    2: ("the twin says when it is blind", blindness),
    3: ("Ctrl-C and kill (aim: 2 s)", stops),
    4: ("outputs are tried before the work", outputs),
    5: ("the score's sampling", score),
    6: ("names on several joints", naming),
    7: ("faults can be tried", faults),
    8: ("monitor on wild motion", motion),
}


def main() -> int:
    """Prints each point's figures; status 1 where an aim is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="shorter runs and fewer of them")
    parser.add_argument("--only", type=int, nargs="+", choices=POINTS, default=list(POINTS), help="some of the points")
    given, missed = parser.parse_args(), 0
    for number in given.only:
        title, measure = POINTS[number]
        print(f"{number}. {title}", flush=True)
        with TemporaryDirectory() as place:
            for row in measure(Path(place), given.quick):
                missed += row.met is False
                mark = {True: "met", False: "MISSED", None: ""}[row.met]
                print(f"   {row.what:<50} old: {row.old:<38} new: {row.new:<44} {mark}", flush=True)
    print(f"{missed} aims missed" if missed else "no aim missed")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
