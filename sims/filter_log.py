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

import numpy as np

from twin_diagram.errors import TwinError
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms
from twin_diagram.estimation.dynamics.parameter_blocks import BLOCKS
from twin_diagram.estimation.filter.arm_messages import TUNING as ARM_MESSAGES
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.logs import Log, read_log, write_log
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import load_model_for
from twin_diagram.scenario import Filter


def follow(model: Model, log: Log, learn: Sequence[str]) -> tuple[Ekf, np.ndarray]:
    """A filter that has seen the whole log, and its x̂ = [q, v] at each sample (N, 2n).

    Args:
        model: with the log's joints, in its order.
        log: checked.
        learn: names of what is learnt: see `parameter_blocks.BLOCKS`.
    """
    ekf = Ekf(ArmTerms.from_model(model), Filter(rate=1.0 / log.period, parameters=list(learn)))
    tau, states = log.motor_torque, np.empty((len(log), 2 * len(model.joints)))
    for k, t in enumerate(log.time):
        if log.velocity is not None:
            ekf.observe(log.position[k], log.velocity[k], tau[k], t)
        elif k == 0 or t - log.time[k - 1] > ARM_MESSAGES.longest_gap:
            after = min(k + 1, len(log) - 1)
            v = (log.position[after] - log.position[k]) / max(log.time[after] - t, 1e-6)
            ekf.start(log.position[k], v, tau[k], t)
        else:
            ekf.predict(0.5 * (tau[k - 1] + tau[k]), t - log.time[k - 1])
            ekf.update("encoder", log.position[k], t)
        states[k] = ekf.belief.x[: states.shape[1]]
    return ekf, states


def main(arguments: Sequence[str] | None = None) -> int:
    """Parses the command line, prints a line per parameter."""
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
        ekf, states = follow(model, log, given.learn)
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
