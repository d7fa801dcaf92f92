"""Takes what stands on the platform in another grasp, whose fingers hide another part of the surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from twin_diagram.planning.grasps import Grasps, Gripper, Wanted, given_poses, propose, rank, target_of
from twin_diagram.runs.learning.bin_view import SeenThing
from twin_diagram.runs.learning.cell import Cell
from twin_diagram.runs.learning.following import Followed, cover, register
from twin_diagram.runs.learning.looking_about import LyingAbout
from twin_diagram.runs.learning.motion import Mover
from twin_diagram.runs.learning.picking import Taken, reach_of, take
from twin_diagram.runs.learning.setting_down import downwards, hull_sides, pose_over, turned
from twin_diagram.runs.learning.shown_object import ShownObject
from twin_diagram.runs.learning.thing_grasps import TUNING as THING_GRASPS
from twin_diagram.runs.learning.thing_grasps import downward, grasps_of_thing
from twin_diagram.scenario import Learning
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    candidates: int = 40
    """Grasps that are looked at, of each search."""

    searches: int = 8
    """From points drawn anew, 0.1 s of a core each. Of a box loaded at one end, one has none to two grasps in which the
    weight takes less than half of what the pads hold by turning; eight have two to eight."""

    moved: tuple[float, float] = (0.01, 0.15)
    """By how much what is let go may move [m], [rad]."""

    reach: float = 0.012
    """Within which points of the picture are held against those that are known [m]."""

    same: float = 0.5
    """Share of the picture's points that lie on the cloud, from which it is where it is thought to be."""

    fallen: tuple[float, float] = (0.05, 0.3)
    """By how much what has tipped over may be off each of the poses that are tried [m], [rad]."""

    fallen_reach: tuple[float, ...] = (0.03, 0.012)
    """As `reach`, when it is looked for there."""

    yaws: int = 12
    """Turns about the vertical that are tried: every 30°."""

    few: int = 250
    """Points of the picture with which they are."""

    blank: int = 2
    """Looks in a row that show nothing anywhere, after which it is not tried any more: fingers would shut on air."""

    floor: float = 0.004
    """Height over the platform that fingers stay above [m]."""


TUNING = Tuning()
PLATFORM: Final = "platform"
"""Name of what stands there, or lies about it, see `Mover.stand`."""


def stands_at(one: SeenThing, support: float, seen: Followed, X_WS: Array) -> tuple[Array, float]:
    """Return the pose X_WS (4, 4) of what was set down, as a camera sees it, and the share of the picture it explains.

    Where that is little, nobody knows, and it is the pose that was given.

    Args:
        one: that is seen.
        support: height of what it lies on [m].
        seen: the object's cloud in S.
        X_WS: by where the fingers let go.
    """
    points, normals = one.points[:1500], one.normals[:1500]
    # The picture's points are brought to the cloud: what comes out is where W is in S.
    start = np.asarray(np.linalg.inv(X_WS), dtype=float)
    X_SW, share = register(seen.points, seen.normals, points, normals, start, TUNING.moved, TUNING.reach)
    if share <= TUNING.same:
        # It has tipped over, or turned: it is looked for on every side.
        X_SW, share = fallen_pose(seen, points, normals, X_WS, support)
    return np.asarray(np.linalg.inv(X_SW), dtype=float) if share > TUNING.same else X_WS, share


def fallen_pose(seen: Followed, points: Array, normals: Array, X_WS: Array, support: float) -> tuple[Array, float]:
    """Return the pose X_SW (4, 4) of W in what stands somewhere on any of its sides, and the share that it explains.

    Args:
        seen: the object's cloud in S.
        points: (N, 3) that a picture shows of it in W [m], in random order, with normals (N, 3).
        normals: of them.
        X_WS: (4, 4) where it was thought to be.
        support: height of what it stands on [m].
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    few = slice(None, TUNING.few)
    best, best_share, tree = np.asarray(np.linalg.inv(X_WS)), 0.0, cKDTree(seen.points)
    for side in hull_sides(seen.points):
        R_side = downwards(X_WS[:3, :3], side)
        for yaw in np.arange(TUNING.yaws) * (2.0 * np.pi / TUNING.yaws):
            X = pose_over(seen.points, turned(R_side, float(yaw)), middle[:2], support)
            start = np.asarray(np.linalg.inv(X), dtype=float)
            for reach in TUNING.fallen_reach:
                start, share = register(
                    seen.points, seen.normals, points[few], normals[few], start, TUNING.fallen, reach, tree
                )
            if share > best_share:
                best, best_share = start, share
    return register(seen.points, seen.normals, points, normals, best, TUNING.moved, TUNING.reach, tree)


def other_grasps(
    shown: ShownObject, X_WS: Array, gripper: Gripper, floor: float, seed: int, around: Array | None = None
) -> Grasps:
    """Return grasps in W of an object whose cloud is known; see `grasp_selection` for which of them are wanted.

    Args:
        shown: the object, with its cloud and what was felt of its weight in S.
        X_WS: (4, 4) where it stands.
        gripper: that takes it.
        floor: height of what it stands on [m].
        seed: of the search.
        around: (S, 3) points of what is in the hand's way in W [m]; None: nothing is.
    """
    seen = shown.followed
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(seen.points))
    points = seen.points[order] @ X_WS[:3, :3].T + X_WS[:3, 3]
    normals = seen.normals[order] @ X_WS[:3, :3].T
    table = np.array([0.0, 0.0, 1.0, floor + TUNING.floor])
    mass, centre = shown.mass_at_rest or THING_GRASPS.usual_mass, 0.5 * (points.min(axis=0) + points.max(axis=0))
    if shown.centre is not None:
        centre = X_WS[:3, :3] @ shown.centre.mean + X_WS[:3, 3]
    told: dict[str, Any] = {"table": table, "mass": mass, "centre": centre, "surroundings": around}
    target = target_of(points, normals, **told)
    # Few of one search's grasps are where the weight is, and not all of them are reached.
    found = [
        propose(points, normals, gripper, count=TUNING.candidates, seed=seed + k, **told)
        for k in range(1, 1 + TUNING.searches)
    ]
    every = given_poses(np.concatenate([one.poses for one in found]))
    return rank(every, target, gripper, Wanted(TUNING.candidates, seed + 1))


def take_again(
    mover: Mover,
    cell: Cell,
    learning: Learning,
    gripper: Gripper,
    shown: ShownObject,
    X_WS: Array,
    order: Callable[[Grasps, Array], list[int]],
    look: Callable[[], LyingAbout | None],
    walls: Callable[[SeenThing], Sequence[Array]],
) -> tuple[Taken, Array] | None:
    """Take what was set down on the platform, in another grasp where there is one, from wherever it lies now.

    Args:
        mover: plans.
        cell: whose arm is empty.
        learning: how often it is tried.
        gripper: that takes it.
        shown: the object, with its cloud and what was felt of its weight in S; notes why tries failed.
        X_WS: (4, 4) by where the fingers let go.
        order: numbers of grasps in W of what stands at X_WS (4, 4), those first that are wanted most.
        look: has the arm out of the way, and tells what lies on the platform or about it.
        walls: points (S, 3) of what is in the hand's way at a thing [m], one after another until a grasp is reached.

    Returns:
        What is held, and X_ST (4, 4) of the tool as it took it; None: every try failed, those of what the picture alone
        shows too, or nothing is seen.
    """
    blank = 0
    for attempt in range(2 * learning.tries):
        note = f"try {attempt + 1} of taking it from the platform: "
        lying = look()
        if lying is not None:
            thing, floor = lying.thing, lying.support
            X_WS, share = stands_at(thing, floor, shown.followed, X_WS)
        if lying is None or (thing.beside and share <= TUNING.same):
            what = "nothing is seen there or about it" if lying is None else f"no known pose fits {lying.thing.at}"
            shown.notes.append(note + what)
            if (blank := blank + 1) == TUNING.blank:
                break
            continue
        blank, reach = 0, None
        for around in walls(thing):
            if attempt < learning.tries:
                grasps = other_grasps(shown, X_WS, gripper, floor, attempt, around)
                mover.stand(PLATFORM, [cover(shown.followed) @ X_WS[:3, :3].T + X_WS[:3, 3]], floor)
                wanted = order(grasps, X_WS)
            else:  # none of those is to be had: any that the picture alone tells, as if it had never been seen before
                grasps = grasps_of_thing(thing, gripper, floor + TUNING.floor, around, attempt)
                mover.stand(PLATFORM, [thing.points], floor)
                wanted = np.roll(downward(grasps), -2 * (attempt - learning.tries)).tolist()
            if (reach := reach_of(mover, cell, grasps, wanted)) is not None:
                break
        taken = take(mover, cell, reach) if reach is not None else None
        if taken is not None:
            return taken, np.asarray(np.linalg.solve(X_WS, taken.X_WT), dtype=float)
        why = "no grasp is reached" if reach is None else "the fingers held nothing"
        shown.notes.append(f"{note}{why}, it is seen at {thing.at}")
    return None
