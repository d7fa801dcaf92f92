"""How far a hand is open by where its joints are: fingers that slide, and those that a linkage turns.

A linkage of four bars moves a pad along an arc and keeps its direction: the pads of a Robotiq's or an xArm's hand meet
as those of fingers that slide do. How far apart they are is read off the plant's kinematics, once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint, RigidBody
from pydrake.systems.framework import Context

from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.description.followers import Followers
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    shares: int = 33
    """Places of a travel at which the opening is read: between two of them an arc of 6 cm is straight to 5 µm."""

    turned: float = 0.02
    """A pad that turns by no more than this over the whole travel keeps its direction [rad]: descriptions of linkages
    are rounded to a few thousandths of their angles."""


TUNING = Tuning()


@dataclass(frozen=True)
class FingerTravel:
    """The travel of a hand whose pads a linkage moves.

    Attributes:
        closed: (g,) of the gripper's joints where the pads meet [m or rad].
        opened: (g,) the other end of their travel [m or rad].
        openings: (K,) between the pads at even shares of the travel, from 0, closed, on [m].
    """

    closed: Array
    opened: Array
    openings: Array

    def share(self, positions: Array) -> float:
        """Return by which share of their travel joints at positions (g,) are opened."""
        span = self.opened - self.closed
        return float(np.mean((positions - self.closed) / span))

    def opening(self, positions: Array) -> float:
        """Return the opening at positions (g,) [m]."""
        return float(np.interp(self.share(positions), np.linspace(0.0, 1.0, len(self.openings)), self.openings))

    def share_of(self, opening: float) -> float:
        """Return by which share of their travel the joints are opened where the pads are so far apart [m]."""
        return float(np.interp(opening, self.openings, np.linspace(0.0, 1.0, len(self.openings))))

    def lever(self, positions: Array) -> Array:
        """Return by how much the opening grows with each of the joints (g,), at positions (g,) [m/rad].

        Torques of so much times a force make both pads press with that force, by virtual work: of one joint that all
        others follow, or of one for each finger.
        """
        steps = np.diff(self.openings) * (len(self.openings) - 1)
        middles = (np.arange(len(steps)) + 0.5) / len(steps)
        rate = np.interp(self.share(positions), middles, steps)
        return np.asarray(rate / (len(self.closed) * np.abs(self.opened - self.closed)))


def turns(plant: MultibodyPlant, arm: Arm) -> bool:
    """Return whether any joint of an arm's gripper is none that slides."""
    return not all(isinstance(plant.get_joint(index), PrismaticJoint) for index in arm.gripper_joint_indices)


def travel_of(plant: MultibodyPlant, arm: Arm) -> FingerTravel | None:
    """Return the travel of a gripper whose joints turn; None where pads are not carried straight, or all joints slide.

    Pads are what the gripper's joints move without turning it; they meet at the end where the two that go apart the
    farthest are nearer to each other.

    Args:
        plant: finalized; holds the arm.
        arm: where it is in the plant.
    """
    if not turns(plant, arm):
        return None
    low, high = limits(plant, arm)
    if not np.isfinite([low, high]).all():
        return None
    shares = np.linspace(0.0, 1.0, TUNING.shares)
    bodies = moving_bodies(plant, arm)
    places, turned = _paths(plant, arm, bodies, shares)
    went = places[:, -1] - places[:, 0]
    straight = [k for k in range(len(bodies)) if turned[k] <= TUNING.turned and np.linalg.norm(went[k]) > 0.0]
    if len(straight) < 2:
        return None
    y = np.linalg.svd(went[straight])[2][0]
    along = went[straight] @ y
    if not (along.max() > 0.0 > along.min()):
        return None
    one, other = straight[int(along.argmax())], straight[int(along.argmin())]
    apart = (places[one] - places[other]) @ y
    if abs(apart[-1]) < abs(apart[0]):
        low, high, apart = high, low, apart[::-1]
    openings = np.abs(apart - apart[0])
    if not (np.diff(openings) > 0.0).all():  # they pass each other, or turn back
        return None
    return FingerTravel(low, high, openings)


def limits(plant: MultibodyPlant, arm: Arm) -> tuple[Array, Array]:
    """Return the ends of the gripper's joints' travel: (g,) nearer to zero, (g,) the others; may be infinite."""
    joints = [plant.get_joint(index) for index in arm.gripper_joint_indices]
    ends = [sorted((j.position_lower_limits()[0], j.position_upper_limits()[0]), key=abs) for j in joints]
    near_far = np.array(ends, dtype=float).reshape(-1, 2)
    return near_far[:, 0], near_far[:, 1]


def at_share(plant: MultibodyPlant, arm: Arm, share: float, travel: FingerTravel | None = None) -> Context:
    """Return a context in which the gripper's joints are at a share of their travel, and what follows them with them.

    Args:
        plant: finalized; holds the arm.
        arm: where it is in the plant.
        share: 0 is closed: of joints without a `travel` the end that is nearer to zero; one without ends stays.
        travel: of the gripper, where its joints turn.
    """
    closed, opened = (travel.closed, travel.opened) if travel else limits(plant, arm)
    context = plant.CreateDefaultContext()
    q = plant.GetPositions(context).copy()
    for index, near, far in zip(arm.gripper_joint_indices, closed, opened, strict=True):
        if np.isfinite([near, far]).all():
            q[plant.get_joint(index).position_start()] = near + share * (far - near)
    Followers.of(plant, arm).follow(q)
    plant.SetPositions(context, q)
    return context


def moving_bodies(plant: MultibodyPlant, arm: Arm) -> list[RigidBody]:
    """Return what moves with the gripper's joints, by themselves or as they follow."""
    joints = Followers.gripping(plant, arm)
    kinematic = [joint.index() for joint in joints]
    affected = plant.GetBodiesKinematicallyAffectedBy(kinematic) if kinematic else []
    return [plant.get_body(index) for index in affected]


def _paths(plant: MultibodyPlant, arm: Arm, bodies: list[RigidBody], shares: Array) -> tuple[Array, Array]:
    """Return origins (B, K, 3) of bodies in the last link at shares (K,) of the travel [m], and turns (B,) [rad]."""
    last = plant.get_body(arm.last_link).body_frame()
    poses = np.array(
        [
            [plant.CalcRelativeTransform(context, last, body.body_frame()).GetAsMatrix4() for body in bodies]
            for context in (at_share(plant, arm, float(share)) for share in shares)
        ]
    ).reshape(len(shares), -1, 4, 4)
    cosine = 0.5 * (np.einsum("bij,bij->b", poses[0, :, :3, :3], poses[-1, :, :3, :3]) - 1.0)
    return np.moveaxis(poses[:, :, :3, 3], 0, 1), np.arccos(np.clip(cosine, -1.0, 1.0))
