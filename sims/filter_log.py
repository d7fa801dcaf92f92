"""Runs the filter over a measured log of any arm, without any Diagram, and prints what it learnt.

    python sims/filter_log.py --model arms/panda_hand.urdf --log run.csv
    python sims/filter_log.py --model ur5e.urdf --log run.csv --learn payload coulomb_friction viscous_friction

Where the log has no velocities, the filter goes by the encoders alone.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from twin_diagram import Log, TwinError, read_log, write_log
from twin_diagram.estimation.dynamics.parameter_blocks import BLOCKS
from twin_diagram.model import load_model_for
from twin_diagram.runs import filter_log


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, print a line per parameter."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", required=True, help="URDF, SDF, MJCF or the folder of a corrected model")
    parser.add_argument("--log", required=True, help="measured log")
    parser.add_argument("--learn", nargs="+", default=["payload"], metavar="EFFECT", help=f"of {', '.join(BLOCKS)}")
    parser.add_argument("--out", type=Path, help="also write the filtered states as a log")
    given = parser.parse_args(arguments)
    try:
        model, log, warnings = load_model_for(read_log(given.log), given.model)
        for warning in warnings:
            print(f"warning: {warning.message}", file=sys.stderr)
        ekf, states = filter_log(model, log, given.learn)
        for assumption in ekf.terms.assumptions():
            print(f"note: {assumption}", file=sys.stderr)
        if given.out:
            n = len(model.joints)
            kept = Log(log.time, model.joints, states[:, :n], velocity=states[:, n:], torque=log.motor_torque)
            write_log(kept, given.out)
    except TwinError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    for standing in ekf.standings(model.joints):
        print(standing)
    return 0


if __name__ == "__main__":
    sys.exit(main())
