"""Runs the rows of Table II, goes on where it stopped, and prints them beside the paper's."""

from __future__ import annotations

import argparse
from collections import Counter
from pathlib import Path
from typing import Any

import result_lines
from braking_bench.counting import wilson

from synctwin_truth import avoidance, table_two
from twin_diagram.assets import Asset

ROWS = ("seen", "unseen", "ignore all", "stand still")
QUICK = 6.0
"""Seconds of a run of `--quick`, of which there is one to a row."""
TARGETS = {
    ("seen", "SelfRot"): (98.0, "93.5"),
    ("seen", "EnterTraj"): (95.0, "78.8"),
    ("unseen", "SelfRot"): (95.0, "85.5, NVBlox 50.3"),
    ("unseen", "EnterTraj"): (88.0, "71.5, NVBlox 37.0"),
}
"""Least SR [%], and SyncTwin's."""


class Trials:
    """Rows on disk, one JSON object to a line."""

    def __init__(self, file: Path) -> None:
        self._file, self.rows = file, result_lines.read(file)

    def find(self, **keys: Any) -> dict[str, Any] | None:
        """Return the row that has these, None where it is not there yet."""
        return next((row for row in self.rows if all(row.get(k) == v for k, v in keys.items())), None)

    def add(self, row: dict[str, Any]) -> dict[str, Any]:
        """Write a row."""
        self.rows.append(row)
        result_lines.append(self._file, row)
        return row


def run_rows(
    out: Path, first: int, count: int, rows: list[str], motions: list[str], profile: str, seconds: float
) -> Trials:
    """Run what is not there yet."""
    out.mkdir(parents=True, exist_ok=True)
    trials = Trials(out / "avoidance.jsonl")
    assets = avoidance.library(out / "boxes")
    oracles: dict[str, table_two.Oracle] = {}
    for seed in range(first, first + count):
        for motion in motions:
            draw = avoidance.drawn(seed, motion)
            keys = {"seed": seed, "motion": motion, "profile": profile, "seconds": seconds}
            verdict = trials.find(row="oracle", seed=seed, motion=motion)
            if verdict is None:
                plan = avoidance.scenario_of(draw, assets, "seen")
                if draw.box not in oracles:
                    oracles[draw.box] = table_two.Oracle(plan, Asset.load(assets[draw.box]))
                why = oracles[draw.box].hopeless(draw)
                verdict = trials.add({"row": "oracle", "seed": seed, "motion": motion, "box": draw.box, "why": why})
            if verdict["why"]:
                continue
            alone = trials.find(row="alone", targets=draw.targets, seconds=seconds)
            if alone is None:
                plan = avoidance.scenario_of(draw, assets, "seen", profile, False, seconds)
                found = table_two.run(plan, draw)
                alone = trials.add({"row": "alone", "targets": draw.targets, "seconds": seconds, **found})
            for row in rows:
                if trials.find(row=row, **keys) is not None:
                    continue
                found = table_two.run(avoidance.scenario_of(draw, assets, row, profile, seconds=seconds), draw)
                kept = {"row": row, **keys, "box": draw.box, "alone": alone["visits"], **found}
                trials.add(kept)
                said = f"{found['outcome']} {found['visits']}/{alone['visits']} visits, {len(found['brakes'])} brakes"
                print(f"{row} {motion} {seed} {draw.box}: {said}, {found['cpu_s']:.0f} s {why_of(kept)}", flush=True)
    return trials


def why_of(row: dict[str, Any]) -> str:
    """Return why a run failed, nothing where it did not."""
    if row["elsewhere"]:
        return f"touched something else: {row['elsewhere']}"
    if row["outcome"] != "FA":
        moving = "driven into" if row["speed"] > 0.05 else "run into while standing"
        return f"{row['outcome']}: {moving} by {row['by'].removeprefix('panda_')}"
    if row["visits"] < table_two.LEAST_VISITS * row["alone"]:
        held = "braked" if row["brakes"] else "no way found"
        return f"too few visits ({held})"
    return ""


def report(
    trials: Trials, first: int, count: int, rows: list[str], motions: list[str], profile: str, seconds: float
) -> None:
    """Print the table, failures by cause and what was excluded."""
    seeds = range(first, first + count)
    print(f"seeds {first} to {first + count - 1}, camera 320×240 at 15 Hz, profile {profile}, {seconds:g} s each")
    print("row          motion    | box1      box2      box3      box4      FA/EA/CO | SR % [95 %]  (target, SyncTwin)")
    for row in rows:
        for motion in motions:
            own = [r for r in trials.rows if r["row"] == row and r["motion"] == motion and r["seed"] in seeds]
            own = [r for r in own if (r["profile"], r["seconds"]) == (profile, seconds)]
            if own:
                print(line_of(row, motion, own))
    excluded = [r for r in trials.rows if r["row"] == "oracle" and r["seed"] in seeds and r["motion"] in motions]
    out = [r for r in excluded if r["why"]]
    print(f"excluded: {len(out)} of {len(excluded)} draws" + "".join(
        f"\n  {r['motion']} {r['seed']} {r['box']}: {r['why']}" for r in out
    ))  # fmt: skip


def line_of(row: str, motion: str, own: list[dict[str, Any]]) -> str:
    """Return a row of the table, with its failures by cause below."""
    cells = []
    for box in avoidance.BOXES:
        kinds = Counter(r["outcome"] for r in own if r["box"] == box)
        cells.append(f"{kinds['FA']:2}/{kinds['EA']:2}/{kinds['CO']:2}")
    worth = sum(table_two.score(r, r["alone"]) for r in own)
    low, high = wilson(worth, len(own))
    kinds = Counter(r["outcome"] for r in own)
    aim, paper = TARGETS.get((row, motion), (None, ""))
    told = f"  (≥ {aim:g}; {paper})" if aim is not None else ""
    text = (
        f"{row:12} {motion:9} | " + "  ".join(cells) + f"  {kinds['FA']}/{kinds['EA']}/{kinds['CO']} of {len(own)}"
        f" | {100 * worth / len(own):.1f} [{100 * low:.1f}, {100 * high:.1f}]{told}"
    )
    causes = Counter(why_of(r) for r in own if why_of(r))
    return text + "".join(f"\n    {number:3} × {cause}" for cause, number in causes.most_common())


def main(args: argparse.Namespace) -> None:
    """Run and print; `args` of `synctwin_tables.py`."""
    count, seconds = (1, QUICK) if args.quick else (args.count, avoidance.DURATION)
    rows, motions = args.row or list(ROWS), args.motion or list(avoidance.MOTIONS)
    profile = args.profile[0] if len(args.profile) == 1 else "ideal"
    trials = run_rows(args.out, args.first, count, rows, motions, profile, seconds)
    report(trials, args.first, count, rows, motions, profile, seconds)
