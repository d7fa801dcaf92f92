"""Looks for an object in the air, turned somehow as it was when it was seen last, by what nothing hides of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram import scenario
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.global_search import TUNING as SEARCH
from twin_diagram.perception.registration.global_search import Found, best_of, shown_by
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import COARSE
from twin_diagram.perception.registration.registration import information
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
    centre = points_W.mean(axis=0)
    towards = frame.camera.p_WC - centre
    towards /= np.linalg.norm(towards)
    laid = centred(model, frame, Poses(R_any, centre - shown_by(model, R_any, towards)[1]), centre)
    thin = points_W[:: max(1, len(points_W) // SEARCH.thin)]
    return best_of(model, frame, laid, thin, information(0.3, 0.05), params)


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
