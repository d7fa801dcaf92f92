"""What a joint's gear passes on with all that was fitted: the torque that a gain multiplies.

A gain on what the description has alone would leave friction and rotor as large as they are logged.
"""

from __future__ import annotations

import numpy as np

from twin_diagram.gap.whole_robot.physical_fit import RobotProblem
from twin_diagram.gap.whole_robot.torque_equations import OWN
from twin_diagram.model.effects.actuation import TimeDelay, TorqueConstant
from twin_diagram.signals.arrays import Array

LOGGED = (TorqueConstant.name, TimeDelay.name)
"""Of what stands between logged and applied torque: it loads no joint."""


def transmitted(problem: RobotProblem, z: Array, joint: int) -> Array:
    """Return (N,) torque that a joint transmits with all that was fitted, but for gains, delays and its offset [N·m].

    Args:
        problem: any.
        z: (Z,) its coordinates.
        joint: which.
    """
    sums, first = problem.sums, 10 * problem.n
    fitted = problem.difference(z)[joint]
    fitted[first + OWN.index("bias")] = 0.0
    acting = [np.full(c.size, c.name not in LOGGED) for c in sums.further]
    fitted[first + len(OWN) :] *= np.concatenate([*acting, np.zeros(0)])
    given = sums.records.reduce(lambda r: r.given)[:, joint]
    return np.asarray(given + sums.columns[:, joint, :-1] @ fitted)
