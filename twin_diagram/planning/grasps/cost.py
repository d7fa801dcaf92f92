"""What a grasp costs; lower is better. Each term is about 1 where it is bad and 0 where it is as good as can be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.planning.grasps.closing import Closing
from twin_diagram.planning.grasps.gripper import Gripper
from twin_diagram.planning.grasps.slab import Flags
from twin_diagram.planning.grasps.target import GraspTarget
from twin_diagram.signals.arrays import Array

GRAVITY = 9.81
"""[m/s²]"""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module: weights of the terms, by what a grasp that is bad in one alone may be traded for."""

    antipodal: float = 1.0
    """Of the contacts' alignment, the thesis's term; the others are weighed against it."""

    torque: float = 0.8
    """Of the weight's torque as a share of what the pads hold: from 1 on the object turns in the fingers."""

    width: float = 0.15
    """Of the width as a share of the opening: breaks ties only, a wide grasp is sound as long as it has room."""

    clearance: float = 0.3
    """Of the room that lacks beside the fingers and over the table."""

    push: float = 0.4
    """Of the way by which closing pushes the object aside: it may turn, tip or meet something."""

    pushed: float = 0.020
    """Way that counts as one [m]: half of what a hand's open finger is away from its middle."""

    unseen: float = 0.6
    """Of a contact that the camera did not see: worse than any that it saw within the friction cone."""

    off_pad: float = 0.2
    """Of contacts at the pads' edges instead of their middles, where a pose that is a little off loses them."""

    misses: float = 1.5
    """Of the share of samples of the object's pose in which the grasp fails: outweighs all else."""

    room: float = 0.010
    """Room beside fingers and over a table from which on more is no better [m]."""


TUNING = Tuning()


def antipodal_cost(antipodal: Array) -> Array:
    """Return the cost (K,) of normals off the closing axis: 0 if all are along it, 1 if all are square to it.

    Equations 4.1 and 4.2 of the thesis in *Scalable Real2Sim*, whose signs are lost in print. They sum over the points
    p_i in the closing region C the squared part n_y² of the normal along the closing axis (4.1), then exp(n_y²), by the
    number of points and times a weight (4.2); grasps are ranked by ascending cost, and what is wanted are normals
    along the axis. So the sum must enter with a minus: cost = -W/|C| Σ exp(n_y²). It is told here as
    1 - 1/|C| Σ (exp(n_y²) - 1)/(e - 1), which ranks alike and lies in [0, 1]. The number divided by is that of
    C's points: then neither how dense the cloud is nor how much of the object lies elsewhere counts.

    Args:
        antipodal: (K,) the mean, as of `Closing`.
    """
    return np.asarray(1.0 - antipodal)


def weight_torque(target: GraspTarget, gripper: Gripper, R: Array, held: Array) -> Array:
    """Return the weight's torque about the axis through the pads (K,), as a share of what their friction holds.

    Where it is known which way is up, it is the torque m g |((c - h) × up)·y|, else the largest of all directions.
    Two pads of area A pressed by F hold a torque of about 2 μ F r with r = 2/3 √(A/π).

    Args:
        target: with mass and centre of mass; without either there is no torque.
        gripper: with force, friction and pads.
        R: (K, 3, 3) axes of the poses in O.
        held: (K, 3) the middle between the contacts in O [m].
    """
    if target.mass is None or target.centre is None:
        return np.zeros(len(R))
    lever, y = target.centre - held, R[:, :, 1]
    if target.up is None:
        arm = np.linalg.norm(np.cross(lever, y), axis=1)
    else:
        arm = np.abs(np.einsum("ki,ki->k", np.cross(lever, target.up), y))
    radius = 2.0 / 3.0 * np.sqrt(gripper.pad_length * gripper.pad_width / np.pi)
    return np.asarray(target.mass * GRAVITY * arm / (2.0 * gripper.friction * gripper.force * radius))


def terms(
    target: GraspTarget, gripper: Gripper, R: Array, p: Array, closing: Closing, room: Array, seen: Flags
) -> dict[str, Array]:
    """Return the weighted terms (K,) of the poses' cost by name; their sum is the score.

    Args:
        target: the object.
        gripper: with its pads.
        R: (K, 3, 3) axes in O.
        p: (K, 3) origins in O [m].
        closing: what the poses hold.
        room: (K,) over the table [m].
        seen: (K, 2) which contacts the camera saw.
    """
    # Of two contacts, one of which nobody saw, only the other one's place is known.
    share = np.where(seen.any(axis=1, keepdims=True), seen, True).astype(float)
    share /= share.sum(axis=1, keepdims=True)
    held_G = np.einsum("ks,ksi->ki", share, closing.contact) * np.array([1.0, 0.0, 1.0])
    held = p + np.einsum("kij,kj->ki", R, held_G)
    sides = (gripper.opening_most - closing.width) / 2 - np.abs(closing.middle)
    lacks = 1.0 - np.clip(np.minimum(sides, room) / TUNING.room, 0.0, 1.0)
    pad_middle = (gripper.pad_front + gripper.pad_back) / 2
    off = np.abs(held_G[:, 2] - pad_middle) / (gripper.pad_length / 2)
    off = np.maximum(off, np.abs(held_G[:, 0]) / (gripper.pad_width / 2))
    return {
        "antipodal": TUNING.antipodal * antipodal_cost(closing.antipodal),
        "torque": TUNING.torque * weight_torque(target, gripper, R, held),
        "width": TUNING.width * closing.width / gripper.opening_most,
        "clearance": TUNING.clearance * lacks,
        "push": TUNING.push * np.abs(closing.middle) / TUNING.pushed,
        "off_pad": TUNING.off_pad * np.minimum(off, 1.0) ** 2,
        "unseen": TUNING.unseen * (~seen).sum(axis=1),
    }
