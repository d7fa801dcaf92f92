"""Registers objects whose surface tears depth: beside what lies behind them, round after round; see `torn_depth`.

Torn patches draw a pose towards them, which then no longer lies before them: no descent finds back. So starts are
laid nearer to the camera, too, and each is refined with what lies behind it taken for none. Which is right is told by
the whole image, torn patches and all: too near a start has nothing in place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.perception.registration.assessment import assess
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.global_search import (
    RESTING,
    Found,
    best_as_laid,
    judged,
    starts,
    with_colours_aligned,
)
from twin_diagram.perception.registration.global_search import TUNING as SEARCH
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import COARSE
from twin_diagram.perception.registration.registration import RegisteredPose, register
from twin_diagram.perception.registration.torn_depth import behind, frame_without, kept, past_tears
from twin_diagram.perception.registration.view import View
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants, set on six rendered scenes of a shiny can before a D435."""

    nearer: tuple[float, ...] = (0.0, 0.008, 0.016, 0.024)
    """Starts lie nearer to the camera by so much [m]: patches 30 mm too deep draw what is half torn by as much."""

    candidates: int = 4
    """Starts that are refined."""

    rounds: int = 2
    """So often a pose tells what is torn, and what is left tells the pose."""

    least: float = 0.2
    """Where a search without regard to tears found less, it is another thing: half torn cans had 0.22 to 0.94."""

    accept: float = 0.8
    """What a search beside tears finds explains as much: shiny cans had 0.88 to 0.98, a carton in the air 0.38."""

    as_good: float = 0.9
    """By the whole image, torn patches and all, a pose beside tears has to be this share as likely as without."""


TUNING = Tuning()


def search_past_tears(
    model: ModelCloud,
    view: View,
    points_W: Array,
    orientations: Sequence[tuple[Array, float]],
    found: Found,
) -> Found:
    """Return what a search found in one segment, or where it is if its surface tears depth and that fits better.

    Args:
        model: the object.
        view: the image.
        points_W: (N, 3) the segment's points.
        orientations: those of `resting` that are tried.
        found: without regard to tears.
    """
    frame, params = view.frame, view.params
    if not model.coloured or not frame.planes or found.score < TUNING.least:
        return found
    laid = _laid(model, frame, points_W, orientations)
    thin = points_W[:: max(1, len(points_W) // SEARCH.thin)]
    before = found.registration
    places = [(before.R, before.p), *zip(laid.R, laid.p, strict=True)]
    best = _likeliest(model, view, before, places, thin, RESTING)
    if best is None:
        return found
    one, past = best
    left = kept(frame, past.frame.depth != frame.depth, thin)
    share = judged(model, left, one)
    again = Found(one, one.quality * share, one.likeness * share)
    again = with_colours_aligned(model, past.frame, again, left, params)
    return again if again.score >= TUNING.accept else found


def followed_past_tears(
    model: ModelCloud, view: View, one: RegisteredPose, expected: Poses, points_W: Array, prior: Array
) -> RegisteredPose:
    """Return a pose that was followed, or where the object is if its surface tears depth and that fits better.

    Args:
        model: the object.
        view: the image.
        one: the pose, without regard to tears.
        expected: about the one that was expected.
        points_W: (N, 3) image points to be explained.
        prior: (6,) information of what was expected.
    """
    if not model.coloured or not view.frame.planes:
        return one
    best = _likeliest(model, view, one, [(expected.R[0], expected.p[0]), (one.R, one.p)], points_W, prior)
    return one if best is None else best[0]


def _likeliest(
    model: ModelCloud,
    view: View,
    before: RegisteredPose,
    places: Sequence[tuple[Array, Array]],
    points_W: Array,
    prior: Array,
) -> tuple[RegisteredPose, View] | None:
    """Return what is likeliest by the whole image of poses beside tears, and the image past its tears.

    None where depth is not torn there, or the pose `before` is likelier.

    Args:
        model: the object.
        view: the image.
        before: the pose without regard to tears.
        places: R (3, 3), p (3,) to begin with.
        points_W: (N, 3) image points to be explained.
        prior: (6,) information of the places.
    """
    torn = [at for at in places if behind(model, view.frame, *at).may_be_torn]
    if not torn:
        return None
    tried = [registered(model, view, *at, points_W, prior) for at in torn]
    R, p = (np.stack([getattr(one, name) for one in (before, *tried)]) for name in ("R", "p"))
    whole = assess(model, view.frame, Poses(R, p), view.params.model_points).likeness
    k = int(np.argmax(whole[1:]))
    past = past_tears(model, view, tried[k].R, tried[k].p)
    return (tried[k], past) if past is not None and whole[1 + k] >= TUNING.as_good * whole[0] else None


def registered(
    model: ModelCloud,
    view: View,
    R: Array,
    p: Array,
    points_W: Array,
    prior: Array,
) -> RegisteredPose:
    """Register an object with what lies behind it taken for none.

    Args:
        model: the object.
        view: the image.
        R: (3, 3) R_WO to begin with.
        p: (3,) p_WO [m].
        points_W: (N, 3) image points to be explained, but for torn ones.
        prior: (6,) information of the pose.
    """
    one: RegisteredPose | None = None
    for _ in range(TUNING.rounds):
        at = (R, p) if one is None else (one.R, one.p)
        seen = behind(model, view.frame, *at)
        left = kept(view.frame, seen.pixels, points_W)
        one = register(model, frame_without(view, seen), *at, view.params, points_W=left, prior=prior)
    assert one is not None
    return one


def _laid(model: ModelCloud, frame: Frame, points_W: Array, orientations: Sequence[tuple[Array, float]]) -> Poses:
    """Return the starts that fit best as they are laid, at rest, where a search lays them and nearer to the camera."""
    laid = starts(model, frame, points_W, list(orientations))
    laid = best_as_laid(model, frame, laid, SEARCH.first_look, SEARCH.looked_again)
    laid = best_as_laid(model, frame, laid, SEARCH.coarse_points, SEARCH.most_starts)
    way = (frame.camera.p_WC - laid.p) * [1.0, 1.0, 0.0]
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    R, p = np.concatenate([laid.R] * len(TUNING.nearer)), np.concatenate([laid.p + by * way for by in TUNING.nearer])
    fit = assess(model, frame, Poses(R, p), SEARCH.coarse_points, COARSE, slack=0.005)
    score = fit.likeness * np.minimum(fit.points / 20.0, 1.0)
    return Poses(R, p)[np.argsort(-score, kind="stable")[: TUNING.candidates]]
