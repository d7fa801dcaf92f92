"""Short moves of the tool that are straight in space: down to a grasp, up from it. Pure functions on arrays.

A straight line in joint angles leaves the plumb line by millimetres over a hand's height, and fingers that fit an
object closely touch it. Here the tool keeps to its line, and is on it by the middle of the way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from twin_diagram.planning.collision.chain import Chain
from twin_diagram.planning.paths.inverse_kinematics import IkTuning, damped_step, pose_error
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them; chosen by hand."""

    shortest: float = 0.02
    """Shorter moves are straight enough [m]: over 2 cm joint angles leave the line by half a millimetre."""

    longest: float = 0.15
    """Longer ones go by joint angles, which is quicker [m]: fingers and what they hold come within this of others."""

    turn: float = 0.2
    """A tool that turns by more than this is not lowered [rad]."""

    piece: float = 0.025
    """Between two way points [m]: a quarter of a millimetre off the line between."""

    beside: float = 0.4
    """Moves that go sideways by more than this share of what they go along the tool are straight from the start."""

    iterations: int = 12
    """Gauss–Newton steps to a way point: from the one before, four do."""


TUNING = Tuning()


def straight_way(chain: Chain, q: Array, X_WG: Array, lower: Array, upper: Array) -> Array:
    """Return way points that take the tool straight to a goal near by.

    Args:
        chain: the arm.
        q: (n,) where it is [rad].
        X_WG: (4, 4) the tool's goal.
        lower: (n,) limits [rad], may be infinite.
        upper: (n,) likewise.

    Returns:
        (W, n), the last at the goal; W = 0: it is too far or too near, or no straight way lies within the limits.
    """
    X_WT = chain.tool(chain.place(q[None]))[0]
    none = np.zeros((0, len(q)))
    off = pose_error(X_WT[None], X_WG)[0]
    length = float(np.linalg.norm(off[3:]))
    if not TUNING.shortest <= length <= TUNING.longest or np.linalg.norm(off[:3]) > TUNING.turn:
        return none
    points: list[Array] = []
    tuning = IkTuning()
    margin = np.minimum(tuning.limit_margin, 0.1 * (upper - lower))
    for target in _stations(X_WT, X_WG, off):
        reached = _to(chain, points[-1] if points else q, target, tuning)
        if reached is None or ((reached < lower + margin) | (reached > upper - margin)).any():
            return none
        points.append(reached)
    return np.array(points)


def _stations(X_WT: Array, X_WG: Array, off: Array) -> Array:
    """Return (W, 4, 4) tool poses from one pose to another, whose difference is `off` (6,), see `pose_error`."""
    count = int(np.ceil(np.linalg.norm(off[3:]) / TUNING.piece))
    done = np.arange(1, count + 1)[:, None] / count
    along = X_WG[:3, 2] * (X_WG[:3, 2] @ off[3:])
    sideways = off[3:] - along
    soon = np.minimum(2.0 * done, 1.0)
    if np.linalg.norm(sideways) > TUNING.beside * np.linalg.norm(along):
        soon = done
    result = np.tile(np.eye(4), (count, 1, 1))
    result[:, :3, :3] = Rotation.from_rotvec(soon * off[:3]).as_matrix() @ X_WT[:3, :3]
    result[:, :3, 3] = X_WT[:3, 3] + done * along + soon * sideways
    return result


def _to(chain: Chain, q: Array, X_WG: Array, tuning: IkTuning) -> Array | None:
    """Return the joint angles next to `q` (n,) that put the tool at a pose (4, 4); None where there are none."""
    damping = tuning.damping * 1e-3 * np.eye(6)
    for _ in range(TUNING.iterations):
        placement = chain.place(q[None])
        error = pose_error(chain.tool(placement), X_WG)
        if np.linalg.norm(error[0, :3]) < tuning.rotation_tolerance and (
            np.linalg.norm(error[0, 3:]) < tuning.position_tolerance
        ):
            return q
        step = damped_step(chain.tool_jacobian(placement), error, damping)[0]
        q = q + step * min(1.0, tuning.step / max(float(np.abs(step).max()), 1e-12))
    return None
