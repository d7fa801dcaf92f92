"""Weigh objects with hidden loads by a simulated arm's torques, and print the targets beside what came out.

    python sims/benchmarks/weighing_tables.py --quick            # 12 objects, some five minutes on one core
    python sims/benchmarks/weighing_tables.py --first 0 --count 100
    python sims/benchmarks/weighing_tables.py --report

A rigid iiwa 7 with a WSG-50 moves boxes, cans, angles, bottles and cups of 0.1 to 1.5 kg, a third of them even, a third
with a lump hidden inside, a third with one end denser, for 10 s with the object and 10 s without. Torques at 200 Hz,
with white noise of 0.05 and 0.2 N·m, gain errors N(0, 1 %), biases N(0, 0.2 N·m) and frictions that nobody tells.
Numerical: nothing slips, there is no contact; shapes are off by a millimetre, the object's place in the hand by 0.5 mm.
Beside it: no gain calibration, no shape prior, the published excitation (5 harmonics of 0.1 Hz), a wide motion of the
empty arm beforehand (20 s) that calibrates it in addition, and gains that are told exactly: the most that could help.

Seeds are `--first` to `--first` + `--count` − 1; those below 100 000 are for training. Writes a line per object and
way to `OUT/results.jsonl`, goes on where it stopped, and `OUT/report.txt`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from result_lines import append, read
from weighing_truth.report import report
from weighing_truth.trial import run

QUICK = 12


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, help=f"objects; 60, or {QUICK} where it is to be quick")
    parser.add_argument("--quick", action="store_true", help="excitations looked for less long")
    parser.add_argument("--torque-side", choices=["motor", "link"], default="link")
    parser.add_argument("--out", type=Path, default=Path("out/weighing_tables"))
    parser.add_argument("--report", action="store_true", help="only print what is there")
    given = parser.parse_args()
    out = given.out / (given.torque_side + ("_quick" if given.quick else ""))
    out.mkdir(parents=True, exist_ok=True)
    path = out / "results.jsonl"
    wanted = range(given.first, given.first + (given.count or (QUICK if given.quick else 60)))
    done = {row["seed"] for row in read(path) if row.get("last")}
    for seed in wanted if not given.report else ():
        if seed in done:
            continue
        rows = run(seed, given.torque_side, given.quick)
        rows[-1]["last"] = True
        for row in rows:
            append(path, row)
        print(f"seed {seed}: {rows[0].get('failed') or rows[0]['kind'] + ', ' + rows[0]['load']}", flush=True)
    rows = list({(row["seed"], row.get("noise"), row.get("way")): row for row in read(path)}.values())
    text = report([row for row in rows if row["seed"] in wanted or given.report]) if rows else "nothing there"
    (out / "report.txt").write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
