"""Keeps what a simulated hand holds from creeping out of it by the way in which time goes on in steps.

A step of the plant turns joints by Δq = dt q̇, which takes the hand along an arc. A free body goes along the tangent: by
dt times the velocity that contact gave it, which is that of the hand where the step began. So a body that rests in the
hand is left outside by the arc's sagitta, ½ ω² r dt² each step: 1 to 2 mm/s half a metre off a joint that turns at 2
rad/s, at steps of 2.5 ms, and in proportion to the step, whatever friction and contact's solver are. `left_behind`
says by how much; it is put back after each step. Velocities stay, and so does all true slipping.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, Frame, JacobianWrtVariable, Joint
from pydrake.systems.framework import Context

from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    near: float = 0.3
    """Farther from the hand a body is not in it [m]."""

    along: float = 0.05
    """A body goes with the hand whose speed is the hand's there within this [m/s]: faster it slips, and is let be. What
    lies still beside a hand that is as slow would be moved by less than a micrometre a second."""

    coming: float = 0.1
    """As much farther than `near` a body may be before a step in which it comes near [m]: by 40 m/s in 2.5 ms."""


TUNING = Tuning()


def left_behind(X_before: Array, X_after: Array, twist: Array, place: Array) -> tuple[Array, Array]:
    """Return by what a body is turned (3, 3) and shifted (3,) to be where it would be had it gone with the hand.

    Args:
        X_before: (4, 4) of the hand in W before a step.
        X_after: after it.
        twist: (6,) rotation, then translation of the hand's origin, in W: its velocity before the step, times the step.
        place: (3,) of the body before the step in W [m].
    """
    turned = X_after[:3, :3] @ X_before[:3, :3].T
    arm = place - X_before[:3, 3]
    went = twist[3:] + _cross(twist[:3], arm)
    should = X_after[:3, 3] + turned @ arm - place
    return turned @ rotations.matrix(rotations.exp(twist[:3])).T, should - went


class CarriedBodies:
    """The bodies of one world that its hand may carry; it holds no state of theirs."""

    def __init__(
        self,
        plant: MultibodyPlant,
        hand: Frame,
        joints: Sequence[Joint],
        bodies: Mapping[str, BodyIndex],
        near: float = TUNING.near,
    ) -> None:
        """Name them.

        Args:
            plant: of the world, finalized.
            hand: that carries the fingers.
            joints: by which it is moved.
            bodies: free ones, by name.
            near: farther from the hand none is in it [m].
        """
        self._plant, self._hand, self._near = plant, hand, near
        self._columns = np.array([joint.position_start() for joint in joints])
        self._bodies = [plant.get_body(index) for index in bodies.values()]

    def stepped(self, context: Context, step: Callable[[], None]) -> None:
        """Take one step of the plant, or none, and put back what goes with the hand.

        Args:
            context: the plant's, changed by `step`.
            step: advances it.
        """
        plant, hand, world = self._plant, self._hand, self._plant.world_frame()
        X_before = hand.CalcPoseInWorld(context).GetAsMatrix4()
        # What is far off is not asked anything: a step of the cell has four or five such bodies.
        places = [(body, np.array(body.EvalPoseInWorld(context).translation())) for body in self._bodies]
        places = [one for one in places if _length(one[1] - X_before[:3, 3]) <= self._near + TUNING.coming]
        if not places:
            step()
            return
        q_before = plant.GetPositions(context)[self._columns]
        J = plant.CalcJacobianSpatialVelocity(context, JacobianWrtVariable.kQDot, hand, np.zeros(3), world, world)
        step()
        moved = plant.GetPositions(context)[self._columns] - q_before
        if not moved.any():
            return
        X_after = hand.CalcPoseInWorld(context).GetAsMatrix4()
        V_hand = hand.CalcSpatialVelocityInWorld(context)
        for body, place in places:
            X_WB = body.EvalPoseInWorld(context)
            arm = X_WB.translation() - X_after[:3, 3]
            if _length(arm) > self._near:
                continue
            along = V_hand.translational() + _cross(V_hand.rotational(), arm)
            if _length(body.EvalSpatialVelocityInWorld(context).translational() - along) > TUNING.along:
                continue
            turn, shift = left_behind(X_before, X_after, J[:, self._columns] @ moved, place)
            R = RotationMatrix.ProjectToRotationMatrix(turn @ X_WB.rotation().matrix())
            plant.SetFloatingBaseBodyPoseInWorldFrame(context, body, RigidTransform(R, X_WB.translation() + shift))


def _length(v: Array) -> float:
    return math.sqrt(float(v @ v))


def _cross(a: Array, b: Array) -> Array:
    """Return a × b of two vectors (3,), as `np.cross` does, which takes ten times as long for two."""
    (x, y, z), (u, v, w) = a.tolist(), b.tolist()
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])
