"""`twin-diagram gap --fleet`. Cheap to import, as the command line is."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

from twin_diagram.runtime.progress import say_beside


def add_fleet_options(gap: argparse.ArgumentParser) -> None:
    """Add what `gap` takes instead of one robot's model and logs."""
    gap.add_argument(
        "--fleet",
        type=Path,
        metavar="CSV",
        help="many robots instead of one: a table with robot,date,model,fit,holdout (fit logs by ;), and torque_side "
        "where they differ in it; writes fleet.csv and fleet.html, and goes on where it stopped",
    )
    gap.add_argument("--jobs", type=int, metavar="N", help="with --fleet: robots at a time (default: 1)")
    gap.add_argument(
        "--timeout",
        type=float,
        metavar="S",
        help="with --fleet: give a robot up after [s] (default: 3600)",
    )
    gap.add_argument(
        "--dask", metavar="ADDRESS", help="with --fleet: a Dask scheduler whose workers see the same files"
    )


def one_or_many(arguments: argparse.Namespace) -> str:
    """Return what is wrong with a command that tells neither one robot nor a fleet, or both; empty: nothing."""
    one = {"--model": arguments.model, "--fit": arguments.fit, "--holdout": arguments.holdout}
    if arguments.fleet is None:
        many = {"--jobs": arguments.jobs, "--timeout": arguments.timeout, "--dask": arguments.dask}
        if useless := [name for name, value in many.items() if value is not None]:
            return f"{', '.join(useless)}: only with --fleet"
        lacking = [name for name, value in one.items() if value is None]
        return f"the following arguments are required: {', '.join(lacking)}" if lacking else ""
    there = [name for name, value in one.items() if value is not None]
    return f"--fleet: its table tells models and logs; leave out {', '.join(there)}" if there else ""


def run(arguments: argparse.Namespace, packages: Mapping[str, str | Path]) -> int:
    """Run a fleet; returns the exit status.

    Args:
        arguments: of the command.
        packages: local folders for `package://` names.

    Raises:
        TwinError: of the table, or of a map of columns that is none.
    """
    from twin_diagram.logs.column_map import column_map
    from twin_diagram.runs.fleet.fleet import run_fleet

    if arguments.columns is not None:
        column_map(arguments.columns)  # told once, not by each robot
    options: list[str] = []
    if arguments.torque_constants is not None:
        options += ["--torque-constants", *arguments.torque_constants]
    if arguments.joints:
        options += ["--joints", *arguments.joints]
    for name in ("columns", "torque_side"):
        if (value := getattr(arguments, name)) is not None:
            options += [f"--{name.replace('_', '-')}", str(value)]
    told = [f"{name}={folder}" for name, folder in packages.items()]
    for name, values in (("--packages", told), ("--import", arguments.imported)):
        options += [part for value in values for part in (name, value)]

    asked = {name: getattr(arguments, name) for name in ("jobs", "timeout", "dask")}
    given = {name: value for name, value in asked.items() if value is not None}
    lines = run_fleet(arguments.fleet, arguments.out, options=tuple(options), say=say_beside, **given)
    bad = sum(line.verdict in ("failed", "timeout") for line in lines)
    print(f"{len(lines)} visits, {bad} without an answer; see {arguments.out / 'fleet.html'}")
    return 0
