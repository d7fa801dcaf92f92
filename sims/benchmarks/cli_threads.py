"""Commands without any thread variable beside the same ones with one thread set by hand: within 1.2× of the best?

Drives the tabletop's arm twice for its logs; then `gap`, `predict` and `run` by turns with and without variables, and
the shortest of each counts, since other work on the machine only lengthens. Beside the time stands that of all cores,
which tells on a busy machine, too: threads that wait for each other spin.

    python sims/benchmarks/cli_threads.py --rounds 2
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from twin_diagram.runtime.threads import FOR_ALL, OWN
from twin_diagram.scenario.resources import resolve

BEST = dict.fromkeys([FOR_ALL, *(names[0] for names in OWN.values())], "1")
FREE = {name: value for name, value in os.environ.items() if name not in {FOR_ALL, *sum(OWN.values(), ())}}
WAYS = {"no variable": FREE, "one by variable": {**FREE, **BEST}}
BLIND = ["--set", "twin.camera=null", "--set", "twin.library={}"]


def seconds(folder: Path, environment: dict[str, str], *argv: str) -> tuple[float, float]:
    """Runs the command in a folder; how long it took, and all cores together [s]."""
    begin, before = time.perf_counter(), os.times()
    command = [sys.executable, "-m", "twin_diagram", *argv]
    subprocess.run(command, cwd=folder, env=environment, capture_output=True, check=True)
    after = os.times()
    cores = after.children_user + after.children_system - before.children_user - before.children_system
    return time.perf_counter() - begin, cores


def write_logs(folder: Path, duration: float = 10.0) -> None:
    """Drives the tabletop's arm twice: `fit.csv` and `held.csv` [s]."""
    for seed, name in enumerate(("fit", "held"), 1):
        argv = ["run", "tabletop", "--duration", str(duration), "--seed", str(seed), "--log", f"{name}.csv", *BLIND]
        seconds(folder, WAYS["one by variable"], *argv)


def commands() -> dict[str, list[str]]:
    """What is measured, in a folder with the logs."""
    model = ["--model", str(resolve("arms/panda_hand.urdf"))]
    return {
        "gap": [*model, "--fit", "fit.csv", "--holdout", "held.csv", "--out", "gap"],
        "predict": [*model, "--log", "fit.csv", "--out", "predicted.csv"],
        "run": ["tabletop", "--duration", "3"],
    }


def compared(folder: Path, rounds: int, command: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """The shortest of some rounds without and with variables: each the time and that of all cores together [s]."""
    argv = commands()[command]
    took = [[seconds(folder, env, command, *argv) for env in WAYS.values()] for _ in range(rounds)]
    free, best = ((min(t for t, _ in way), min(cores for _, cores in way)) for way in zip(*took, strict=True))
    return free, best


def main() -> int:
    """Prints a table; status 1 where the aim is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=2, help="of each command and way (default: %(default)s)")
    rounds, worst = parser.parse_args().rounds, 0.0
    with TemporaryDirectory() as place:
        write_logs(Path(place))
        print(f"{'command':<10}" + "".join(f"{way:>24}" for way in WAYS) + "  ratio  of all cores", flush=True)
        for command in commands():
            (free, free_cores), (best, best_cores) = compared(Path(place), rounds, command)
            worst = max(worst, free / best)
            figures = "".join(f"{a:>14.1f} s {b:>6.1f} s" for a, b in ((free, free_cores), (best, best_cores)))
            print(f"{command:<10}{figures}{free / best:>7.2f}{free_cores / best_cores:>14.2f}", flush=True)
    print(f"{'met' if worst <= 1.2 else 'missed'}: at most {worst:.2f}×, aim 1.2×")
    return int(worst > 1.2)


if __name__ == "__main__":
    sys.exit(main())
