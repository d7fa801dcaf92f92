"""SyncTwin's tables: I, things followed (15 cm along and 90° about each axis); II, obstacles avoided; III, grasps.

    python sims/benchmarks/synctwin_tables.py --table I --first 100000 --count 50
    python sims/benchmarks/synctwin_tables.py --table I --quick
    python sims/benchmarks/synctwin_tables.py --table II --first 100000 --count 100 [--row seen] [--motion SelfRot]
    python sims/benchmarks/synctwin_tables.py --table III --first 100000 --count 100 [--row after] [--thing cup]

Table I: assets are built of 40 pictures at 0.6 m by Stage I, poses 2 mm / 0.2° off, three seeds each; the thing is
then found and followed by `twin-diagram track` before a camera 0.9 m away, elsewhere in each sequence, open or 40 to
60 % hidden. Rows marked c have calibration errors (5 mm / 0.5°, focal 0.3 %, centre 1 pixel, depth 1 %), as their
pictures of Stage I have in K and depth. A thing that is not found counts with its whole displacement. Writes
`OUT/trials.jsonl`, a line per sequence of six motions, and goes on where it stopped. Seeds from 100000 are held back.
Needs the YCB meshes (`$TWIN_DIAGRAM_DATA`, or `../shared/data`).

Table II: the arm goes to and fro between two targets for 15 s while a box spins in its way or comes into it (0.1 to
0.3 m/s), pushed with 15 N at most. The twin has images alone; `seen`: the boxes are in its library. FA, EA (moved
≤ 5 mm, 2°) and CO as in the paper; a run with less than 60 % of the visits that are made without the box scores 0.
Draws that are hopeless are told by `table_two.Oracle`, left out and listed. `ignore all`: no camera, no monitor. Writes
`OUT/avoidance.jsonl`, a line a run, and goes on where it stopped.

Table III: bottle, cup, box and can, 30 to 60 % of them hidden, are grasped at the first attempt, lifted and held for
three seconds in contact simulation; friction (0.4 to 0.9) and mass (up to 1 kg) are drawn and not told. `before`: the
grasp is proposed on the points of one picture; `after`: on the asset, where it is tracked. Success: lifted ≥ 10 cm,
moved in the hand ≤ 10 mm and 10°, nothing else moved > 1 cm. Writes `OUT/grasping.jsonl`, as Table II does.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

from pose_truth.things import thing  # noqa: E402
from real_data import DATA, need  # noqa: E402
from result_lines import append, read  # noqa: E402
from synctwin_truth import avoidance, half_hidden, motions, stage_one, table_one, table_three_rows, table_two_rows  # noqa: E402

from twin_diagram.runs.tracking.track_frames import track_frames  # noqa: E402

ROWS = (("ideal", False), ("d435", True))
"""Profiles, and whether calibration errors are on."""
THINGS = list(dict.fromkeys([*stage_one.THINGS, *half_hidden.THINGS]))
"""Of Tables I and III."""
TARGETS = {("ideal", False): (99.5, 99.0), ("ideal", True): (99.0, 98.0), ("d435", False): (98.0, 96.0)}
TARGETS["d435", True] = (96.0, 92.0)
"""Translation and rotation [%] by profile and whether hidden."""
PAPER = {
    False: {"box": (95.1, 78.3), "cup": (96.3, 88.7), "bottle": (94.8, 90.4), "ketchup": (94.7, 82.0)},
    True: {"box": (85.2, 70.4), "cup": (87.7, 78.2), "bottle": (90.3, 82.6), "ketchup": (91.5, 76.3)},
}
"""SyncTwin's Table I [%]."""
ASSET_SEEDS = 3


def run_one(out: Path, name: str, profile: str, wrong: bool, hidden: bool, seed: int, views: int) -> dict[str, Any]:
    """Build the asset, if need be, film a sequence, track it and return its scores."""
    library = out / "assets" / f"{profile}{'c' if wrong else ''}_{views}" / str(seed % ASSET_SEEDS) / name
    stage_one.built(library, name, profile, views, seed % ASSET_SEEDS, wrong, DATA)
    with tempfile.TemporaryDirectory() as aside:
        scene, found = Path(aside) / "scene", Path(aside) / "tracked"
        true = thing(stage_one.THINGS[name], DATA)
        stops, shares = motions.film(scene, true, profile, hidden, wrong, seed)
        begin = time.process_time()
        track_frames(library, scene, found, say=lambda text: None)
        spent = time.process_time() - begin
        poses = table_one.tracked(found / "objects.jsonl", name)
    return {
        "thing": name, "profile": profile, "wrong": wrong, "hidden": hidden, "seed": seed, "views": views,
        "errors": table_one.motion_errors(stops, poses), "off": table_one.off_true(stops, poses),
        "share": float(np.mean(shares)), "seconds": spent,
    }  # fmt: skip


def report(rows: list[dict[str, Any]]) -> None:
    """Print the table, and the cell that is farthest below its target."""
    print(
        "profile  hidden thing    | trans  rot [%] (target, SyncTwin)          seeds      motions  off>10°  s/picture"
    )
    worst: list[tuple[float, str]] = []
    for profile, wrong in ROWS:
        for hidden in (False, True):
            for name in stage_one.THINGS:
                own = [r for r in rows if (r["profile"], r["hidden"], r["thing"]) == (profile, hidden, name)]
                if not own:
                    continue
                both = [100 * a for a in table_one.accuracy(np.array([r["errors"] for r in own]))]
                aim, paper = TARGETS[profile, hidden], PAPER[hidden][name]
                flips = np.mean(np.array([r["off"] for r in own]) > np.radians(10))
                seeds = sorted(r["seed"] for r in own)
                pace = np.sum([r["seconds"] for r in own]) / len(own) / (6 * motions.STEPS + 1)
                line = (
                    f"{profile + (' c' if wrong else ''):8} {'40–60 %' if hidden else 'open':7} {name:7} | "
                    f"{both[0]:5.1f} {both[1]:5.1f} (≥ {aim[0]}/{aim[1]}, {paper[0]}/{paper[1]})  "
                    f"{seeds[0]}–{seeds[-1]} {6 * len(own):5}  {100 * flips:5.1f} %  {pace:.3f}"
                )
                print(line)
                worst.append((min(both[0] - aim[0], both[1] - aim[1]), line))
    if worst:
        print(f"worst cell, {min(worst)[0]:+.1f} beside its target: {min(worst)[1]}")


def main() -> None:
    """Run what is not there yet and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--table", choices=["I", "II", "III"], default="I")
    parser.add_argument("--first", type=int, default=100_000, help="first seed; smaller ones are for training")
    parser.add_argument("--count", type=int, default=50, help="sequences of each cell, draws of each row")
    parser.add_argument("--out", type=Path, default=Path("out/synctwin_tables"))
    parser.add_argument("--quick", action="store_true", help="one sequence a cell, assets of 10 views")
    parser.add_argument("--views", type=int, default=40, help="pictures of Stage I")
    parser.add_argument("--thing", nargs="+", choices=THINGS, default=THINGS)
    parser.add_argument("--profile", nargs="+", choices=[p for p, _ in ROWS], default=[p for p, _ in ROWS])
    rows_of_both = [*table_two_rows.ROWS, *table_three_rows.ROWS]
    parser.add_argument("--row", nargs="+", choices=rows_of_both, help="of Table II or III")
    parser.add_argument("--motion", nargs="+", choices=list(avoidance.MOTIONS), help="of Table II")
    args = parser.parse_args()
    if args.table != "I":
        (table_two_rows if args.table == "II" else table_three_rows).main(args)
        return
    need("ycb")
    count, views = (1, 10) if args.quick else (args.count, args.views)
    args.out.mkdir(parents=True, exist_ok=True)
    file = args.out / "trials.jsonl"
    rows = read(file)
    wanted = range(args.first, args.first + count)
    keys = ("thing", "profile", "hidden", "seed", "views")
    done = {tuple(row[key] for key in keys) for row in rows}
    for seed in wanted:
        for profile, wrong in ROWS:
            for hidden in (False, True):
                for name in stage_one.THINGS:
                    if name not in args.thing:
                        continue
                    if profile not in args.profile or (name, profile, hidden, seed, views) in done:
                        continue
                    row = run_one(args.out, name, profile, wrong, hidden, seed, views)
                    rows.append(row)
                    append(file, row)
                    said = [*(f"{1000 * e:.1f}" for e in row["errors"][:3]), "mm"]
                    said += [*(f"{np.degrees(e):.1f}" for e in row["errors"][3:]), "°"]
                    print(f"{profile} {name} {'hidden' if hidden else 'open'} {seed}:", *said, flush=True)
    report([row for row in rows if row["seed"] in wanted and row["views"] == views])


if __name__ == "__main__":
    main()
