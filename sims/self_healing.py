"""The twin heals itself: a robot changes while it works, and the twin notices, finds out, and mends its model.

The robot is an iiwa 7 in MuJoCo (`twin_diagram/station/mujoco.py`) behind the ports of every station. It starts as its
description says. After a while it carries a payload and two of its joints go dry; nobody tells the twin.

    1. the drift monitor raises an alarm
    2. when the log since the alarm is long enough, `twin-diagram gap` runs on it, in a process of its own
    3. the corrected model is taken over by filter, monitor and planner; the loop never stops

Beside it run the same filter and monitor on the same messages with the model as it was: what adapting alone can do.
Shown is how far off either is with where each joint, and the hand, will be 0.2 s later, under the torques that were
then measured.

    python sims/self_healing.py --out out/self_healing
    python sims/self_healing.py --quick
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

from mujoco_robot.healing import QUICK, heal
from mujoco_robot.healing_report import Plan

from twin_diagram import TwinError


def main() -> int:
    """Parse the command line and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1, help="of motion and noise (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="a shorter run")
    parser.add_argument("--out", type=Path, default=Path("out/self_healing"), help="folder (default: %(default)s)")
    arguments = parser.parse_args()
    begin = time.perf_counter()
    try:
        run = heal(QUICK if arguments.quick else Plan(), arguments.seed, arguments.out)
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    run.picture(arguments.out / "self_healing.png")
    figures = {who: {phase: round(1e3 * run.rms(who, phase)[0], 3) for phase in run.spans} for who in run.error}
    (arguments.out / "self_healing.json").write_text(json.dumps({"hand_rms_mm": figures}, indent=2) + "\n")
    print(run.table())
    print(f"see {arguments.out / 'self_healing.png'} and {arguments.out / 'events.jsonl'}")
    print(f"{time.perf_counter() - begin:.0f} s in all")
    return 0


if __name__ == "__main__":
    sys.exit(main())
