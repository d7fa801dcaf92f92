"""What lies in the bin, by one picture: points of things, the highest first, and grasps of one of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from twin_diagram.assets.building.depth_view import make_view
from twin_diagram.perception.segmentation.parting import part
from twin_diagram.planning.grasps import (
    Grasps,
    Gripper,
    Wanted,
    estimated_normals,
    given_poses,
    propose,
    rank,
    target_of,
)
from twin_diagram.runs.learning.cell import Picture
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    above: float = 0.004
    """Height over the bin's bottom from which a point is a thing's [m]: thrice a good camera's noise there."""

    beside: float = 0.006
    """Distance from the bin's walls within which a point is theirs [m]."""

    least: int = 120
    """Pixels of the smallest thing: 1.5 cm square from 0.9 m."""

    noise: float = 0.001
    """Standard deviation of depth in the bin at the least [m]; it is that of the bottom in the picture."""

    certain: float = 4.0
    """Standard deviations over the bottom from which a point is a thing's, and from point to point a step."""

    bottom: float = 0.02
    """Within which of the bottom's height its points are looked for [m]."""

    few: int = 1000
    """Fewer points of the bottom do not tell its noise."""

    gap: float = 0.012
    """Step in depth at which one thing ends and another begins [m]."""

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


TUNING = Tuning()


@dataclass(frozen=True)
class SeenThing:
    """Something that lies in a bin or stands on the platform, as one picture shows it.

    Attributes:
        points: (N, 3) in W, in random order [m].
        normals: (N, 3) towards the camera.
        pixels: (N, 2) row and column.
        viewpoint: (3,) where the camera was.
        beside: whether it lies on the table beside the bin.
        through: (M, 3) points of what it lies on that are seen through its holes.
    """

    points: Array
    normals: Array
    pixels: npt.NDArray[np.int64]
    viewpoint: Array
    beside: bool = False
    through: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def middle(self) -> Array:
        """(3,) of the box about it [m]."""
        return np.asarray((self.points.min(axis=0) + self.points.max(axis=0)) / 2)

    @property
    def at(self) -> list[float]:
        """`middle` to millimetres, as lines tell it [m]."""
        return [round(float(value), 3) for value in self.middle]

    @property
    def top(self) -> float:
        """Height of its highest points [m]."""
        return float(np.quantile(self.points[:, 2], 0.98))


def things_within(
    picture: Picture, low: Array, high: Array, seed: int = 0, also: npt.NDArray[np.bool_] | None = None
) -> list[SeenThing]:
    """Return what a picture shows within a box, the highest first.

    Args:
        picture: of a camera that looks into it.
        low: (3,) lowest corner; its z is the bottom's upper side [m].
        high: (3,) highest corner; what stands out above it counts as well.
        seed: of the points' order.
        also: (H, W) which pixels count as well.
    """
    points = picture.points()
    inside = (points[..., :2] > low[:2] + TUNING.beside).all(-1) & (points[..., :2] < high[:2] - TUNING.beside).all(-1)
    inside = inside if also is None else inside | also
    return things_at(picture, inside & (picture.depth > 0), float(low[2]), seed)


def things_at(
    picture: Picture, there: npt.NDArray[np.bool_], support: float, seed: int = 0, *, beside: bool = False
) -> list[SeenThing]:
    """Return what stands out over a support among some pixels, the highest first.

    Args:
        picture: that shows it.
        there: (H, W) which pixels: with depth, of the support or of what lies on it.
        support: its height [m].
        seed: of the points' order.
        beside: whether that is the table beside the bin.
    """
    points = picture.points()
    noise = bottom_noise(points[there][:, 2] - support)
    above, gap = max(TUNING.above, TUNING.certain * noise), max(TUNING.gap, TUNING.certain * noise)
    depth = np.where(picture.depth > 0, picture.depth, 0).astype(np.float32)
    mask = there & (points[..., 2] > support + above)
    label, count = part(depth, mask, 1.0 / picture.camera.fx, noise, gap, TUNING.least)
    view = make_view(picture.camera, picture.depth, reach=1)
    normals = view.normals @ picture.camera.R_WC.T
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        own_mask = label == k
        rows = np.argwhere(own_mask)
        through = points[ndimage.binary_fill_holes(own_mask) & there & ~mask]
        rows = rows[rng.permutation(len(rows))]
        at = (rows[:, 0], rows[:, 1])
        # A rim is all edge, and has no normals of its own in the picture: its points' neighbours tell them.
        own, bare = normals[at], np.linalg.norm(normals[at], axis=1) < 0.5
        if bare.any():
            own = np.where(bare[:, None], estimated_normals(points[at], picture.camera.p_WC), own)
        found.append(SeenThing(points[at], own, rows, picture.camera.p_WC, beside, through))
    return sorted(found, key=lambda thing: -thing.top)


def bottom_noise(heights: Array) -> float:
    """Return the standard deviation of depth [m], by heights (N,) over a bottom of what is seen there and upon it [m].

    It is told by what lies below the bottom: above it there are things.
    """
    below = -heights[(heights < 0.0) & (heights > -TUNING.bottom)]
    return max(TUNING.noise, 1.4826 * float(np.median(below))) if len(below) >= TUNING.few else TUNING.noise


def grasps_of_thing(
    thing: SeenThing, gripper: Gripper, floor: float, surroundings: Array, seed: int = 0, *, count: int = 0
) -> Grasps:
    """Return grasps of a thing in W, the best first.

    Args:
        thing: that is to be taken.
        gripper: that takes it.
        floor: height that the fingers stay above [m].
        surroundings: (S, 3) points of what is in the way.
        seed: of the search.
        count: how many are asked for; 0: the usual number.
    """
    points, normals = thing.points[: TUNING.points], thing.normals[: TUNING.points]
    wanted = Wanted(count or TUNING.candidates, seed)
    # Nobody knows its weight: a usual one in the middle keeps grasps from its ends, where it would turn.
    told: dict[str, Any] = {
        "table": np.array([0.0, 0.0, 1.0, floor]),
        "mass": TUNING.usual_mass,
        "centre": thing.middle,
    }
    others = surroundings if len(surroundings) else None
    found = propose(points, normals, gripper, wanted=wanted, viewpoint=thing.viewpoint, surroundings=others, **told)
    if found.seen[downward(found)].all(axis=1).any():
        return found
    # Of what lies below the camera sides are hidden: they are guessed, straight down from its outline.
    sides, outward = guessed_sides(thing, floor)
    if not len(sides):
        return found
    target = target_of(
        np.vstack([points, sides]),
        np.vstack([normals, outward]),
        surroundings=others,
        **told,
    )
    poses = np.concatenate([found.poses, upright_poses(thing, gripper, floor)])
    guessed = rank(given_poses(poses), target, gripper, wanted)
    return guessed if len(guessed) else found


def upright_poses(thing: SeenThing, gripper: Gripper, floor: float) -> Array:
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
        about = [thing.middle[:2] + off * across[:2] for off in TUNING.beside_middle]
        for lean in TUNING.leaning if thing.beside else (0.0,):
            z = np.cos(lean) * down + np.sin(lean) * across
            quaternion = rotations.from_matrix(np.column_stack([np.cross(y, z), y, z]))
            found += [np.concatenate([quaternion, place, [height]]) for place in (*about, *walls) for height in heights]
    return np.array(found)


def narrowest(thing: SeenThing) -> float:
    """Return the least width of a thing from above, over all directions [m]."""
    angles = np.arange(TUNING.yaws) * (np.pi / TUNING.yaws)
    along = thing.points[:, :2] @ np.stack([np.cos(angles), np.sin(angles)])
    return float((np.quantile(along, 0.99, axis=0) - np.quantile(along, 0.01, axis=0)).min())


def why_not(thing: SeenThing, gripper: Gripper, grasps: Grasps) -> str:
    """Return in words why nothing of a thing can be grasped from above."""
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


def guessed_sides(thing: SeenThing, floor: float) -> tuple[Array, Array]:
    """Return points and outward normals (N, 3) of walls straight down from a thing's outlines, as seen from above.

    Args:
        thing: that lies.
        floor: height at which the walls end [m].
    """
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


def save_picture(path: Path, picture: Picture, thing: SeenThing | None, text: str) -> None:
    """Write a picture with a box about a thing and a line of text: what a report shows."""
    image = cv2.cvtColor(picture.rgb, cv2.COLOR_RGB2BGR)
    if thing is not None:
        (v0, u0), (v1, u1) = thing.pixels.min(axis=0) - 4, thing.pixels.max(axis=0) + 4
        cv2.rectangle(image, (int(u0), int(v0)), (int(u1), int(v1)), (40, 40, 230), 2)
    cv2.putText(
        image, text.encode("ascii", "replace").decode(), (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (20, 20, 20), 1
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    good, data = cv2.imencode(".png", image)
    assert good
    path.write_bytes(data.tobytes())
