"""A gripper as its shapes tell, for hands of which nobody wrote down the figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from pydrake.math import RollPitchYaw, RotationMatrix

from twin_diagram.planning.collision.ball_cover import arm_plant
from twin_diagram.planning.collision.between_fingers import between_fingers, refuse_turning, told_in
from twin_diagram.planning.collision.hand_shape import HandHulls, hand_shape, sides
from twin_diagram.planning.grasps.gripper import Gripper, GripperError
from twin_diagram.scenario import ArmModel, Pose
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    pad: float = 0.02
    """What of a finger is so near to its tip counts as its pad [m]: as at the hands that come along."""

    step: float = 0.002
    """What stands out by less than this is the finger's face [m]."""

    force: float = 40.0
    """With which fingers press where their description does not say [N]: as a step does that is told nothing else."""

    most_force: float = 500.0
    """A description that says more [N] says nothing: strong hands with two fingers press with half of it, and 1000 N·m
    stand where nobody looked."""

    digits: int = 4
    """Lengths are told to a tenth of a millimetre: grasps that are kept go by them."""


TUNING = Tuning()


def gripper_of_shape(shape: HandHulls, name: str, frame: str) -> Gripper | None:
    """Return the gripper that a hand's shapes make; None where they make none with two fingers and a palm.

    Each finger is a box by its pad, and a thicker one behind where something stands out there; the palm begins where
    the first thing is between the open fingers. Where fingers reach farther closed than open, as those that a linkage
    carries do, what they sweep counts as finger, and as pad what is pad wherever they are.

    Args:
        shape: of the hand, in its tool frame.
        name: of the gripper, for files.
        frame: the tool frame's name.
    """
    opened, closed = sides(shape.opened), sides(shape.closed)
    if not (all(opened) and all(closed) and len(shape.palm.corners)):
        return None
    tip = min(float(np.concatenate(side)[:, 2].max()) for side in opened)
    near = [_near_tip(side, sign) for side, sign in zip(opened, (1.0, -1.0), strict=True)]
    inner = [float(points[:, 1].min()) for points in near]
    half, outer = sum(inner) / 2, max(float(points[:, 1].max()) for points in near)
    least = sum(float(_near_tip(side, sign)[:, 1].min()) for side, sign in zip(closed, (1.0, -1.0), strict=True))
    every = np.concatenate([points for side in opened for points in side])
    behind = every[every[:, 2] < tip - TUNING.pad]
    between = behind[np.abs(behind[:, 1]) < half - TUNING.step]
    length = min(shape.palm.free, tip - float(between[:, 2].max()) if len(between) else np.inf)
    roots = behind[np.abs(behind[:, 1]) > outer + TUNING.step]
    thick = float(np.abs(roots[:, 1]).max()) - half if len(roots) else 0.0
    wide = max(float(np.ptp(points[:, 0])) for points in near)
    low, high = shape.palm.corners.min(axis=0), shape.palm.corners.max(axis=0)
    # The palm is wherever that box is; a `Gripper` has it about the axis.
    size = (*(2.0 * np.maximum(-low, high)[:2]), high[2] - low[2])
    tip_closed = min(float(np.concatenate(side)[:, 2].max()) for side in closed)
    ahead = tip_closed - tip if abs(tip_closed - tip) > TUNING.step else 0.0
    front, pad_front = tip + max(ahead, 0.0), tip + min(ahead, 0.0)
    pad = min(TUNING.pad, length) if ahead == 0.0 else min(map(_face, opened, (1.0, -1.0), inner)) - abs(ahead)
    length += front - tip
    try:
        return Gripper(
            name=name,
            frame=frame,
            opening_least=_told(max(least, 0.0)),
            opening_most=_told(2.0 * half),
            finger_front=_told(front),
            finger_length=_told(length),
            finger_thickness=_told(outer - half),
            finger_width=_told(wide),
            root_front=_told(max(float(roots[:, 2].max()) + front - tip, front - length)) if len(roots) else 0.0,
            root_thickness=_told(thick),
            root_width=_told(float(np.ptp(roots[:, 0]))) if len(roots) else 0.0,
            palm_size=(_told(size[0]), _told(size[1]), _told(size[2])),
            pad_length=_told(pad),
            pad_front=_told(pad_front),
            pad_width=_told(wide),
            force=shape.force if shape.force <= TUNING.most_force else TUNING.force,
        )
    except GripperError:  # fingers that cross, or end in the palm: nothing that grasps could be sought for
        return None


def gripper_of_description(path: Path) -> Gripper:
    """Return the gripper at the end of an arm, by the collision shapes of its description (URDF, SDF or MJCF).

    Its frame G lies between the finger tips, by a frame that the description names, or by the last link.

    Raises:
        GripperError: no two fingers move apart there, or their shapes make none.
        ModelError: the description cannot be read, or its pads turn as the hand closes.
    """
    plant, scene_graph, arm, _keep = arm_plant(ArmModel(model=str(path), tool_frame=""))
    X_LG = between_fingers(plant, scene_graph, arm)
    if X_LG is None:
        raise GripperError(
            f"{path}: no two fingers with collision shapes move apart at the end of an arm; give a description of arm "
            "and hand, or a YAML file with the gripper's figures"
        )
    refuse_turning(plant, arm)
    last = plant.get_body(arm.last_link).name()
    turn = RollPitchYaw(RotationMatrix.ProjectToRotationMatrix(cast(Any, X_LG[:3, :3]))).vector()
    where = Pose([float(x) for x in X_LG[:3, 3]], [float(x) for x in turn])
    plant, scene_graph, arm, _keep = arm_plant(ArmModel(model=str(path), tool_frame=last, X_FG=where))
    found = gripper_of_shape(hand_shape(plant, scene_graph, arm), f"{path.stem}_hand", f"{last}, {told_in(X_LG)}")
    if found is None:
        raise GripperError(f"{path}: its fingers' shapes make no gripper; give a YAML file with the gripper's figures")
    return found


def _near_tip(side: list[Array], sign: float) -> Array:
    """Return what of a finger's points (V, 3) is near its tip, y > 0 outwards."""
    points = np.concatenate(side) * np.array([1.0, sign, 1.0])
    near: Array = points[points[:, 2] > points[:, 2].max() - TUNING.pad]
    return near


def _face(side: list[Array], sign: float, inner: float) -> float:
    """Return how long the flat face is [m] by which a finger, points (V, 3) of its hulls, meets the other."""
    ends = [np.abs(sign * points[:, 1] - inner) < TUNING.step for points in side]
    faces = [points[end, 2] for points, end in zip(side, ends, strict=True) if end.any()]
    return float(np.ptp(max(faces, key=np.max)))


def _told(length: float) -> float:
    return round(float(length), TUNING.digits)
