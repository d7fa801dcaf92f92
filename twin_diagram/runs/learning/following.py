"""Where the camera was about what the hand holds, picture by picture: by what is seen, with the arm as a first guess.

Frame S is the object's own: the tool's frame in the first picture. Each picture's points are registered, point to
plane, with what those before it have shown; the arm's motion is the prior. Where that does not explain a picture, the
object has slipped: then it is looked for farther away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from twin_diagram.assets.building.depth_view import make_view
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.runs.learning.display import HeldPicture, NothingHeld
from twin_diagram.runs.learning.motion import cloud_cells
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    beside: int = 8
    """Pixels about an object that are looked at with it."""

    points: int = 700
    """Of a picture that are registered."""

    least: int = 40
    """Of a picture; one that shows fewer is left out."""

    cell: float = 0.002
    """Edge of the cells in which the object's cloud keeps a point each [m]."""

    iterations: int = 12
    """Steps of a registration."""

    reach: float = 0.006
    """Farther from the cloud than this a point is not explained [m]."""

    far_reach: float = 0.03
    """The same at first where a slip is looked for [m]."""

    crept_reach: tuple[float, ...] = (0.02, 0.012)
    """The same where an object is found again that crept while it was swung, or was taken anew: by 1 or 2 cm."""

    facing: float = 0.6
    """Least cosine between a point's normal and the cloud's."""

    steady: tuple[float, float] = (0.0015, 0.01)
    """Standard deviation of what the arm's motion tells from one picture to the next: [m], [rad]."""

    loose: tuple[float, float] = (0.03, 0.3)
    """The same where a slip is looked for."""

    noise: float = 0.001
    """Standard deviation of a point's distance to the cloud [m]."""

    correlated: float = 40.0
    """Points whose errors are one and the same."""

    explained: float = 0.75
    """Share of a picture's points near the cloud in pictures that are well followed."""

    new_sides: float = 0.4
    """Share below which a slip is looked for though nothing contradicts: more than half is new in no picture."""

    contradicting: float = 0.08
    """Share of a picture's points beside a surface that is not theirs, from which a slip is looked for."""

    beside_surface: float = 0.02
    """How far off a surface a point is held against it [m]."""

    alike: float = 0.9
    """Least cosine between the normals of both."""

    better: float = 0.08
    """By how much more a slip must explain, where it does not clear up what contradicts."""

    slip: float = 0.003
    """What counts as a slip [m]."""

    turn: float = 0.05
    """The same of turning [rad]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Slip:
    """The object moved in the hand: at which picture, how far [m], how much it turned [rad]."""

    picture: int
    distance: float
    angle: float


@dataclass
class Followed:
    """What was followed so far.

    Attributes:
        shown: the pictures.
        X_ST: (4, 4) of the tool in the object's frame, one a picture.
        points: (N, 3) of the object in S [m], with normals (N, 3).
        slips: what moved in the hand.
        explained: share of each picture's points that lie on the cloud.
    """

    shown: list[HeldPicture] = field(default_factory=list)
    X_ST: list[Array] = field(default_factory=list)
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    normals: Array = field(default_factory=lambda: np.zeros((0, 3)))
    slips: list[Slip] = field(default_factory=list)
    explained: list[float] = field(default_factory=list)

    def camera_poses(self) -> list[Array]:
        """Return X_SC (4, 4) of each picture."""
        found = []
        for one, X_ST in zip(self.shown, self.X_ST, strict=True):
            X_WC = np.eye(4)
            X_WC[:3, :3], X_WC[:3, 3] = one.picture.camera.R_WC, one.picture.camera.p_WC
            found.append(X_ST @ np.linalg.solve(one.X_WT, X_WC))
        return found


def follow(
    so_far: Followed, more: Sequence[HeldPicture], X_ST: Array, known: tuple[float, float] = TUNING.steady
) -> Followed:
    """Return what was followed with more pictures of it.

    Args:
        so_far: empty for the first grasp.
        more: in the order in which they were taken, in one grasp.
        X_ST: (4, 4) first guess of the tool in S at the first of them.
        known: standard deviations of that guess [m], [rad].

    Raises:
        NothingHeld: none of them shows enough of it to be followed.
    """
    result = Followed(
        [*so_far.shown], [*so_far.X_ST], so_far.points, so_far.normals, [*so_far.slips], [*so_far.explained]
    )
    X, prior = X_ST.copy(), known
    for one in more:
        points, normals = _sampled(one)
        if len(points) < TUNING.least:
            continue
        if len(result.points):
            X, share = _located(result, points, normals, X, prior, len(result.shown))
        else:
            share = 1.0
        prior = TUNING.steady
        result.shown.append(one)
        result.X_ST.append(X)
        result.explained.append(share)
        _add(result, points @ X[:3, :3].T + X[:3, 3], normals @ X[:3, :3].T)
    if len(result.shown) == len(so_far.shown):
        raise NothingHeld(f"no picture can be followed: each of {len(more)} has under {TUNING.least} points with depth")
    return result


def follow_anew(seen: Followed, more: Sequence[HeldPicture], X_ST: Array, known: tuple[float, float]) -> Followed:
    """Return what was followed with pictures of it in another grasp.

    How it was taken is known by a picture of where it stood, which may show one face alone and then tells nothing along
    it. So all pictures tell together how it is held, before they are followed one by one: a first one that is off
    leaves points in the cloud to which later ones fit as well as to the true ones.

    Args:
        seen: what is known of it.
        more: in the order in which they were taken, in the other grasp.
        X_ST: (4, 4) first guess of the tool in S.
        known: standard deviations of that guess [m], [rad].

    Raises:
        NothingHeld: none of them shows enough of it to be followed.
    """
    found = found_again(seen, more, X_ST, known)
    return follow(seen, more, X_ST if found is None else found, known)


def found_again(
    seen: Followed, pictures: Sequence[HeldPicture], X_ST: Array, crept: tuple[float, float]
) -> Array | None:
    """Return the pose (4, 4) of the tool in S, of an object that moved in the hand and rests there now; None: unseen.

    All pictures are registered as one: what one side leaves open, another one tells.

    Args:
        seen: what is known of it.
        pictures: of it, in one grasp.
        X_ST: (4, 4) where it was thought to be.
        crept: by how much it may be off, as standard deviations [m], [rad].
    """
    parts = [part for part in map(_sampled, pictures) if len(part[0]) >= TUNING.least]
    if not parts:
        return None
    points, normals = (np.concatenate(rows) for rows in zip(*parts, strict=True))
    for reach in (*TUNING.crept_reach, TUNING.reach):
        X_ST, _ = register(seen.points, seen.normals, points, normals, X_ST, crept, reach)
    return X_ST


def _located(
    seen: Followed, points: Array, normals: Array, X: Array, prior: tuple[float, float], number: int
) -> tuple[Array, float]:
    """Return the tool's pose in S and the share of points explained; a slip is noted."""
    near, share = register(seen.points, seen.normals, points, normals, X, prior, TUNING.reach)
    contradicts = contradicting(seen, points, normals, near)
    # What contradicts nothing and is not explained is a side that was not seen before: turning what is round until it
    # lies upon one that was would explain it as well.
    if contradicts < TUNING.contradicting and share >= TUNING.new_sides:
        return near, share
    far = X
    for reach in (TUNING.far_reach, 0.5 * TUNING.far_reach, TUNING.reach):
        far, _ = register(seen.points, seen.normals, points, normals, far, TUNING.loose, reach)
    far, better = register(seen.points, seen.normals, points, normals, far, TUNING.steady, TUNING.reach)
    distance, angle = apart(X, far, points.mean(axis=0))
    clearer = contradicting(seen, points, normals, far) < 0.5 * contradicts or better > share + TUNING.better
    if not clearer or better < share or (distance < TUNING.slip and angle < TUNING.turn):
        return near, share
    seen.slips.append(Slip(number, distance, angle))
    return far, better


def contradicting(seen: Followed, points: Array, normals: Array, X: Array) -> float:
    """Return the share of points beside which the cloud has a surface that faces as they do, and is not theirs."""
    placed, facing = points @ X[:3, :3].T + X[:3, 3], normals @ X[:3, :3].T
    distance, index = cKDTree(seen.points).query(placed, distance_upper_bound=TUNING.beside_surface)
    there = np.isfinite(distance)
    index = np.where(there, index, 0)
    n = seen.normals[index]
    alike = there & (np.einsum("ni,ni->n", n, facing) > TUNING.alike)
    off = np.abs(np.einsum("ni,ni->n", n, seen.points[index] - placed))
    return float((alike & (off > TUNING.slip)).mean())


def apart(X_A: Array, X_B: Array, at: Array) -> tuple[float, float]:
    """Return how far two poses (4, 4) take a point (3,) apart [m], and the angle between them [rad]."""
    turn = X_A[:3, :3].T @ X_B[:3, :3]
    angle = float(np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)))
    there = [X[:3, :3] @ at + X[:3, 3] for X in (X_A, X_B)]
    return float(np.linalg.norm(there[0] - there[1])), angle


def register(
    cloud: Array,
    cloud_normals: Array,
    points: Array,
    normals: Array,
    X: Array,
    prior: tuple[float, float],
    reach: float,
    tree: cKDTree | None = None,
) -> tuple[Array, float]:
    """Return the pose (4, 4) that brings points onto a cloud, and the share of them that lie on it.

    Gauss-Newton on distances from point to plane, with a Gaussian prior about `X`, and Tukey's weights.

    Args:
        cloud: (N, 3) [m], with unit normals (N, 3).
        cloud_normals: of it.
        points: (M, 3) in the frame that is to be placed [m], with unit normals (M, 3).
        normals: of them.
        X: (4, 4) first guess, the middle of the prior.
        prior: its standard deviations [m], [rad].
        reach: farther apart, a point is not explained [m].
        tree: of the cloud; None: it is made.
    """
    tree = cKDTree(cloud) if tree is None else tree
    about = points.mean(axis=0)
    weights = np.concatenate([np.full(3, 1.0 / prior[1] ** 2), np.full(3, 1.0 / prior[0] ** 2)])
    total, now = np.zeros(6), X.copy()
    share = 0.0
    for _ in range(TUNING.iterations):
        placed, facing = points @ now[:3, :3].T + now[:3, 3], normals @ now[:3, :3].T
        distance, index = tree.query(placed, distance_upper_bound=reach)
        there = np.isfinite(distance)
        index = np.where(there, index, 0)
        n = cloud_normals[index]
        there &= np.einsum("ni,ni->n", n, facing) > TUNING.facing
        share = float(there.mean())
        if there.sum() < 12:
            break
        n, p = n[there], placed[there]
        centre = now[:3, :3] @ about + now[:3, 3]
        off = np.einsum("ni,ni->n", n, cloud[index[there]] - p)
        J = np.concatenate([np.cross(p - centre, n), n], axis=1)
        tukey = np.maximum(0.0, 1.0 - (off / reach) ** 2) ** 2 / (TUNING.noise**2 * TUNING.correlated)
        H = J.T @ (tukey[:, None] * J) + np.diag(weights)
        step = np.linalg.solve(H, J.T @ (tukey * off) - weights * total)
        total += step
        now = _moved(now, step, centre)
        if float(np.abs(step[:3]).max()) < 1e-4 and float(np.abs(step[3:]).max()) < 2e-5:
            break
    return now, share


def _moved(X: Array, twist: Array, about: Array) -> Array:
    """Return a pose (4, 4) turned about a point (3,) and shifted, by a twist (rotation, translation)."""
    R = rotations.matrix(rotations.exp(twist[:3]))
    result = np.eye(4)
    result[:3, :3] = R @ X[:3, :3]
    result[:3, 3] = R @ (X[:3, 3] - about) + about + twist[3:]
    return result


def _sampled(one: HeldPicture) -> tuple[Array, Array]:
    """Return points and normals (M, 3) of the object in the tool's frame, by the joints alone."""
    camera, window = one.picture.camera, _window(one.mask)
    view = make_view(_within(camera, window), one.picture.depth[window], one.mask[window])
    rows = np.argwhere(one.mask[window] & (view.trust > 0.15))
    rng = np.random.default_rng(len(rows))
    rows = rows[rng.permutation(len(rows))[: TUNING.points]]
    at = (rows[:, 0], rows[:, 1])
    R, p = one.X_WT[:3, :3], one.X_WT[:3, 3]
    rays = view.camera.rays()[at] * view.depth[at][:, None]
    return (rays @ camera.R_WC.T + camera.p_WC - p) @ R, (view.normals[at] @ camera.R_WC.T) @ R


def _window(mask: npt.NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the rows and columns about a mask, with room for the edges' neighbourhood."""
    spans = []
    for axis in (1, 0):
        there = np.flatnonzero(mask.any(axis=axis))
        spans.append(slice(max(0, int(there[0]) - TUNING.beside), int(there[-1]) + TUNING.beside + 1))
    return spans[0], spans[1]


def _within(camera: ViewCamera, window: tuple[slice, slice]) -> ViewCamera:
    """Return the camera of a window of its picture."""
    rows, columns = window
    height, width = (min(w.stop, size) - w.start for w, size in zip(window, (camera.height, camera.width), strict=True))
    return replace(camera, width=width, height=height, cx=camera.cx - columns.start, cy=camera.cy - rows.start)


def _add(seen: Followed, points: Array, normals: Array) -> None:
    """Add points to the object's cloud, where it has none yet."""
    if len(seen.points):
        distance, _ = cKDTree(seen.points).query(points, distance_upper_bound=TUNING.cell)
        new = ~np.isfinite(distance)
        points, normals = points[new], normals[new]
    if not len(points):
        return
    kept = _one_a_cell(points)
    seen.points = np.concatenate([seen.points, points[kept]])
    seen.normals = np.concatenate([seen.normals, normals[kept]])


def _one_a_cell(points: Array) -> Array:
    """Return the number of one point of each cell that points fill."""
    _, first = np.unique(np.floor(points / TUNING.cell).astype(np.int64), axis=0, return_index=True)
    return np.sort(first)


def cover(seen: Followed, edge: float = 0.01) -> Array:
    """Return a point of each cell of an edge [m] that the object fills (N, 3), in S."""
    return cloud_cells(seen.points, edge)
