"""Finds the frame between a hand's finger tips by the fingers' shapes: few descriptions by others name one.

G, as picks take it: origin between the tips, z along the approach, y along the closing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import PrismaticJoint, RigidBody
from pydrake.systems.framework import Context

from twin_diagram.errors import ModelError
from twin_diagram.model.description.add_arm import Arm
from twin_diagram.model.description.finger_travel import at_share, moving_bodies, travel_of, turns
from twin_diagram.planning.collision.geometry_to_solids import moved, points_of
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    tip: float = 0.01
    """G lies so far behind the finger tips [m]: 9 and 10 mm at the hands that come along, by which picks were set."""

    near_tip: float = 0.02
    """What of a finger is so near to its tip tells where the fingers meet [m]: most of a pad."""

    straight: float = 0.35
    """Fingers point along an axis of a frame of theirs that is so near to where they lie [rad]: shapes are askew by a
    few degrees, and a hand's axes are drawn straight."""

    along: float = 0.02
    """A tool frame may lie so far before or behind G [m]: where most say that tips are, and a pad's middle."""

    aside: float = 0.012
    """… and so far beside it [m]: half of what a hand keeps as room when it takes something …"""

    turned: float = 0.26
    """… and be turned by so much [rad]: beyond 15° fingers meet a box at its edges."""


TUNING = Tuning()


def between_fingers(plant: MultibodyPlant, scene_graph: SceneGraph, arm: Arm) -> Array | None:
    """Return X_LG (4, 4), where the frame between the finger tips lies in the arm's last link.

    None where no two groups of bodies move apart with the gripper's joints, or one of them has no collision shape.

    Args:
        plant: finalized; holds the arm.
        scene_graph: its geometry.
        arm: where it is in the plant.
    """
    last = plant.get_body(arm.last_link)
    travel = travel_of(plant, arm)
    narrow, wide = (at_share(plant, arm, share, travel) for share in (0.0, 1.0))
    bodies = moving_bodies(plant, arm)
    if not bodies:
        return None
    went = np.array([_in(plant, wide, last, body)[:3, 3] - _in(plant, narrow, last, body)[:3, 3] for body in bodies])
    y = np.linalg.svd(went)[2][0]
    side = went @ y
    if not (side.max() > 0.0 > side.min()):
        return None
    half = at_share(plant, arm, 0.5, travel)
    shapes = [_points(plant, scene_graph, half, last, body) for body in bodies]
    one, other = (
        np.concatenate([np.zeros((0, 3)), *(points for points, s in zip(shapes, side, strict=True) if sign * s > 0)])
        for sign in (1.0, -1.0)
    )
    if not (len(one) and len(other)):
        return None
    z = _approach(plant, half, last, bodies, y, np.concatenate([one, other]))
    tip = min(float((points @ z).max()) for points in (one, other))
    ends = [points[points @ z > tip - TUNING.near_tip] for points in (one, other)]
    x = np.cross(y, z)
    across = 0.5 * (float((ends[0] @ y).min()) + float((ends[1] @ y).max()))
    beside = np.mean([0.5 * (float((end @ x).min()) + float((end @ x).max())) for end in ends])
    X_LG = np.eye(4)
    X_LG[:3, :3] = np.stack([x, y, z], axis=1)
    X_LG[:3, 3] = beside * x + across * y + (tip - TUNING.tip) * z
    return X_LG


def grips(X_FG: Array) -> bool:
    """Return whether a frame F can stand for the one between the fingers, G; X_FG (4, 4)."""
    off = np.abs(X_FG[:3, :3].T @ X_FG[:3, 3])
    near = off[2] <= TUNING.along and max(off[:2]) <= TUNING.aside
    # Fingers are alike: half a turn about the approach changes nothing.
    least = np.cos(TUNING.turned)
    return bool(near and X_FG[2, 2] >= least and abs(X_FG[1, 1]) >= least)


def told_in(X_FG: Array) -> str:
    """Return what a scenario's arm says where G lies in its `tool_frame` F; X_FG (4, 4), or half a turn about its z."""
    X_FG = X_FG.copy()
    if X_FG[0, 0] + X_FG[1, 1] < 0.0:  # the lesser turn reads better
        X_FG[:3, :2] *= -1.0
    rpy = RollPitchYaw(RotationMatrix.ProjectToRotationMatrix(cast(Any, X_FG[:3, :3]))).vector()
    place, turn = (", ".join(f"{round(float(x), 4) + 0.0:g}" for x in values) for values in (X_FG[:3, 3], rpy))
    return f"X_FG: {{translation: [{place}], rpy: [{turn}]}}"


def refuse_elsewhere(plant: MultibodyPlant, scene_graph: SceneGraph, arm: Arm) -> None:
    """Refuse an arm for picks whose tool frame is not between the finger tips, where their shapes tell.

    Raises:
        ModelError: it is elsewhere; the message says how to put it there.
    """
    X_LG = between_fingers(plant, scene_graph, arm)
    if X_LG is None:
        return
    tool, last = plant.get_frame(arm.tool_frame), plant.get_body(arm.last_link)
    context = plant.CreateDefaultContext()
    X_TG = np.asarray(plant.CalcRelativeTransform(context, tool, last.body_frame()).GetAsMatrix4()) @ X_LG
    if grips(X_TG):
        return
    off = 1e3 * float(np.linalg.norm(X_TG[:3, 3]))
    named = plant.GetFrameByName(arm.spec.tool_frame) if arm.spec.tool_frame else last.body_frame()
    X_FG = np.asarray(plant.CalcRelativeTransform(context, named, last.body_frame()).GetAsMatrix4()) @ X_LG
    raise ModelError(
        f"tool_frame: a pick needs it between the finger tips, z along the approach and y along the closing; "
        f"{tool.name()} is {off:.0f} mm from there, or turned: give the arm {told_in(X_FG)}"
    )


def refuse_turning(plant: MultibodyPlant, arm: Arm) -> None:
    """Refuse a gripper for picks whose pads turn as it closes.

    How far pads are apart, and how they press, is told of those that are carried straight.

    Raises:
        ModelError: a joint of the gripper turns, and no linkage keeps the pads' direction.
    """
    if turns(plant, arm) and travel_of(plant, arm) is None:
        joint = next(
            joint
            for joint in (plant.get_joint(index) for index in arm.gripper_joint_indices)
            if not isinstance(joint, PrismaticJoint)
        )
        raise ModelError(
            f"the gripper's joint {joint.name()} turns its fingers' pads; a pick needs pads that are carried straight, "
            "by joints that slide or by a linkage: the arm may reach, follow and hold as it is"
        )


def _in(plant: MultibodyPlant, context: Context, last: RigidBody, body: RigidBody) -> Array:
    """Return X_LB (4, 4) of a body in the last link."""
    X_LB = plant.CalcRelativeTransform(context, last.body_frame(), body.body_frame())
    return np.asarray(X_LB.GetAsMatrix4())


def _points(
    plant: MultibodyPlant, scene_graph: SceneGraph, context: Context, last: RigidBody, body: RigidBody
) -> Array:
    """Return points (V, 3) around a body's collision shapes, in the last link [m]."""
    return np.concatenate([np.zeros((0, 3)), *hulls_of(plant, scene_graph, context, last, body)])


def hulls_of(
    plant: MultibodyPlant, scene_graph: SceneGraph, context: Context, last: RigidBody, body: RigidBody
) -> list[Array]:
    """Return points (V, 3) around each of a body's collision shapes, in the last link [m]."""
    inspector = scene_graph.model_inspector()
    X_LB = _in(plant, context, last, body)
    return [
        moved(X_LB @ inspector.GetPoseInFrame(shape).GetAsMatrix4(), points_of(inspector, shape))
        for shape in plant.GetCollisionGeometriesForBody(body)
    ]


def _approach(
    plant: MultibodyPlant, context: Context, last: RigidBody, bodies: list[RigidBody], y: Array, points: Array
) -> Array:
    """Return where the fingers point (3,) in the last link: away from its origin, along an axis of theirs."""
    ahead = points.mean(axis=0)
    ahead = ahead - (ahead @ y) * y
    ahead /= np.linalg.norm(ahead)
    axes = np.concatenate([_in(plant, context, last, body)[:3, :3].T for body in (*bodies, last)])
    axes = np.concatenate([axes, -axes])
    axes -= np.outer(axes @ y, y)
    lengths = np.linalg.norm(axes, axis=1)
    axes = axes[lengths > np.cos(TUNING.straight)] / lengths[lengths > np.cos(TUNING.straight), None]
    best = axes[int(np.argmax(axes @ ahead))] if len(axes) else ahead
    return best if best @ ahead >= np.cos(TUNING.straight) else ahead
