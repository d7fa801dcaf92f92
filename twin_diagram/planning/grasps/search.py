"""The search for grasps: ten Pas's grid about Darboux frames, then the thesis's search over what the grid leaves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from twin_diagram.planning.grasps.gripper import Gripper
from twin_diagram.planning.grasps.judging import Judged, settle, view
from twin_diagram.planning.grasps.surface_frames import Indices, darboux_frames, edge_frames
from twin_diagram.planning.grasps.target import GraspTarget
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen for the objects that come along and six of YCB's: time against quality."""

    samples: int = 32
    """Points at which frames are set up."""

    looked_for_edges: int = 200
    """Where edges are looked for they are the nearest to one among so many more: a rim is a fiftieth of a bowl."""

    grid_points: int = 600
    """Points of the cloud that the grid looks at; the rest of the search sees all of them."""

    tilts: tuple[float, ...] = (-90.0, -45.0, 45.0, 90.0)
    """Rotations about the axis of least curvature (the thesis's z), beside none [deg]; a rim is held along its wall."""

    turns: int = 8
    """Rotations about the approach over half a turn: on flat sides the Darboux frame leaves it open."""

    offsets: tuple[float, ...] = (-0.3, 0.0, 0.3)
    """Shifts along the closing axis, in openings."""

    kept: tuple[int, ...] = (28, 12)
    """Poses that are searched around, in each round; from round to round steps are half as long."""

    points: tuple[int, ...] = (1000, 1500)
    """Points of the cloud that a round looks at, at the most."""

    kept_of_one: int = 4
    """Of one sampled point at the most."""

    nod: float = 20.0
    """Tilt about the closing axis that is tried to either side [deg]."""

    slide: float = 0.008
    """Shift across the fingers that is tried to either side [m]."""


TUNING = Tuning()


def grid(
    target: GraspTarget, gripper: Gripper, rng: np.random.Generator, edges: bool = False
) -> tuple[Judged, Indices]:
    """Look at a grid of poses about frames at sampled points, each pushed to contact; with the point of each.

    Steps 1 to 5 of the sampling in *Scalable Real2Sim* (Algorithm 2 of ten Pas et al.): sample points, set up the
    frame with the palm against the normal, shift along the closing axis and turn about the axis of least curvature,
    push on until right before contact, keep what collides with nothing and has a point between the fingers.

    Args:
        target: the object.
        gripper: opened all the way.
        rng: draws the points.
        edges: whether points are to be at edges, and looked at from over these, too.
    """
    chosen, over_edges = _sampled(target, rng, edges)
    D = darboux_frames(target.points[: target.own], target.normals[: target.own], chosen)
    turns = np.arange(TUNING.turns) * np.pi / TUNING.turns
    quarter = np.pi / 2 * np.arange(2)
    angles = [(0.0, turn) for turn in turns] + [(np.deg2rad(tilt), turn) for tilt in TUNING.tilts for turn in quarter]
    # A tilt is about x of the frame before or after a quarter turn: about either axis of curvature.
    local = np.stack([_about(2, turn) @ _about(0, tilt) for tilt, turn in angles])
    R = np.concatenate([np.einsum("mij,ajk->maik", D, local), over_edges], axis=1)
    each, R = R.shape[1], R.reshape(-1, 3, 3)
    p = np.repeat(target.points[chosen], each, axis=0)
    thin = target.thinned(TUNING.grid_points)
    shifts = np.array(TUNING.offsets) * gripper.opening_most
    ahead = view(thin, gripper, R, p, thin.spacing / 2, aside=float(np.abs(shifts).max()))
    found = stacked([settle(thin, gripper, R, p, ahead, np.full(len(R), shift)) for shift in shifts])
    return found, np.tile(np.repeat(np.arange(len(chosen)), each), len(shifts))


def _sampled(target: GraspTarget, rng: np.random.Generator, edges: bool) -> tuple[Indices, Array]:
    """Return (K,) sampled points and frames (K, 0 or 1, 3, 3) of a gripper that comes over the edge next to each."""
    more = TUNING.looked_for_edges if edges else 0
    drawn = rng.permutation(target.own)[: TUNING.samples + more]
    if not edges:
        return drawn, np.empty((len(drawn), 0, 3, 3))
    frames, near = edge_frames(target.points[: target.own], target.normals[: target.own], drawn)
    kept = np.argsort(-near, kind="stable")[: TUNING.samples]
    return drawn[kept], frames[kept][:, None]


def refine(target: GraspTarget, gripper: Gripper, found: Judged, of: Indices) -> list[Judged]:
    """Search around the best poses of a grid over what it left: along x, about x, y and z, and back along z.

    The contacts' normals say how the closing axis had better turn, and the middle between them where it had better
    be: these steps are taken at once, and the rest is tried to either side.

    Args:
        target: the object.
        gripper: opened all the way.
        found: of `grid`.
        of: (K,) the sampled point of each pose.

    Returns:
        all that was looked at, of the last round last.
    """
    kept = _best_of_each(found.score, of, TUNING.kept_of_one)
    best = taken(found, kept[: TUNING.kept[0]])
    every: list[Judged] = []
    for kept_now, points in zip(TUNING.kept, TUNING.points, strict=True):
        if not len(best.p):
            break
        best = taken(best, np.argsort(best.score, kind="stable")[:kept_now])
        R, p = _neighbours(target, best, 0.5 ** (len(every) // 2))
        shape = R.shape[:2]
        R, p = R.reshape(-1, 3, 3), p.reshape(-1, 3)
        thin = target.thinned(points)
        ahead, none = view(thin, gripper, R, p, thin.spacing / 2), np.zeros(len(R))
        pushed = settle(thin, gripper, R, p, ahead, none)
        depth = np.einsum("ki,ki->k", pushed.p - p, R[:, :, 2]) - _too_deep(gripper, pushed)
        every += [pushed, settle(thin, gripper, R, p, ahead, none, depth)]
        both = stacked(every[-2:])
        # Each neighbourhood's poses stand together, twice: pushed on, and moved back.
        score = both.score.reshape(2, *shape).transpose(1, 0, 2).reshape(shape[0], -1)
        back, way = np.divmod(score.argmin(axis=1), shape[1])
        best = taken(both, (back * shape[0] + np.arange(shape[0])) * shape[1] + way)
    return every


@cache
def _about(axis: int, angle: float) -> Array:
    """Return the rotation (3, 3) by an angle [rad] about x, y or z, read-only: it is kept."""
    result = rotations.matrix(rotations.exp(angle * np.eye(3)[axis]))
    result.setflags(write=False)
    return result


def _best_of_each(score: Array, of: Indices, most: int) -> Indices:
    """Return indices by ascending score, of finite ones, at most so many of one point."""
    order = np.argsort(score, kind="stable")
    order = order[np.isfinite(score[order])]
    by_point = np.argsort(of[order], kind="stable")
    points = of[order][by_point]
    first = np.searchsorted(points, points)
    rank = np.empty(len(order), dtype=np.intp)
    rank[by_point] = np.arange(len(order)) - first
    return order[rank < most]


def _neighbours(target: GraspTarget, best: Judged, step: float) -> tuple[Array, Array]:
    """Return axes (K, V, 3, 3) and origins (K, V, 3) of V poses around each of K."""
    normal = best.closing.normal[:, 0] - best.closing.normal[:, 1]
    # Where a contact's side was not seen, the other one's normal alone tells.
    one = np.einsum("ks,ksi->ki", best.seen * np.array([1.0, -1.0]), best.closing.normal)
    normal = np.where(best.seen.all(axis=1, keepdims=True), normal, one)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    y = np.array([0.0, 1.0, 0.0])
    axis = np.cross(y, normal)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, normal[:, 1:2])
    to_normals = rotations.matrix(rotations.exp(axis / np.maximum(sine, 1e-9) * angle))
    nod, slide = np.deg2rad(TUNING.nod) * step, TUNING.slide * step
    # Whether the closing axis follows the normals, tilt about it, slide along x; whether the contacts are centred,
    # or the shift along y stays: in a cup there is no room for a finger where the wall would be in the middle.
    far = 2 * nod
    ways = [(1, 0.0, 0.0, 1), (1, 0.0, 0.0, 0), (0, 0.0, 0.0, 0), (1, nod, 0.0, 1), (1, -nod, 0.0, 1), (1, far, 0.0, 1)]
    ways += [(1, -far, 0.0, 1), (1, 0.0, slide, 1), (1, 0.0, -slide, 1), (1, 0.0, np.nan, 1), (1, 0.0, np.nan, 0)]
    turned = [(to_normals if follow else np.eye(3)) @ _about(1, tilt) for follow, tilt, _, _ in ways]
    R = np.stack([best.R @ turn for turn in turned], axis=1)
    # About the middle between the contacts, so that a turn does not lead away from what was held.
    held = best.closing.contact.mean(axis=1)
    held[:, 1] = best.closing.middle
    middle = best.p + np.einsum("kij,kj->ki", best.R, held)
    centre = target.points[: target.own].mean(axis=0) if target.centre is None else target.centre
    towards = np.einsum("ki,ki->k", centre - middle, np.einsum("kij,kj->ki", best.R, to_normals[:, :, 0]))
    towards = np.clip(towards, -4 * TUNING.slide, 4 * TUNING.slide)
    x = np.array([length for _, _, length, _ in ways])
    moved = np.empty((len(best.p), len(ways), 3))
    moved[:, :, 0] = np.where(np.isnan(x), towards[:, None], x)
    moved[:, :, 1] = -held[:, 1:2] * (1 - np.array([centred for *_, centred in ways]))
    moved[:, :, 2] = -held[:, 2:]
    return R, middle[:, None] + np.einsum("kvij,kvj->kvi", R, moved)


def _too_deep(gripper: Gripper, pushed: Judged) -> Array:
    """Return how far (K,) the contacts are behind the pads' middle [m]; 0 where they are before it."""
    middle = (gripper.pad_front + gripper.pad_back) / 2
    return np.asarray(np.maximum(middle - pushed.closing.contact[:, :, 2].mean(axis=1), 0.0))


def taken(found: Judged, kept: Indices) -> Judged:
    """Return some poses."""
    closing = type(found.closing)(*(getattr(found.closing, name)[kept] for name in vars(found.closing)))
    terms = {name: term[kept] for name, term in found.terms.items()}
    return Judged(found.R[kept], found.p[kept], found.code[kept], closing, found.seen[kept], terms)


def stacked(parts: list[Judged]) -> Judged:
    """Return poses one after another."""
    first = parts[0]
    closing = type(first.closing)(
        *(np.concatenate([getattr(part.closing, name) for part in parts]) for name in vars(first.closing))
    )
    terms = {name: np.concatenate([part.terms[name] for part in parts]) for name in first.terms}
    rows = (np.concatenate([getattr(part, name) for part in parts]) for name in ("R", "p", "code"))
    R, p, code = rows
    return Judged(R, p, code, closing, np.concatenate([part.seen for part in parts]), terms)
