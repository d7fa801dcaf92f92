"""Sets learned assets beside the true objects: both swing in a pinch, are pushed, tilted and let fall, equally rough.

    python sims/benchmarks/asset_check.py out/real2sim/000000 out/real2sim/000001

Takes folders of `real2sim_tables.py`, beside which it noted where everything truly was. Prints a row an object, then
medians and 90th percentiles beside what is aimed at; writes `asset_check.json` into each folder. "Own push" is how
differently the true object itself comes to lie once its feet are uneven by a tenth of a millimetre: which three of
them carry decides how it turns, and no asset can be told to be nearer than that.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

SIMS = Path(__file__).resolve().parent
sys.path[:0] = [str(SIMS), str(SIMS.parents[1])]

from real2sim_truth.asset_trials import Subject, fallen, period, pushed, task_of, toppling  # noqa: E402
from real2sim_truth.scores import Matched, matched, registered, sampled, triangles  # noqa: E402

from twin_diagram import TwinError, load_scenario  # noqa: E402
from twin_diagram.runs.learning.record import SCENARIO, STATE, LearningError  # noqa: E402

AIMS = {"swing %": 3.0, "push mm": 5.0, "push °": 3.0, "tilt °": 2.0, "fall mm": 5.0}
"""Medians that are aimed at."""
UNEVEN = 1e-4
"""Standard deviation of a true object's feet [m], about that of learned surfaces."""


def beside_truth(each: Matched, folder: Path) -> dict[str, Any]:
    """Return how differently a learned asset and the true object behave."""
    assert each.true is not None and each.X_WO is not None
    true = each.true
    X_OA = registered(*sampled(triangles(folder / "visual.obj"), 20000), true, each.X_WO)
    task = task_of(true.corners, true.centre)
    truth = Subject(true.folder, np.eye(4), (true.mass, true.centre, true.inertia))
    asset = Subject(folder, X_OA)
    row: dict[str, Any] = {"object": each.one["name"], "true": true.name}
    row["swing %"] = 100.0 * abs(period(asset, task) / period(truth, task) - 1.0)
    X = pushed(truth, task)
    trials = {"push": (X, pushed(asset, task)), "own push": (X, pushed(replace(truth, uneven=UNEVEN), task))}
    for name, (X, Y) in {**trials, "fall": (fallen(truth, task), fallen(asset, task))}.items():
        row[f"{name} mm"] = 1e3 * float(np.linalg.norm(X[:2, 3] - Y[:2, 3]))
        turn = X[:3, :3].T @ Y[:3, :3]
        row[f"{name} °"] = float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))))
        row[f"{name} face"] = bool(X[2, :3] @ Y[2, :3] > 0.9)
    row["tilt °"] = float(np.degrees(abs(toppling(truth, task) - toppling(asset, task))))
    return row


def main() -> int:
    """Parse the command line and run."""
    logging.getLogger("drake").setLevel(logging.ERROR)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path, help="folders of runs")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    try:
        for out in arguments.runs:
            if not (out / STATE).is_file():
                raise LearningError(f"{out}: has no run of real2sim_tables.py")
            scenario = load_scenario(str(out / SCENARIO))
            found = [each for each in matched(scenario, out) if each.true is not None]
            own = [beside_truth(each, out / "library" / each.one["name"]) for each in found]
            (out / "asset_check.json").write_text(json.dumps(own, indent=1))
            rows += own
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for row in rows:
        print(
            "  ".join(f"{name} {value:.2f}" if isinstance(value, float) else f"{value}" for name, value in row.items())
        )
    for name, aim in {**AIMS, "own push mm": None, "own push °": None}.items():
        values = [row[name] for row in rows]
        if values:
            print(
                f"{name:11s} median {np.median(values):6.2f}  90 % within {np.quantile(values, 0.9):6.2f}"
                + ("" if aim is None else f"  aim {aim:g}")
            )
    print(f"the same face: {sum(row['fall face'] for row in rows)} of {len(rows)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
