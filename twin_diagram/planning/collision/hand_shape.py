"""The shapes of a hand, in its tool frame G: what stands still behind the fingers, and the fingers, open and closed."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint

from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.description.finger_travel import FingerTravel, at_share, moving_bodies, travel_of
from twin_diagram.planning.collision.between_fingers import between_fingers, hulls_of
from twin_diagram.planning.collision.geometry_to_solids import moved
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Palm:
    """What of a hand stands still behind its open fingers, in G.

    Attributes:
        free: how far the finger tips reach beyond it [m]; infinite where nothing is there, or nobody knows.
        corners: (C, 3) of the box around it [m].
    """

    free: float = np.inf
    corners: Array = field(default_factory=lambda: np.zeros((0, 3)))


@dataclass(frozen=True)
class HandHulls:
    """A hand, in G.

    Attributes:
        palm: what stands still.
        opened: points (V, 3) around each shape of the fingers, wide open [m].
        closed: the same, closed.
        force: with which a finger can press [N]; infinite where the description does not say.
    """

    palm: Palm = field(default_factory=Palm)
    opened: tuple[Array, ...] = ()
    closed: tuple[Array, ...] = ()
    force: float = np.inf


def hand_shape(plant: MultibodyPlant, scene_graph: SceneGraph, arm: Arm) -> HandHulls:
    """Return the shape of an arm's hand; nothing where `between_fingers` has no answer.

    Args:
        plant: finalized; holds the arm.
        scene_graph: its geometry.
        arm: where it is in the plant; its tool frame is between the fingers, see `refuse_elsewhere`.
    """
    if between_fingers(plant, scene_graph, arm) is None:
        return HandHulls()
    tool, last, bodies = plant.get_frame(arm.tool_frame), plant.get_body(arm.last_link), moving_bodies(plant, arm)
    travel = travel_of(plant, arm)
    opened: list[Array] = []
    closed: list[Array] = []
    for share, found in ((0.0, closed), (1.0, opened)):
        context = at_share(plant, arm, share, travel)
        X_TL = np.asarray(plant.CalcRelativeTransform(context, tool, last.body_frame()).GetAsMatrix4())
        for body in bodies:
            found += [moved(X_TL, hull) for hull in hulls_of(plant, scene_graph, context, last, body)]
    moving = {int(body.index()) for body in bodies}
    still = [
        moved(X_TL, hull)
        for body in plant.GetBodiesWeldedTo(last)
        if int(body.index()) not in moving
        for hull in hulls_of(plant, scene_graph, context, last, body)
    ]
    return HandHulls(_palm(still, opened), tuple(opened), tuple(closed), _force(plant, arm, travel))


def _palm(still: list[Array], fingers: list[Array]) -> Palm:
    """Return what of shapes that stand still, points (V, 3) around each, is behind the fingers."""
    by_side = sides(fingers)
    boxes = [np.stack([points.min(axis=0), points.max(axis=0)]) for points in still]
    behind = [box for box in boxes if (box[0, :2] < 0.0).all() and (box[1, :2] > 0.0).all()]
    if not (behind and all(by_side)):
        return Palm()
    nearest = max(behind, key=lambda box: float(box[1, 2]))
    tips = min(float(np.concatenate(side)[:, 2].max()) for side in by_side)
    return Palm(tips - float(nearest[1, 2]), nearest[list(product((0, 1), repeat=3)), [0, 1, 2]])


def sides(fingers: list[Array] | tuple[Array, ...]) -> tuple[list[Array], list[Array]]:
    """Return a hand's finger shapes, points (V, 3) in G each, by the side on which they are: y > 0, y < 0."""
    right = [points for points in fingers if points[:, 1].mean() > 0.0]
    return right, [points for points in fingers if points[:, 1].mean() <= 0.0]


def _force(plant: MultibodyPlant, arm: Arm, travel: FingerTravel | None) -> float:
    """Return with which force both fingers can press [N]; infinite where that is not said."""
    fingers = {int(index): k for k, index in enumerate(arm.gripper_joint_indices)}
    motors = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    own = [m for m in motors if int(m.joint().index()) in fingers]
    if travel is None:
        sliding = [m for m in own if isinstance(m.joint(), PrismaticJoint)]
        return min((float(motor.effort_limit()) for motor in sliding), default=np.inf)
    lever = travel.lever(travel.opened)
    return min((float(m.effort_limit() / lever[fingers[int(m.joint().index())]]) for m in own), default=np.inf)
