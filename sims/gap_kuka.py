"""Finds what the model of a KUKA KR300 lacks, from one measured run, and holds it against another.

The given model is the published rigid links alone. Known to be there, and not told: a payload of some 150 kg, a
nitrogen cylinder whose torque is a curve of joint 2's angle, the motors' rotors, friction on all joints. The table
compares what is left of run B's torque, on the motor's side of the gear, with the figures that the authors of the data
reached with a model of their own, whose structure they knew.

    python sims/gap_kuka.py --out out/gap_kuka

The data folder is `$TWIN_DIAGRAM_DATA`, or `../shared/data` beside the checkout.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from kuka_kr300.gap_table import show_motor_side
from kuka_kr300.runs import data_folder

from twin_diagram import TwinError, run_gap
from twin_diagram.gap.correction.named_effects import sentence_of
from twin_diagram.gap.report.words import headline


def main() -> int:
    """Parse the command line, print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/gap_kuka"), help="folder (default: %(default)s)")
    arguments = parser.parse_args()
    begin = time.perf_counter()
    try:
        folder = data_folder()
        gap = run_gap(
            folder / "kr300.urdf",
            [folder / "trajectory_A.csv"],
            folder / "trajectory_B.csv",
            arguments.out,
            lambda text: print(text, file=sys.stderr),
        )
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{headline(gap.verdict)} ({gap.verdict.verdict}, {time.perf_counter() - begin:.0f} s)")
    for finding in gap.verdict.findings:
        print(f"  {finding.confidence:4.0%}  {sentence_of(finding, gap.given.prismatic)}")
    show_motor_side(gap, arguments.out)
    print(f"see {arguments.out / 'report.html'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
