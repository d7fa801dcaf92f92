"""Grasps of a thing that one picture shows: of what is seen of it, and of sides that are guessed from its outline.

Sides are taken to go straight down; or, where a thing shows mostly one face that leans, from that face's edges along
its normal, as those of a box do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from twin_diagram.planning.grasps import Grasps, Gripper, Wanted, given_poses, propose, rank, target_of
from twin_diagram.runs.learning.bin_view import SeenThing, narrowest
from twin_diagram.runs.learning.flat_things import upper_face
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    points: int = 3000
    """Of a thing that grasps are searched on, at the most."""

    candidates: int = 24
    """Grasps of a thing that are held against the arm's reach."""

    steepest: float = 0.7
    """Least share of an approach that goes downwards: more slanted ones meet the bin's walls."""

    usual_mass: float = 0.7
    """That a thing is taken to have [kg]."""

    slanted: float = 1.0
    """Added to a grasp's cost, times what its approach lacks of straight down."""

    one_sided: float = 0.15
    """Added where the picture does not show both contacts: what is there is guessed."""

    tip: float = 0.004
    """Farther ahead in the tool's frame a contact is at the pads' very tips [m], 6 mm from their ends: where a picture
    is a few millimetres off they close above it."""

    shallow: float = 5.0
    """Added to the cost of such grasps: they come last."""

    side: float = 0.003
    """Edge of the cells in which an outline is found, and between points of guessed sides [m]."""

    yaws: int = 24
    """Angles about the vertical at which something flat is taken: every 7.5°."""

    leaning: tuple[float, ...] = (0.0, 0.35, -0.35)
    """By how much the hand leans about its closing axis where something lies on the table [rad]: 38 cm from the axis
    of an iiwa 7 a hand that hangs straight down asks for an elbow bent by 123°, of 120."""

    beside_middle: tuple[float, ...] = (0.0, 0.015, -0.015)
    """Off its middle, across the closing axis [m]."""

    heights: float = 0.012
    """Between heights of the finger tips there [m]."""

    apart: float = 0.012
    """Between places on the walls about a hole at which these are taken [m]: half of a finger's width."""

    open: float = 0.5
    """Share of a hole's cells in which the bottom is seen through it, from which it is one: the rest is hidden by the
    wall before it. Through what merely has no depth in a picture nothing is seen."""

    smooth: float = 1.5
    """σ with which an outline is smoothed for its normals [cells]."""

    tilted: float = 0.14
    """From which tilt of its upper face on a thing leans [rad]: 8°; pictures tell it to one or two."""

    between: tuple[float, ...] = (0.0, 0.5, 1.0)
    """How far from straight down to the face's normal a hand leans that takes it."""

    up_and_down: tuple[float, ...] = (0.0, 0.015, -0.015, 0.03, -0.03, 0.045, -0.045)
    """Off the middle of what leans [m]: where it rests on a rim the rim bars its middle, and its upper end is free."""

    beside_cut: int = 4
    """Cells from where it may go on beyond the picture's border within which an outline is that border's: points
    stand 6 mm apart there, cells 3 mm."""

    shown: float = 0.015
    """From how far below its upper face on a side of it is seen [m]: the face's edges smear over some millimetres."""


TUNING = Tuning()


def grasps_of_thing(
    thing: SeenThing,
    gripper: Gripper,
    floor: float,
    surroundings: Array,
    seed: int = 0,
    *,
    count: int = 0,
    lean: Lean | None = None,
) -> Grasps:
    """Return grasps of a thing in W, the best first.

    Args:
        thing: that is to be taken.
        gripper: that takes it.
        floor: height that the fingers stay above [m].
        surroundings: (S, 3) points of what is in the way.
        seed: of the search.
        count: how many are asked for; 0: the usual number.
        lean: of `leaning`, along which hidden sides are guessed; None: straight down.
    """
    points, normals = thing.points[: TUNING.points], thing.normals[: TUNING.points]
    wanted = Wanted(count or TUNING.candidates, seed, guess=False)  # hidden sides are guessed below
    # Nobody knows its weight: a usual one in the middle keeps grasps from its ends, where it would turn.
    told: dict[str, Any] = {
        "table": np.array([0.0, 0.0, 1.0, floor]),
        "mass": TUNING.usual_mass,
        "centre": thing.middle,
    }
    surroundings = np.vstack([surroundings, thing.beyond])
    others = surroundings if len(surroundings) else None
    found = propose(points, normals, gripper, wanted=wanted, viewpoint=thing.viewpoint, surroundings=others, **told)
    if lean is None and found.seen[downward(found)].all(axis=1).any():
        return found
    # Of what lies below the camera sides are hidden: they are guessed, down from its outline.
    sides, outward = guessed_sides(thing, floor, lean)
    if not len(sides):
        return found
    target = target_of(np.vstack([points, sides]), np.vstack([normals, outward]), surroundings=others, **told)
    given = upright_poses(thing, gripper, floor) if lean is None else leaning_poses(thing, gripper, lean)
    guessed = rank(given_poses(np.concatenate([found.poses, given])), target, gripper, wanted)
    return guessed if len(guessed) else found


def upright_poses(
    thing: SeenThing, gripper: Gripper, floor: float, off_middle: tuple[float, ...] = TUNING.beside_middle
) -> Array:
    """Return tool poses (M, 7) straight from above, at every angle and some heights; on the table leaning ones, too.

    They are about a thing's middle, and about places on the walls of what has a hole.
    """
    lowest = floor + gripper.finger_front + TUNING.side
    heights = np.arange(lowest, max(thing.top, lowest + 1e-6), TUNING.heights)
    walls = wall_middles(thing)
    found = []
    for yaw in np.arange(TUNING.yaws) * (np.pi / TUNING.yaws):
        y = np.array([np.cos(yaw), np.sin(yaw), 0.0])
        across, down = np.cross(y, [0.0, 0.0, -1.0]), np.array([0.0, 0.0, -1.0])
        about = [thing.middle[:2] + off * across[:2] for off in off_middle]
        for lean in TUNING.leaning if thing.beside else (0.0,):
            z = np.cos(lean) * down + np.sin(lean) * across
            quaternion = rotations.from_matrix(np.column_stack([np.cross(y, z), y, z]))
            found += [np.concatenate([quaternion, place, [height]]) for place in (*about, *walls) for height in heights]
    return np.array(found)


def why_not(thing: SeenThing, gripper: Gripper, grasps: Grasps) -> str:
    """Return in words why nothing of a thing can be grasped from above."""
    if len(thing.beyond):
        return "it goes on beyond the picture's border, and what is seen of it leaves no grasp"
    wide = narrowest(thing)
    if wide > gripper.opening_most:
        return (
            f"too wide: {100 * wide:.0f} cm at its narrowest, the fingers open to {100 * gripper.opening_most:.1f} cm"
        )
    return f"no grasp from above: {grasps.why_empty() or 'each is too slanted'}"


def filled_cells(thing: SeenThing) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.int64]]:
    """Return which cells (X, Y) of the plane a thing fills, as seen from above, and the first one's number (2,).

    What its outline encloses is filled but for holes through which the bottom is seen, see `Tuning.open`.
    """
    cells = np.floor(thing.points[:, :2] / TUNING.side).astype(np.int64)
    corner = cells.min(axis=0) - 2
    full = np.zeros(cells.max(axis=0) - corner + 3, dtype=bool)
    full[tuple((cells - corner).T)] = True
    full = ndimage.binary_closing(full)
    below, bottom = np.zeros_like(full), np.floor(thing.through[:, :2] / TUNING.side).astype(np.int64) - corner
    below[tuple(bottom[((bottom >= 0) & (bottom < full.shape)).all(axis=1)].T)] = True
    holes, count = ndimage.label(ndimage.binary_fill_holes(full) & ~full)
    share = np.atleast_1d(ndimage.mean(below, holes, np.arange(1, count + 1))) if count else np.zeros(0)
    return full | np.append(False, share <= TUNING.open)[holes], corner


def wall_middles(thing: SeenThing) -> list[Array]:
    """Return places (2,) in W, some way apart, in the middle of the walls of what has a hole; none: it has none [m]."""
    full, corner = filled_cells(thing)
    if (ndimage.binary_fill_holes(full) == full).all():
        return []
    deep = ndimage.distance_transform_edt(full)
    kept: list[Array] = []
    for x, y in np.argwhere(full & (deep >= ndimage.maximum_filter(deep, 3))):
        place = np.asarray((np.array([x, y]) + corner + 0.5) * TUNING.side, dtype=float)
        if all(float(np.hypot(*(place - other))) >= TUNING.apart for other in kept):
            kept.append(place)
    return kept


@dataclass(frozen=True)
class Lean:
    """How a thing leans that shows mostly one face.

    Attributes:
        R_LW: (3, 3) into a frame L in which that face is horizontal.
        bottom: height in L at which its sides end, as far as they are seen; -inf: they are not [m].
    """

    R_LW: Array
    bottom: float


def leaning(thing: SeenThing) -> Lean | None:
    """Return how a thing leans; None: it does not, or shows no face, or a hand along that face's normal is too slanted.

    Args:
        thing: as one picture shows it.
    """
    face = upper_face(thing)
    if face is None:
        return None
    normal = np.array([*-face[0][:2], 1.0])
    normal /= np.linalg.norm(normal)
    if not TUNING.steepest < normal[2] < np.cos(TUNING.tilted):
        return None
    axis = np.array([-normal[1], normal[0], 0.0])
    R_LW = rotations.matrix(rotations.exp(-axis / np.linalg.norm(axis) * np.arccos(normal[2])))
    below = float(np.quantile(thing.points @ normal, 0.02))
    top = float(np.median(face[1] @ normal))
    return Lean(R_LW, below if top - below > TUNING.shown else -np.inf)


def turned_by(thing: SeenThing, lean: Lean) -> SeenThing:
    """Return a thing in the frame L in which its upper face is horizontal."""
    return replace(
        thing,
        points=thing.points @ lean.R_LW.T,
        normals=thing.normals @ lean.R_LW.T,
        viewpoint=lean.R_LW @ thing.viewpoint,
        through=np.zeros((0, 3)),
        beyond=thing.beyond @ lean.R_LW.T,
    )


def leaning_poses(thing: SeenThing, gripper: Gripper, lean: Lean) -> Array:
    """Return tool poses (M, 7) in W that close across the sides of what leans, at every angle and some heights.

    The hand comes as straight down as that leaves it, along the normal of the face, or between: walls may bar one.
    """
    flat, down = turned_by(thing, lean), np.array([0.0, 0.0, -1.0])
    poses = upright_poses(flat, gripper, max(lean.bottom, float(flat.points[:, 2].min())), TUNING.up_and_down)
    places = poses[:, 4:] @ lean.R_LW
    found = []
    for quaternion in np.unique(poses[:, :4], axis=0):
        there = places[(poses[:, :4] == quaternion).all(axis=1)]
        R = lean.R_LW.T @ rotations.matrix(quaternion)
        steep = down - (down @ R[:, 1]) * R[:, 1]
        for share in TUNING.between:
            z = (1.0 - share) * steep / np.linalg.norm(steep) + share * R[:, 2]
            z /= np.linalg.norm(z)
            turned = rotations.from_matrix(np.column_stack([np.cross(R[:, 1], z), R[:, 1], z]))
            found.append(np.column_stack([np.tile(turned, (len(there), 1)), there]))
    return np.concatenate(found)


def guessed_sides(thing: SeenThing, floor: float, lean: Lean | None = None) -> tuple[Array, Array]:
    """Return points and outward normals (N, 3) of walls down from a thing's outlines.

    They go straight down from its outlines as seen from above, or along the normal of its face where that leans.

    Args:
        thing: that lies.
        floor: height at which the walls end [m].
        lean: how it leans.
    """
    if lean is None:
        return _walls(thing, floor)
    flat = turned_by(thing, lean)
    deep = float(flat.points[:, 2].min()) - (thing.top - floor)
    points, normals = _walls(flat, max(lean.bottom, deep))
    points, normals = points @ lean.R_LW, normals @ lean.R_LW
    over = points[:, 2] > floor
    return points[over], normals[over]


def _walls(thing: SeenThing, floor: float) -> tuple[Array, Array]:
    """Return points and outward normals (N, 3) of walls straight down from a thing's outlines, as seen from above."""
    full, corner = filled_cells(thing)
    top = np.full(full.shape, -np.inf)
    np.maximum.at(
        top, tuple((np.floor(thing.points[:, :2] / TUNING.side).astype(np.int64) - corner).T), thing.points[:, 2]
    )
    top = ndimage.maximum_filter(top, 3)
    inward = np.stack(np.gradient(ndimage.gaussian_filter(full.astype(float), TUNING.smooth)), axis=-1)
    rim = np.argwhere(full & ~ndimage.binary_erosion(full))
    slope = inward[tuple(rim.T)]
    length = np.linalg.norm(slope, axis=1)
    kept = (length > 1e-6) & np.isfinite(top[tuple(rim.T)])
    kept &= ~_cut_off(thing, corner, full)[tuple(rim.T)]
    rim, outward = rim[kept], -slope[kept] / length[kept, None]
    points, normals = [], []
    for (x, y), n, high in zip(rim, outward, top[tuple(rim.T)], strict=True):
        z = np.arange(floor, high, TUNING.side)
        place = np.asarray((np.array([x, y]) + corner + 0.5) * TUNING.side, dtype=float)
        points.append(np.column_stack([np.tile(place, (len(z), 1)), z]))
        normals.append(np.tile([*n, 0.0], (len(z), 1)))
    if not points:
        return np.zeros((0, 3)), np.zeros((0, 3))
    return np.vstack(points), np.vstack(normals)


def _cut_off(thing: SeenThing, corner: npt.NDArray[np.int64], full: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return which cells (X, Y) are beside those where a thing may go on beyond the picture's border."""
    cut = np.zeros_like(full)
    cells = np.floor(thing.beyond[:, :2] / TUNING.side).astype(np.int64) - corner
    cut[tuple(cells[((cells >= 0) & (cells < full.shape)).all(axis=1)].T)] = True
    return np.asarray(ndimage.binary_dilation(cut, iterations=TUNING.beside_cut))


def downward(grasps: Grasps) -> Array:
    """Return the numbers of grasps that come from above, the straightest of the good ones first."""
    down = -grasps.approach[:, 2]
    cost = grasps.score + TUNING.slanted * (1.0 - down) + TUNING.one_sided * (~grasps.seen).any(axis=1)
    order = np.argsort(cost + TUNING.shallow * by_tips(grasps), kind="stable")
    return np.asarray(order[down[order] >= TUNING.steepest])


def by_tips(grasps: Grasps) -> npt.NDArray[np.bool_]:
    """Return which grasps (N,) hold by the very tips of the pads."""
    ahead = np.einsum("nki,ni->nk", grasps.contacts - grasps.poses[:, None, 4:], grasps.approach)
    return np.asarray((np.where(grasps.seen, ahead, -np.inf) > TUNING.tip).any(axis=1))
