"""Replays the measured runs of a KUKA KR300 through the replay station and the EKF, and shows what its model lacks.

The model is the published rigid links and rotor inertias alone: no payload, no counterbalance, no friction. What is
left of the measured torque is printed per joint, on the motor's side of the gear, twice: from the log's own positions,
and from the state that the EKF makes of the replayed messages.

    python sims/replay_kuka.py
    python sims/replay_kuka.py --run B --out out/kuka.json

The data folder is `$TWIN_DIAGRAM_DATA`, or `../shared/data` beside the checkout.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from kuka_kr300.runs import EXPECTED, JOINTS, data_folder, residuals

from twin_diagram import TwinError


def main() -> int:
    """Parse the command line, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", choices=["A", "B"], action="append", help="which run (default: both)")
    parser.add_argument("--out", type=Path, help="also write the figures as JSON")
    arguments = parser.parse_args()
    try:
        folder = data_folder()
        result: dict[str, Any] = {}
        print("residual torque, motor side, N·m RMS (10 Hz zero-phase low-pass, 0.3 s cut at each end)")
        for run in arguments.run or ["A", "B"]:
            found = residuals(run, folder)
            print(f"run {run}" + " " * 9 + "".join(f"{joint:>9}" for joint in JOINTS))
            for name, values in {"expected": np.array(EXPECTED[run]), **found}.items():
                print(f"  {name:<13}" + "".join(f"{value:9.3f}" for value in values))
            result[run] = {name: values.tolist() for name, values in found.items()}
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if arguments.out:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(json.dumps(result, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
