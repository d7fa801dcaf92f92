"""Holds `twin-diagram gap` on measured logs of real arms against least squares that are told the structure.

    python sims/benchmarks/real_rows.py                          # all rows; figures also in OUT/rows.jsonl
    python sims/benchmarks/real_rows.py --only lwr4-cut panda-cut
    python sims/benchmarks/real_rows.py --short --sided          # fits of five to eight seconds
    python sims/benchmarks/real_rows.py --references             # without running `gap`

Per row and joint: held-out residual torque, RMS N·m in the contract's band (on the motor's side for the KR300), of the
description, of `classical` (all links' ten parameters by a weak ridge, viscous, Coulomb, offset, rotor per joint), of
`physical` (the same with positive definite pseudo-inertias drawn to the description, frictions and rotors not negative)
and of `gap`; then gap over the others. The held-out run of `lwr4` repeats the fitted one's motion, so does `panda`'s:
only the cut rows prove anything about other motion. Where both were run, torques of the models corrected from the two
descriptions of the LWR4+ are compared on run 2. Data: `$TWIN_DIAGRAM_DATA`, or `../shared/data`.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

from real_data import need  # noqa: E402
from real_references import rows, table  # noqa: E402


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    every = [row.name for row in (*rows.ROWS, *rows.SHORT_ROWS)]
    parser.add_argument("--only", nargs="+", choices=every, help="these rows alone")
    parser.add_argument("--short", action="store_true", help="fits of a few seconds instead")
    parser.add_argument("--references", action="store_true", help="leave `gap` out")
    parser.add_argument(
        "--sided", action="store_true", help="tell `gap` the side that each row's torque is measured on"
    )
    parser.add_argument("--out", type=Path, default=Path("out/real_rows"), help="folder (default: %(default)s)")
    given = parser.parse_args(arguments)
    for folder in sorted({row.model.split("/")[0] for row in rows.chosen(given.only, given.short)}):
        need(folder)
    given.out.mkdir(parents=True, exist_ok=True)
    with (given.out / "rows.jsonl").open("a", encoding="utf-8") as file:
        for row in rows.chosen(given.only, given.short):
            found = table.references(row, given.out / row.name)
            gap = None if given.references else table.run_gap(row, given.out / row.name, given.sided)
            print(table.text(row, found, gap), flush=True)
            figures = {name: list(values) for name, values in found.items()}
            file.write(json.dumps({"row": row.name, **figures, "gap": gap}) + "\n")
            file.flush()
    if both := table.agreement_text(given.out):
        print(both)
    return 0


if __name__ == "__main__":
    sys.exit(main())
