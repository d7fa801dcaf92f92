"""Goes with shut fingers to where a push begins, and on from place to place; torques tell how hard they press."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np

from twin_diagram.runs.learning.handling import Tools
from twin_diagram.runs.learning.motion import NoWay
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    above: float = 0.15
    """Height over where a push begins from which fingers come straight down [m]."""

    tick: float = 0.06
    """From one place to the next [s]."""


TUNING = Tuning()


def begun_at(tools: Tools, poses: Array, clearance: float | None = None) -> tuple[Array, Array] | None:
    """Return how a push begins: a way (W, n) to above it, and the line (M, n) down to it [rad]; None: not reached.

    Args:
        tools: of the cell; the hand is empty.
        poses: (M, 4, 4) of the tool on its way; all are to be reached.
        clearance: kept from fixtures all along [m]; None: none, as a push ends at a wall.
    """
    mover, q = tools.mover, tools.cell.commanded
    above = poses[0].copy()
    above[2, 3] += TUNING.above
    for q_above in mover.goals(above, q)[:3]:
        with contextlib.suppress(NoWay):
            down = mover.line(q_above, poses[0], clearance)
            along = mover.through(down[-1], list(poses[1:]))
            if clearance is None or mover.free(along, clearance, standing=False).all():
                return mover.path(q, down[:1]), down
    return None


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
