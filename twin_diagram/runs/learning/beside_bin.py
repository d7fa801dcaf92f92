"""What lies on table or platform beside the bin: where its camera should see one of them and sees something higher."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from twin_diagram.errors import StationError
from twin_diagram.perception.segmentation.robot_shape import RobotShape
from twin_diagram.runs.learning.bin_view import TUNING as BIN_VIEW
from twin_diagram.runs.learning.bin_view import SeenThing, things_at, things_within
from twin_diagram.runs.learning.camera_check import KnownFaces
from twin_diagram.runs.learning.cell import Cell, Picture
from twin_diagram.runs.learning.motion import Mover
from twin_diagram.runs.learning.steady_picture import steady_picture
from twin_diagram.scenario import Learning
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    level: float = 0.002
    """Faces within this of the table's height are the table's [m]: a bin's bottom lies 7 mm higher."""

    upright: float = 0.99
    """Least vertical share of their normals."""

    stride: int = 2
    """Every n-th pixel in each direction tells what should be seen."""

    border: float = 4.0
    """Pixels of 640 a row beside what else should be seen there that do not count: the camera is known to one or two,
    and edges of depth smear over as many."""

    robot: float = 0.03
    """What is nearer to the arm is the arm's [m]: its shapes and its joints are not known better."""

    rim: float = 0.01
    """What is farther above the bin's rim than this is not the rim [m]: pictures are off by a few millimetres."""

    reach: float = 0.1
    """How far beside the bin what lies over its rim may reach [m]: half of the longest thing."""

    within: float = 0.5
    """Share of a thing's pixels in the bin from which it lies in it; of less it is seen as lying beside it."""

    over: float = 0.1
    """Share of a thing's points over the platform from which it lies on that, too: of one beside it edges smear over
    it by some pixels."""

    about: float = 0.25
    """How far from a thing upright faces are in the hand's way [m]: the hand's size."""

    apart: float = 0.008
    """Between points of such a face [m]: a finger is thrice as wide."""


TUNING = Tuning()


def lying(picture: Picture, learning: Learning, faces: KnownFaces, robot: RobotShape) -> list[SeenThing]:
    """Return what a picture shows in the bin, the highest first, and then what it shows beside the bin."""
    inside = things_in_bin(picture, learning, robot)
    theirs = np.zeros(picture.depth.shape, dtype=bool)
    for one in inside:
        theirs[tuple(one.pixels.T)] = True
    return inside + things_beside(picture, learning, faces, robot, theirs)


def things_in_bin(picture: Picture, learning: Learning, robot: RobotShape) -> list[SeenThing]:
    """Return what a picture shows in the bin, the highest first; what lies over its rim is one thing on both sides.

    Args:
        picture: of the bin's camera.
        learning: where the bin is.
        robot: whose arm may be seen over the rim, too.
    """
    low, high = (np.array(corner) for corner in learning.from_bin)
    points = picture.points()
    place, reach = points[..., :2], TUNING.reach
    inside = np.asarray(((place > low[:2]) & (place < high[:2])).all(-1))
    over = ((place > low[:2] - reach) & (place < high[:2] + reach)).all(-1) & (points[..., 2] > high[2] + TUNING.rim)
    rows = np.argwhere(over & ~inside & (picture.depth > 0))
    arm = robot.near(points[tuple(rows.T)], picture.q, TUNING.robot, picture.fingers)
    over[tuple(rows[arm].T)] = False
    found = list[SeenThing]()
    for one in things_within(picture, low, high, also=over):
        own = inside[tuple(one.pixels.T)]
        if own.mean() < TUNING.within:  # what is left of it in the bin stands for itself
            one = replace(one, points=one.points[own], normals=one.normals[own], pixels=one.pixels[own])
        found += [one] if len(one.points) >= BIN_VIEW.least else []
    return sorted(found, key=lambda thing: -thing.top)


def over_platform(thing: SeenThing, learning: Learning) -> bool:
    """Return whether some of a thing beside the bin lies over the platform."""
    low, high = (np.array(corner) for corner in learning.platform)
    return thing.beside and float(_within(thing.points, low, high).mean()) >= TUNING.over


def support_of(thing: SeenThing, learning: Learning) -> float:
    """Return the height that fingers stay above at a thing [m]: of the bin's bottom, the table, or the platform on it.

    What lies partly over the platform is taken above that, whatever its other end lies on.
    """
    if not thing.beside:
        return learning.from_bin[0][2]
    return learning.platform[1][2] if over_platform(thing, learning) else learning.platform[0][2]


def _within(points: Array, low: Array, high: Array) -> npt.NDArray[np.bool_]:
    """Return which points (..., 3) lie within or over a box between corners (3,), as seen from above."""
    return np.asarray(((points[..., :2] > low[:2]) & (points[..., :2] < high[:2])).all(-1))


def whole_of(thing: SeenThing) -> Array:
    """Return points (N, 3) of a thing and of where it may go on beyond the picture's border [m]."""
    return np.vstack([thing.points, thing.beyond])


def stand_about(mover: Mover, learning: Learning, things: Sequence[SeenThing]) -> None:
    """Keep ways clear of things in the bin and beside it."""
    for where, beside in (("bin", False), ("table", True)):
        some = [thing for thing in things if thing.beside == beside]
        support = learning.platform[0][2] if beside else learning.from_bin[0][2]
        mover.stand(where, [whole_of(thing) for thing in some], support)


def stand_about_rest(
    mover: Mover, cell: Cell, robot: RobotShape, learning: Learning, others: Sequence[SeenThing]
) -> None:
    """Keep ways clear of what lies in the bin once something was taken from it, and of what else was seen before.

    What touched the thing may have counted as part of it, and what leant on it fell. The arm may reach over the bin.
    Where the bin's camera has stopped meanwhile, what was seen before is all that is known.
    """
    try:
        picture = steady_picture(cell, learning.bin_camera)
    except StationError:
        return
    left = [
        one
        for one in things_in_bin(picture, learning, robot)
        if robot.near(one.points, picture.q, TUNING.robot, picture.fingers).mean() < 0.5
    ]
    stand_about(mover, learning, [*others, *left])


def things_beside(
    picture: Picture,
    learning: Learning,
    faces: KnownFaces,
    robot: RobotShape,
    others: npt.NDArray[np.bool_] | None = None,
) -> list[SeenThing]:
    """Return what a picture shows on the table, and on the platform, outside of bins, the highest first.

    What lies across the platform's edge, or leans on it, is one thing.

    Args:
        picture: of the bin's camera.
        learning: where bins and platform are; that stands on the table.
        faces: of what stands still, the table among them.
        robot: whose arm may be seen, too.
        others: (H, W) pixels of what lies in the bin, and over its rim.
    """
    table, (low, high) = learning.platform[0][2], (np.array(corner) for corner in learning.platform)
    points = picture.points()
    level = (faces.normal[:, 2] > TUNING.upright) & (np.abs(faces.middle[:, 2] - table) < TUNING.level)
    raised = (np.abs(faces.middle - 0.5 * (low + high)) < 0.5 * (high - low) + TUNING.level).all(axis=1)
    where = _faces_seen(picture, faces, np.array([level | raised, raised]))
    there = where[0] & ~where[1] & ~_within(points, low, high)
    # Beside the platform its sides and edges are seen, too; of what is higher than it they are no part.
    there |= where[0] & (points[..., 2] > high[2] + TUNING.rim)
    there &= picture.depth > 0
    for bottom, top in (learning.from_bin, learning.into_bin):
        there &= ~_within(points, np.array(bottom), np.array(top))
    if others is not None:
        there &= ~others
    rows = np.argwhere(there & (points[..., 2] > table + TUNING.level))
    arm = robot.near(points[tuple(rows.T)], picture.q, TUNING.robot, picture.fingers)
    there[tuple(rows[arm].T)] = False
    return [_stopped_by_bins(one, learning) for one in things_at(picture, there, table, beside=True)]


def _stopped_by_bins(thing: SeenThing, learning: Learning) -> SeenThing:
    """Return a thing beside the bins that may go on beyond the picture's border over their rims, not through walls."""
    free = np.ones(len(thing.beyond), dtype=bool)
    for bottom, top in (learning.from_bin, learning.into_bin):
        free &= ~_within(thing.beyond, np.array(bottom), np.array(top)) | (thing.beyond[:, 2] > top[2])
    return replace(thing, beyond=thing.beyond[free])


def _faces_seen(
    picture: Picture, faces: KnownFaces, kinds: npt.NDArray[np.bool_]
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Return where (H, W) a picture should surely show faces of a first kind, and may show some of a second one.

    Args:
        picture: as taken.
        faces: F of them, in W.
        kinds: (2, F) which are of each kind.
    """
    camera, step = picture.camera, slice(None, None, TUNING.stride)
    rays = camera.rays()[step, step] @ camera.R_WC.T
    which = faces.hit(camera.p_WC, rays.reshape(-1, 3))[0].reshape(rays.shape[:2])
    surely, maybe = (np.append(kind, False)[which] for kind in kinds)  # -1, no face, is the last one
    border = max(1, round(TUNING.border * camera.width / 640 / TUNING.stride))
    surely = ndimage.binary_erosion(surely, np.ones((3, 3)), border, border_value=1)
    maybe = ndimage.binary_dilation(maybe, np.ones((3, 3)), border)
    whole = np.kron(np.array([surely, maybe]), np.ones((1, TUNING.stride, TUNING.stride), dtype=bool))
    height, width = picture.depth.shape
    return whole[0, :height, :width], whole[1, :height, :width]


def upright_points(faces: KnownFaces, thing: SeenThing) -> list[Array]:
    """Return points (N, 3) of each upright face about a thing beside the bin, in random order, for fingers [m]."""
    if not thing.beside:
        return []
    found, rng = list[Array](), np.random.default_rng(0)
    for k in np.flatnonzero(np.abs(faces.normal[:, 2]) < 1.0 - TUNING.upright):
        a, b = (np.arange(-half, half + 1e-9, TUNING.apart) for half in faces.half[k])
        a, b = (grid.ravel() for grid in np.meshgrid(a, b))
        wall = faces.middle[k] + a[:, None] * faces.along[k, 0] + b[:, None] * faces.along[k, 1]
        wall = wall[np.linalg.norm(wall[:, :2] - thing.middle[:2], axis=1) < TUNING.about]
        found += [rng.permutation(wall)] if len(wall) else []
    return found
