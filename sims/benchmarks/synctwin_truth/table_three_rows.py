"""Runs the rows of Table III, goes on where it stopped, and prints them beside the paper's."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import Any

from braking_bench.counting import wilson
from result_lines import append, read

from synctwin_truth import half_hidden, table_three

ROWS = ("before", "after")
PAPER = {
    "before": {"bottle": 78.3, "cup": 65.0, "box": 81.7, "can": 80.0},
    "after": {"bottle": 90.0, "cup": 86.7, "box": 93.3, "can": 95.0},
}
"""SyncTwin's success [%]."""
AIM = 95.0
"""After completion, of every thing [%]; and 10 points more than before, or 88 % before."""


def run_rows(
    out: Path, first: int, count: int, rows: list[str], things: list[str], profile: str
) -> list[dict[str, Any]]:
    """Run what is not there yet; return all rows that are asked for."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "grasping.jsonl"
    done = read(file)
    keys = ("kind", "row", "seed", "profile")
    there = {tuple(row[key] for key in keys) for row in done}
    for seed in range(first, first + count):
        for kind in things:
            for row in rows:
                if (kind, row, seed, profile) in there:
                    continue
                found = table_three.attempt(kind, row, seed, profile)
                done.append(found)
                append(file, found)
                ended = "held" if found["good"] else found["why"]
                print(f"{kind} {row} {seed}: {ended}, {found['hidden']:.0%} hidden, {found['cpu_s']:.0f} s", flush=True)
    wanted = range(first, first + count)
    return [
        r for r in done if r["seed"] in wanted and r["kind"] in things and r["row"] in rows and r["profile"] == profile
    ]


def report(rows: list[dict[str, Any]], first: int, count: int, profile: str) -> None:
    """Print success by thing and row with Wilson's intervals, and failures by cause."""
    print(f"seeds {first} to {first + count - 1}, camera 320×240 at 15 Hz, profile {profile}, first attempt")
    print("thing   row    | success % [95 %]            (SyncTwin; aim after completion ≥ 95 %)")
    for kind in half_hidden.THINGS:
        for row in ROWS:
            own = [r for r in rows if (r["kind"], r["row"]) == (kind, row)]
            if not own:
                continue
            hits = sum(r["good"] for r in own)
            low, high = wilson(hits, len(own))
            print(
                f"{kind:7} {row:6} | {100 * hits / len(own):5.1f} [{100 * low:.1f}, {100 * high:.1f}] of {len(own):3}"
                f"        ({PAPER[row][kind]})"
            )
            for why, number in Counter(r["why"] for r in own if not r["good"]).most_common():
                print(f"    {number:3} × {why}")


def main(args: argparse.Namespace) -> None:
    """Run and print; `args` of `synctwin_tables.py`."""
    count = 1 if args.quick else args.count
    rows = [row for row in (args.row or ROWS) if row in ROWS]
    things = [kind for kind in args.thing if kind in half_hidden.THINGS] or list(half_hidden.THINGS)
    profile = args.profile[0] if len(args.profile) == 1 else "ideal"
    report(run_rows(args.out, args.first, count, rows, things, profile), args.first, count, profile)
