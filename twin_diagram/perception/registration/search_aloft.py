"""Looks for an object in the air, by what nothing hides of it: turned much as it was when it was seen last, or anyhow.

What hangs has no facet to stand on: where nobody has seen it yet, all directions that it may show are tried.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram import scenario
from twin_diagram.perception.registration.assessment import assess
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.global_search import TUNING as SEARCH
from twin_diagram.perception.registration.global_search import Found, best_of, shown_by, well_apart
from twin_diagram.perception.registration.height import extent
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import COARSE
from twin_diagram.perception.registration.registration import information, refine
from twin_diagram.perception.registration.rotation import exp
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of searching in the air, set on Table I of SyncTwin and `sims/benchmarks/followed_scenes.py`."""

    tilt: tuple[float, float] = (0.45, 1.2)
    """In the air an object may have turned about any axis since it was seen last, in steps of the first, up to the
    second [rad]: registration finds back from half a step; hands turn things by 18° from image to image."""

    before: float = 0.03
    """What is seen so far before a model point hides it [m]: see `assessment`'s `same_surface`."""

    rolls: int = 12
    """Starts about the line of sight for each direction from which a model's views are told, 30° apart."""

    own: float = 0.008
    """Points this near to an object's surface are its own [m]."""

    high: float = 0.3
    """What begins so high above what things stand on hangs there, or is held: few things bear others so high [m]."""

    settling: int = 4
    """Half hidden starts are laid anew so often with what is not hidden of them where the segment is: each halves what
    is left."""


TUNING = Tuning()


def afloat(model: ModelCloud, frame: Frame, points_W: Array, R: Array, params: scenario.Registration) -> Found | None:
    """Look for one object in one segment, in the air, turned somehow as it was when it was seen last.

    Args:
        model: the object.
        frame: the image.
        points_W: (N, 3) the segment's points.
        R: (3, 3) R_WO when it was seen last.
        params: tuning.

    Returns:
        The best pose, whatever its score; None where the segment is far too large for the object or nothing fits.
    """
    spread = np.linalg.norm(points_W - points_W.mean(axis=0), axis=1)
    if np.median(spread) > 2.0 * model.radius + params.reach:
        return None
    step, most = TUNING.tilt
    ways = step * np.arange(-int(most / step), int(most / step) + 1)
    turn = np.stack(np.meshgrid(ways, ways, ways), axis=-1).reshape(-1, 3)
    R_any = exp(turn[np.linalg.norm(turn, axis=1) <= most]) @ R
    centre, towards = _sight(frame, points_W)
    laid = centred(model, frame, Poses(R_any, centre - shown_by(model, R_any, towards)[1]), centre)
    thin = points_W[:: max(1, len(points_W) // SEARCH.thin)]
    return best_of(model, frame, laid, thin, information(0.3, 0.05), params)


def hangs(frame: Frame, points_W: Array) -> bool:
    """Return whether what a segment (N, 3) shows stands on nothing in view: no plane is, or it begins far above."""
    return not frame.planes or extent(points_W, frame.table)[0] > TUNING.high


def anyhow(model: ModelCloud, frame: Frame, points_W: Array, params: scenario.Registration) -> Found | None:
    """Look for one object in one segment, in the air, turned anyhow: nobody has seen it yet.

    Args:
        model: the object.
        frame: the image.
        points_W: (N, 3) the segment's points.
        params: tuning.

    Returns:
        The best pose, whatever its score; None where the segment is far too large for the object or nothing fits.
    """
    spread = np.linalg.norm(points_W - points_W.mean(axis=0), axis=1)
    if np.median(spread) > 2.0 * model.radius + params.reach:
        return None
    centre, towards = _sight(frame, points_W)
    R = _facing(model.directions, towards)
    laid = Poses(R, centre - shown_by(model, R, towards)[1])
    fit = assess(model, frame, laid, SEARCH.coarse_points, COARSE, slack=0.015)
    best = np.argsort(-fit.likeness * np.minimum(fit.points, 20.0), kind="stable")[: SEARCH.most_starts]
    thin, prior = points_W[:: max(1, len(points_W) // SEARCH.thin)], information(0.3, 0.05)
    near = refine(
        model, frame, laid[best], SEARCH.coarse_points, SEARCH.coarse_iterations, prior, params, coarse_only=True
    )
    # A face slides along a larger one of another side without a point of the model's that does not fit.
    fit = assess(model, frame, near, SEARCH.coarse_points, COARSE, slack=0.005)
    worth = fit.likeness * np.minimum(fit.points / 20.0, 1.0) * (0.4 + 0.6 * _explained(model, thin, near))
    few = np.array(well_apart(near, np.argsort(-worth, kind="stable")))
    return best_of(model, frame, near[few], thin, prior, params)


def _explained(model: ModelCloud, points_W: Array, poses: Poses) -> Array:
    """Return which share of points (N, 3) lies on the object at each of B poses, (B,)."""
    points_O = (points_W[None] - poses.p[:, None]) @ poses.R
    distance, _ = model.nearest.query(points_O.reshape(-1, 3), TUNING.own + model.spacing / 2)
    return np.asarray(np.isfinite(distance).reshape(len(poses.p), -1).mean(axis=1))


def _sight(frame: Frame, points_W: Array) -> tuple[Array, Array]:
    """Return a segment's middle (3,) and the direction (3,) from there to the camera."""
    centre = points_W.mean(axis=0)
    towards = frame.camera.p_WC - centre
    return centre, towards / np.linalg.norm(towards)


def _facing(directions: Array, towards: Array) -> Array:
    """Return turns (D · rolls, 3, 3) R_WO that bring each direction (D, 3) of O to `towards` (3,) of W, all rolls."""
    axis = np.cross(directions, towards)
    sine, cosine = np.linalg.norm(axis, axis=1), directions @ towards
    aside = np.cross(towards, np.eye(3)[int(np.argmin(np.abs(towards)))])
    axis = np.where(sine[:, None] > 1e-9, axis / np.maximum(sine, 1e-9)[:, None], aside / np.linalg.norm(aside))
    to_sight = exp(axis * np.arctan2(sine, cosine)[:, None])
    roll = exp(np.arange(TUNING.rolls)[:, None] * (2 * np.pi / TUNING.rolls) * towards)
    return np.asarray((roll[None] @ to_sight[:, None]).reshape(-1, 3, 3))


def centred(model: ModelCloud, frame: Frame, laid: Poses, centre: Array) -> Poses:
    """Return poses shifted so that the middle of what nothing hides of them is at a point (3,) of W [m].

    Of what is half hidden the middle of all that faces the camera lies behind what hides it.
    """
    p = laid.p
    for _ in range(TUNING.settling):
        looked = look(model, frame, Poses(laid.R, p), SEARCH.coarse_points, COARSE)
        shown = looked.seen & (looked.deeper > -TUNING.before) & (looked.facing > 0.0)
        weight = np.where(shown, looked.facing, 0.0)
        total = weight.sum(axis=1, keepdims=True)
        middle = np.einsum("bp,bpi->bi", weight, looked.r) / np.maximum(total, 1e-9)
        p = np.where(total > 0.0, centre - middle, p)
    return Poses(laid.R, p)
