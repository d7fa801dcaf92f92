"""Goes with shut fingers from place to place and feels by the arm's torques how hard they press."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.runs.learning.handling import Tools
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    tick: float = 0.06
    """From one place to the next [s]."""


TUNING = Tuning()


def pressed(tools: Tools, X_WT: Array, longer: float = 1.0) -> Array:
    """Go straight to a pose (4, 4) of the tool, and return the force (3,) with which it presses in W on the way [N].

    Args:
        tools: of the cell; the fingers are shut.
        X_WT: a few millimetres off.
        longer: times the usual time that is taken for it.

    Raises:
        NoWay: the arm does not reach it; it is at rest.
    """
    line = tools.mover.through(tools.cell.commanded, [X_WT])
    with tools.cell.recording() as messages:
        tools.cell.follow(np.array([0.0, longer * TUNING.tick]), line)
    q = tools.cell.q
    own = tools.model.inverse_dynamics(q[None], np.zeros((1, len(q))), np.zeros((1, len(q))))[0]
    J = np.asarray(tools.model.tool_jacobian(q))[3:]  # linear, in W
    return np.asarray(np.linalg.lstsq(J.T, np.mean(messages.torque, axis=0) - own, rcond=None)[0])
