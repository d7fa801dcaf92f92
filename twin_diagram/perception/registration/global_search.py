"""Finds a known object without a prediction: which segment it is, and its pose.

An object rests on a facet of its convex hull. For every such facet and many yaw angles, starts are laid where the
object's visible points would have the segment's centre; all are refined together on coarse colours, the best few
exactly; shape and colour decide.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from twin_diagram import scenario
from twin_diagram.perception.registration.alternatives import TUNING as ALTERNATIVES
from twin_diagram.perception.registration.alternatives import PoseHypothesis, votes
from twin_diagram.perception.registration.approach import approach, rivals
from twin_diagram.perception.registration.assessment import assess
from twin_diagram.perception.registration.colour_shift import TUNING as COLOUR_SHIFT
from twin_diagram.perception.registration.colour_shift import learnt
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.height import extent
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.outline import height_above
from twin_diagram.perception.registration.point_kernels import COARSE, FINE
from twin_diagram.perception.registration.registration import RegisteredPose, information, refine, register
from twin_diagram.perception.registration.resting import TIPPED
from twin_diagram.perception.registration.rotation import exp
from twin_diagram.perception.registration.settling import settle
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the search, chosen by hand between its time and what it misses.

    `tests/perception/registration` searches for objects in poses drawn at random, `sims/closed_loop.py --seeds 20`
    for those of the tabletop.
    """

    yaws: int = 24
    """Starts about the vertical, 15° apart."""

    coarse_points: int = 110
    """Model points per start."""

    coarse_iterations: int = 6
    """Gauss-Newton steps of each start."""

    candidates: int = 4
    """Starts that are refined exactly."""

    most_starts: int = 96
    """Of more starts, those that fit best as they are laid are kept."""

    first_look: int = 36
    """Model points by which very many starts are looked through first: a third of `coarse_points`, …"""

    looked_again: int = 192
    """… and as many of them by all: twice what is kept."""

    thin: int = 200
    """Points of a segment that take part in exact registration."""

    sure: float = 0.85
    """A score from which nothing else is tried."""

    surer: float = 0.95
    """The same about a rough pose: slides along a box score high, too."""

    hopeless: float = 0.6
    """A start whose coarse score is this share of the best one's is not refined exactly."""

    vain: float = 0.05
    """A search whose best start scores less, refined coarsely, is given up: of 84 such searches (eight things, D435 and
    Kinect, seeds 2 to 4) none came to more than 0.08 in the end, where 0.27 is the least that is ever accepted."""

    least_visible: float = 0.2
    """An object of which less can be seen is not recognised."""

    least_points: int = 60
    """Nor one of which fewer model points fit."""

    upon: float = 0.02
    """What begins higher above the table may lie on something [m]: of what stands there noise and shadows hide less."""

    flat: float = 0.003
    """Points this near to a lid are its own [m]."""

    alignments: int = 3
    """Colours are aligned to depth in so many steps, of two pixels at most."""


TUNING = Tuning()


RESTING: Final = np.array([TIPPED**-2, TIPPED**-2, 0.15**-2, 0.04**-2, 0.04**-2, 0.003**-2])
"""Information of a start: what rests on a table neither tips nor floats."""


@dataclass(frozen=True)
class Found:
    """An object recognised in a segment.

    Attributes:
        registration: the pose.
        score: quality times the share of the segment that the object explains.
        likeness: the same from the registration's likeness: which of several poses is the best.
        hypotheses: poses that the image allows, where they were weighed; the likeliest first.
        others: that were tried.
    """

    registration: RegisteredPose
    score: float
    likeness: float
    hypotheses: tuple[PoseHypothesis, ...] = ()
    others: tuple[RegisteredPose, ...] = ()


def starts(model: ModelCloud, frame: Frame, points_W: Array, orientations: list[tuple[Array, float]]) -> Poses:
    """Return the poses at rest on the table whose visible points would have the segment's centre.

    Where the segment begins above the table, as many rest as high as it begins: on a box's lid, all of which it hides.
    Where a lid is part of it, as many rest on that.

    Where the segment is narrower than the object should appear (something hides a part of it), or wider (two things are
    in one segment), more are laid to the left and right of the line of sight.
    """
    camera = frame.camera
    centre = points_W.mean(axis=0)
    towards = camera.p_WC - centre
    towards /= np.linalg.norm(towards)
    side = np.array([-towards[1], towards[0], 0.0]) / max(float(np.hypot(*towards[:2])), 1e-9)
    R_rest = np.stack([R for R, _ in orientations])
    yaw = np.arange(TUNING.yaws) * (2 * np.pi / TUNING.yaws)
    turn = exp(np.stack([np.zeros(TUNING.yaws), np.zeros(TUNING.yaws), yaw], axis=1))
    R: Array = (turn[None] @ R_rest[:, None]).reshape(-1, 3, 3)
    height = np.repeat([h for _, h in orientations], TUNING.yaws)
    r, offset = shown_by(model, R, towards)
    across = (r @ side).max(axis=1) - (r @ side).min(axis=1)
    along = (points_W - centre) @ side
    low, high = np.percentile(along, [2.0, 98.0])
    slack = across - (high - low)
    p = centre - offset
    # Against either end of the segment, where that differs from the middle.
    far = np.flatnonzero(np.abs(slack) > 0.015)
    left = p[far] + ((low + high) / 2 + slack[far] / 2)[:, None] * side
    right = p[far] + ((low + high) / 2 - slack[far] / 2)[:, None] * side
    R = np.concatenate([R, R[far], R[far]])
    p = np.concatenate([p, left, right])
    height = np.concatenate([height, height[far], height[far]])
    p[:, 2] = frame.table[0] * p[:, 0] + frame.table[1] * p[:, 1] + frame.table[2] + height
    raised = _raised(frame, points_W)
    if raised:
        R, p = np.concatenate([R] * (1 + len(raised))), np.concatenate([p, *(p + [0.0, 0.0, up] for up in raised)])
    return Poses(R, p)


def _raised(frame: Frame, points_W: Array) -> list[float]:
    """Return how high above the table a segment may lie: as high as it begins, and on lids that are part of it [m]."""
    if not frame.planes:  # No table in view: nothing tells how high above one anything begins.
        return []
    low, top = extent(points_W, frame.table)
    found = [low] if low > TUNING.upon else []
    for plane in frame.planes:
        on = points_W[np.abs(plane.height(points_W)) < TUNING.flat]
        if plane.part >= 0 and len(on) >= TUNING.least_points:
            up = float(np.median(height_above(frame.table, on)))
            if low + TUNING.upon < up < top - TUNING.upon:
                found.append(up)
    return found


def explained(model: ModelCloud, points_W: Array, registration: RegisteredPose, reach: float = 0.008) -> float:
    """Return the share of points within `reach` [m] of the object's surface."""
    distance, _ = model.nearest.query((points_W - registration.p) @ registration.R, reach + model.spacing / 2)
    return float(np.isfinite(distance).mean())


def search(
    model: ModelCloud,
    frame: Frame,
    points_W: Array,
    orientations: list[tuple[Array, float]],
    params: scenario.Registration,
    least: float = 0.0,
) -> Found | None:
    """Look for one object in one segment.

    Args:
        model: the object.
        frame: the image.
        points_W: (N, 3) the segment's points.
        orientations: those of `resting` that are tried.
        params: tuning.
        least: given up where no start has such a `coarse_score` once it is refined coarsely.

    Returns:
        The best pose, whatever its score; None where the segment is far too large for the object or nothing fits at
        all.
    """
    spread = np.linalg.norm(points_W - points_W.mean(axis=0), axis=1)
    if not orientations or np.median(spread) > 2.0 * model.radius + params.reach:
        return None
    thin = points_W[:: max(1, len(points_W) // TUNING.thin)]
    laid = starts(model, frame, points_W, orientations)
    laid = best_as_laid(model, frame, laid, TUNING.first_look, TUNING.looked_again)
    laid = best_as_laid(model, frame, laid, TUNING.coarse_points, TUNING.most_starts)
    sure = TUNING.sure if model.coloured else np.inf
    return best_of(model, frame, laid, thin, RESTING, params, sure, max(least, TUNING.vain))


def best_as_laid(model: ModelCloud, frame: Frame, laid: Poses, points: int, most: int) -> Poses:
    """Return the starts that fit best as they are laid, by so many model points: `most` of them."""
    if len(laid.p) <= most:
        return laid
    fit = assess(model, frame, laid, points, COARSE, slack=0.015)
    enough = 20.0 * points / TUNING.coarse_points
    return laid[np.argsort(-fit.likeness * np.minimum(fit.points, enough), kind="stable")[:most]]


def shown_by(model: ModelCloud, R: Array, towards: Array) -> tuple[Array, Array]:
    """Return what a camera `towards` (3,) in W sees of an object turned by R (B, 3, 3), from O.

    Returns:
        (B, P, 3) points, and (B, 3) their middle, each as squarely as it is seen.
    """
    view = np.argmax((towards @ R) @ model.directions.T, axis=1)
    index = model.views[view, : TUNING.coarse_points]
    r = model.points[index] @ R.transpose(0, 2, 1)
    facing = np.maximum((model.normals[index] @ R.transpose(0, 2, 1)) @ towards, 0.05)
    return r, (r * facing[..., None]).sum(axis=1) / facing.sum(axis=1)[:, None]


def nearby(
    model: ModelCloud,
    frame: Frame,
    R: Array,
    p: Array,
    points_W: Array,
    normals_W: Array,
    params: scenario.Registration,
) -> Found | None:
    """Look for an object around a rough pose: a few centimetres, some ten degrees.

    Args:
        model: the object.
        frame: the image.
        R: (3, 3) rough R_WO.
        p: (3,) rough p_WO [m].
        points_W: (N, 3) points around it, best those of the object alone.
        normals_W: (N, 3) theirs, towards the camera.
        params: tuning.

    Returns:
        The best pose, whatever its score; None where nothing fits at all.
    """
    every = max(1, len(points_W) // TUNING.thin)
    thin = points_W[::every]
    params = with_colours_beside(model, frame, Poses(R[None], p[None]), params)
    start, prior = Poses(R[None], p[None]), information(0.3, 0.05)
    near, weight = approach(model, thin, normals_W[::every], start, prior)
    laid = rivals(near, weight)
    step = np.array([-0.03, 0.0, 0.03])
    # Where other things stand about, their points may lead astray.
    shift = np.array(np.meshgrid(step, step, [0.0])).T.reshape(-1, 3)
    laid = Poses(np.concatenate([laid.R, np.repeat(start.R, len(shift), axis=0)]), np.concatenate([laid.p, p + shift]))
    found = best_of(model, frame, laid, thin, information(0.2, 0.03), params, TUNING.surer)
    if found is None:
        return None
    result = settle(model, frame, [found.registration, *found.others], thin, params)
    return replace(found, registration=result.registration, hypotheses=result.hypotheses)


def with_colours_beside(
    model: ModelCloud, frame: Frame, rough: Poses, params: scenario.Registration
) -> scenario.Registration:
    """Return a tuning in which colours count as much more beside depth as more of its points err alike than usual.

    Only where it is certain that they lie on depth's pixels.

    Args:
        model: the object.
        frame: the image.
        rough: about one pose.
        params: tuning.
    """
    if not frame.shift.certain:
        return params
    share = votes(look(model, frame, rough, params.model_points, FINE), frame, model.spacing)
    colours = params.colour_weight * share / ALTERNATIVES.fewest
    return replace(params, colour_weight=colours / (1.0 - params.colour_weight + colours))


def best_of(
    model: ModelCloud,
    frame: Frame,
    laid: Poses,
    points_W: Array,
    prior: Array,
    params: scenario.Registration,
    sure: float = TUNING.sure,
    least: float = 0.0,
) -> Found | None:
    """Refine all starts on coarse colours and the best few exactly; the pose that explains most.

    A score of `sure` ends it, as one below `least` does before anything was refined exactly: then there is none.
    """
    poses = refine(model, frame, laid, TUNING.coarse_points, TUNING.coarse_iterations, prior, params, coarse_only=True)
    score = coarse_score(model, frame, poses)
    if score.max() < least:
        return None
    best: Found | None = None
    tried: list[RegisteredPose] = []
    for k in well_apart(poses, np.argsort(-score, kind="stable")):
        if score[k] < TUNING.hopeless * score.max() or (best is not None and best.score >= sure):
            break
        result = register(model, frame, poses.R[k], poses.p[k], params, points_W=points_W)
        tried.append(result)
        rest = judged(model, points_W, result)
        if best is None or result.likeness * rest > best.likeness:
            best = Found(result, result.quality * rest, result.likeness * rest)
    if best is None:
        return None
    best = replace(best, others=tuple(one for one in tried if one is not best.registration))
    return best if best.score >= sure else with_colours_aligned(model, frame, best, points_W, params)


def coarse_score(model: ModelCloud, frame: Frame, poses: Poses) -> Array:
    """Return how well a few points at each of B poses fit, before anything is refined exactly; (B,), from 0 to 1."""
    fit = assess(model, frame, poses, TUNING.coarse_points, COARSE, slack=0.005)
    seen = np.minimum(fit.visible_share / TUNING.least_visible, 1.0) * np.minimum(fit.points / 20.0, 1.0)
    result: Array = fit.likeness * seen
    return result


def with_colours_aligned(
    model: ModelCloud, frame: Frame, found: Found, points_W: Array, params: scenario.Registration
) -> Found:
    """Register an object anew with its colours shifted by what it tells of their shift, as long as that fits better.

    Before anything was found that shift may be several pixels, and colours so far aside look like another thing's.

    Args:
        model: the object.
        frame: the image.
        found: the object.
        points_W: (N, 3) the segment's points.
        params: tuning.
    """
    best, result, shift = found, found.registration, frame.shift
    for _ in range(TUNING.alignments):
        if result.evidence is None:
            break
        before, shift = shift, learnt(shift, [result.evidence])
        if np.linalg.norm(shift.mean - before.mean) < COLOUR_SHIFT.floor:
            break  # known as well as it ever is
        result = register(model, replace(frame, shift=shift), result.R, result.p, params, points_W=points_W)
        share = judged(model, points_W, result)
        if result.quality * share > best.score:
            best = replace(best, registration=result, score=result.quality * share, likeness=result.likeness * share)
    return best


def judged(model: ModelCloud, points_W: Array, result: RegisteredPose) -> float:
    """Return what a registration's quality is multiplied by: how much is to be seen of it, and of what is seen its."""
    visible = min(result.visible_share / TUNING.least_visible, 1.0) * min(result.points / TUNING.least_points, 1.0)
    return visible * (0.4 + 0.6 * explained(model, points_W, result))


def well_apart(poses: Poses, order: npt.NDArray[np.int64]) -> list[int]:
    """Return the first few in `order` that differ from one another by more than 10° or 1 cm."""
    chosen: list[int] = []
    for k in order:
        if all(
            np.linalg.norm(poses.p[k] - poses.p[j]) > 0.01 or np.trace(poses.R[k].T @ poses.R[j]) < 2.97 for j in chosen
        ):
            chosen.append(int(k))
        if len(chosen) == TUNING.candidates:
            break
    return chosen
