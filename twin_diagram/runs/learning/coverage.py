"""What was seen of an object so far, whether that asks for a further grasp, and which one is to be taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.logs.frames.scene_folder import RgbdFrame
from twin_diagram.planning.grasps import Grasps, Gripper
from twin_diagram.planning.grasps.cost import TUNING as COST
from twin_diagram.runs.learning.display import TUNING as DISPLAY
from twin_diagram.runs.learning.display import Mask, tool_at
from twin_diagram.runs.learning.following import TUNING as FOLLOWING
from twin_diagram.runs.learning.following import Followed
from twin_diagram.runs.learning.grasp_selection import Lacking, best_turns, by_axes, by_pair, cameras_about
from twin_diagram.runs.learning.seen_map import SeenMap, seen_map
from twin_diagram.scenario import Learning
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    least_gain: float = 0.01
    """Share of the surface that the last grasp must have shown anew for one more to be asked for [1]: what two grasps
    from above did not show, such as the inside of a cup, further ones show hardly either."""

    turning: float = 0.5
    """Grasps in which the weight takes less of what the pads hold by turning are alike [1]: leaning, and with less
    friction than is counted on, it may take twice as much."""

    firm: float = 0.1
    """The same, for what has turned in the fingers before [1]."""


TUNING = Tuning()
LATER: Final = (*DISPLAY.later_tilts, *DISPLAY.other_tilts)
"""Tilts of the tool in further grasps, the usual ones first [rad]."""


def posed_frames(followed: Followed) -> tuple[list[RgbdFrame], list[Mask]]:
    """Return the pictures that are well followed, with their cameras' poses in S, and the masks of the hand."""
    frames, hands, good = [], [], set(well_followed(followed))
    for k, (one, X_SC) in enumerate(zip(followed.shown, followed.camera_poses(), strict=True)):
        if k not in good:
            continue
        camera = one.picture.camera.moved(X_SC[:3, :3], X_SC[:3, 3])
        frames.append(RgbdFrame(k, one.picture.time, one.picture.rgb, one.picture.depth, one.mask, camera, camera))
        hands.append(one.hand)
    return frames, hands


def well_followed(followed: Followed) -> list[int]:
    """Return the numbers of the pictures that are well followed: those of which a shape is made."""
    return [k for k, share in enumerate(followed.explained) if share >= 0.5 * FOLLOWING.explained]


def hands_of(followed: Followed, openings: Sequence[float], gripper: Gripper) -> list[Boxes]:
    """Return the boxes that the hand filled in each grasp, where it was in the middle one of its pictures.

    Args:
        followed: pictures and poses.
        openings: between the pads in each grasp [m].
        gripper: that held it.
    """
    found = []
    for grasp, opening in enumerate(openings):
        held = [X_ST for one, X_ST in zip(followed.shown, followed.X_ST, strict=True) if one.grasp == grasp]
        if held:
            found.append(Boxes(held[len(held) // 2], *gripper.boxes(opening)))
    return found


def map_of(followed: Followed, held: Sequence[Array], openings: Sequence[float], gripper: Gripper) -> SeenMap:
    """Return how well an object's surface was seen.

    Args:
        followed: pictures, poses, cloud.
        held: (4, 4) tool poses X_ST of the grasps.
        openings: between the pads in each [m].
        gripper: that held it.
    """
    hands = [Boxes(X, *gripper.boxes(opening)) for X, opening in zip(held, openings, strict=True)]
    return seen_map(followed.points, followed.normals, posed_frames(followed)[0], hands)


def asks_for_more(grasps: int, shares: Sequence[float], learning: Learning) -> bool:
    """Return whether an object is to be shown in a further grasp.

    Args:
        grasps: in how many it was shown.
        shares: of its surface seen after each of them.
        learning: what is wanted.
    """
    if grasps < learning.grasps:
        return True
    if grasps >= learning.most_grasps or not shares or shares[-1] >= learning.seen_share:
        return False
    return len(shares) < 2 or shares[-1] - shares[-2] >= TUNING.least_gain


def order_of(
    grasps: Grasps,
    X_WS: Array,
    held: Sequence[Array],
    seen: SeenMap,
    gripper: Gripper,
    learning: Learning,
    p_WC: Array,
    *,
    firm: bool = False,
) -> list[int]:
    """Return the numbers of grasps from above in the order in which the method of `grasp_selection` wants them.

    Args:
        grasps: in W.
        X_WS: (4, 4) where the object stands.
        held: (4, 4) tool poses X_ST of earlier grasps.
        seen: what was seen of it in these.
        gripper: that takes it.
        learning: which method, and how it is shown.
        p_WC: (3,) of the scanning camera [m].
        firm: whether it turned in the fingers before: then those in which the weight turns it least go first.
    """
    if learning.grasp_selection == "pca":
        order = by_axes(grasps, X_WS, seen.points[np.isfinite(seen.distance)], held)
    else:
        order = by_pair(grasps, X_WS, seen, gripper, turns_before(learning, p_WC))[0]
    # Whatever it shows, a grasp in which the weight turns the object is worth nothing.
    turning = grasps.terms["torque"] / COST.torque // (TUNING.firm if firm else TUNING.turning)
    return sorted(order, key=lambda k: float(turning[k]))


def tilts_of(seen: SeenMap, hand: Boxes, learning: Learning, p_WC: Array) -> tuple[float, ...]:
    """Return at which tilts of the tool an object is shown in a further grasp, the steepest towards the camera first.

    Args:
        seen: what was seen of it so far.
        hand: that holds it.
        learning: which method, and how it is shown.
        p_WC: (3,) of the scanning camera [m].
    """
    if learning.grasp_selection == "pca":
        return DISPLAY.later_tilts
    chosen, _ = best_turns(Lacking.of(seen), hand, turns_before(learning, p_WC))
    return tuple(sorted((LATER[k] for k in chosen), reverse=True))


def turns_before(learning: Learning, p_WC: Array) -> list[Array]:
    """Return where the camera is about the tool (K, 3) in full turns at each of the tilts of further grasps."""
    return [cameras_about(p_WC, [tool_at(learning, tilt)], DISPLAY.turn, learning.frames) for tilt in LATER]
