"""`twin-diagram gap --fleet`. Cheap to import, as the command line is."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path


def add_fleet_options(gap: argparse.ArgumentParser) -> None:
    """Add what `gap` takes instead of one robot's model and logs."""
    gap.add_argument(
        "--fleet",
        type=Path,
        metavar="CSV",
        help="many robots instead of one: a table with robot,date,model,fit,holdout (fit logs by ;); writes fleet.csv "
        "and fleet.html, and goes on where it stopped",
    )
    gap.add_argument("--jobs", type=int, default=1, metavar="N", help="robots at a time (default: %(default)s)")
    gap.add_argument(
        "--timeout",
        type=float,
        default=3600.0,
        metavar="S",
        help="give a robot up after [s] (default: %(default)s)",
    )
    gap.add_argument("--dask", default="", metavar="ADDRESS", help="a Dask scheduler whose workers see the same files")


def one_or_many(arguments: argparse.Namespace) -> str:
    """Return what is wrong with a command that tells neither one robot nor a fleet, or both; empty: nothing."""
    one = {"--model": arguments.model, "--fit": arguments.fit, "--holdout": arguments.holdout}
    if arguments.fleet is None:
        lacking = [name for name, value in one.items() if value is None]
        return f"the following arguments are required: {', '.join(lacking)}" if lacking else ""
    there = [name for name, value in one.items() if value is not None]
    return f"--fleet: its table tells models and logs; leave out {', '.join(there)}" if there else ""


def run(arguments: argparse.Namespace) -> int:
    """Run a fleet; returns the exit status."""
    from twin_diagram.runs.fleet.fleet import run_fleet

    options: list[str] = []
    for name in ("columns", "torque_side"):
        if (value := getattr(arguments, name)) is not None:
            options += [f"--{name.replace('_', '-')}", str(value)]
    for name, values in (("--packages", arguments.packages), ("--import", arguments.imported)):
        options += [part for value in values for part in (name, value)]

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    lines = run_fleet(
        arguments.fleet, arguments.out, arguments.jobs, arguments.timeout, arguments.dask, tuple(options), say
    )
    bad = sum(line.verdict in ("failed", "timeout") for line in lines)
    print(f"{len(lines)} visits, {bad} without an answer; see {arguments.out / 'fleet.html'}")
    return 0
