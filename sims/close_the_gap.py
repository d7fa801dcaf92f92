"""Drives a robot that the twin does not know, finds what its model lacks, corrects it, and drives again.

The robot is an iiwa 7 in MuJoCo (`twin_diagram/station/mujoco.py`): another integrator, another law of friction, its
own drive and sensors, behind the ports of every station. A payload and dry friction are hidden in it. The twin has the
published description alone.

    1. two runs with the description's model: one to find the gap in, one held out
    2. `twin-diagram gap` on their logs: names, corrected model, report
    3. a task, driven with the torques that each model asks for: how far off is the twin's prediction, and the arm?

    python sims/close_the_gap.py --out out/close_the_gap
    python sims/close_the_gap.py --hide friction
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from mujoco_robot.comparison import Comparison
from mujoco_robot.driving import SECRETS, URDF, drive, exploring, robot, task

from twin_diagram import Model, TwinError, run_gap, write_log
from twin_diagram.gap.correction.named_effects import sentence_of
from twin_diagram.gap.report.words import headline


def close(secret: str, seed: int, out: Path) -> None:
    """Close the gap in three acts."""
    given = Model.load(URDF)
    print("driving the robot with the description's model")
    motions = {"fit": exploring(20.0, 10 * seed), "holdout": exploring(12.0, 10 * seed + 1)}
    for run, (name, motion) in enumerate(motions.items()):
        write_log(drive(robot(secret, seed, run), given, motion), out / f"{name}.csv")
    print("looking for what the model lacks")
    gap = run_gap(URDF, [out / "fit.csv"], out / "holdout.csv", out / "gap", lambda text: print(f"  {text}"))
    print(f"{headline(gap.verdict)} See {out / 'gap' / 'report.html'}")
    for finding in gap.verdict.findings:
        print(f"  {sentence_of(finding, gap.given.prismatic)} ({finding.confidence:.0%} sure)")
    print("driving a task with each model")
    corrected = Model.load(out / "gap" / "model")  # as anyone else would load it
    first, again = (drive(robot(secret, seed, k), model, task(seed)) for k, model in ((2, given), (3, corrected)))
    found = Comparison(given, corrected, first, again)
    found.picture(out / "close_the_gap.png", headline(gap.verdict))
    print(f"{found.table()}\nsee {out / 'close_the_gap.png'}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hide", choices=sorted(SECRETS), default="both", help="what is hidden (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of motions and noise (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("out/close_the_gap"), help="folder (default: %(default)s)")
    arguments, begin = parser.parse_args(), time.perf_counter()
    try:
        close(arguments.hide, arguments.seed, arguments.out)
    except TwinError as error:
        parser.exit(2, f"error: {error}\n")
    print(f"{time.perf_counter() - begin:.0f} s in all")
