"""Tells whether an image shows as much paint as a model has where it was found: a plain thing shows none.

A white forearm's end fits most of a white carton's side, whose colours then seem to speak for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.perception.registration.alternatives import TUNING as ALTERNATIVES
from twin_diagram.perception.registration.assessment import TUNING as ASSESSMENT
from twin_diagram.perception.registration.colour_vote_kernels import SurfaceCuts, weigh_in_place
from twin_diagram.perception.registration.colour_votes import TUNING as VOTES
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.residuals import TUNING as RESIDUALS
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants, set on `sims/benchmarks/followed_scenes.py`."""

    points: int = 150
    """Model points whose colours are compared."""

    share: tuple[float, float] = (0.25, 0.45)
    """With less than such a share of the model's contrast an image shows a plain thing, with more a painted one."""

    least: float = 10.0
    """Points in place that tell."""


TUNING = Tuning()


def painted_alike(model: ModelCloud, frame: Frame, one: RegisteredPose) -> float:
    """Return from 0 to 1 whether an image shows as much contrast of colours as a model in its place.

    1 where the model shows none itself, or too little of it is in place.

    Args:
        model: the object, coloured.
        frame: the image.
        one: the pose.
    """
    return _as_much(_in_place(model, frame, one, less_mean=True), of_none=1.0)


def coloured_alike(model: ModelCloud, frame: Frame, one: RegisteredPose) -> float:
    """Return from 0 to 1 whether an image shows as much colour as a model in its place: what is grey shows none.

    0 where the model shows none itself, or too little of it is in place: of a white patch's name colours say nothing.

    Args:
        model: the object, coloured.
        frame: the image.
        one: the pose.
    """
    return _as_much(_in_place(model, frame, one, less_mean=False), of_none=0.0)


def _as_much(contrasts: tuple[float, float] | None, of_none: float) -> float:
    """Return from 0 to 1 whether the contrast that an image shows is a model's own, and not a plain thing's.

    Args:
        contrasts: the model's and the image's; None of too few points.
        of_none: what is returned of those, and of a model that has no contrast.
    """
    if contrasts is None or contrasts[0] <= VOTES.colour:
        return of_none
    low, high = TUNING.share
    return float(np.clip((contrasts[1] / contrasts[0] - low) / (high - low), 0.0, 1.0))


def _in_place(model: ModelCloud, frame: Frame, one: RegisteredPose, less_mean: bool) -> tuple[float, float] | None:
    """Return the sizes of the tints of the model and of the image in its place, or of what they are off their means.

    None where too few points are in place.
    """
    looked = look(model, frame, Poses(one.R[None], one.p[None]), TUNING.points, FINE)
    if not looked.coloured:
        return None
    weight = np.empty(looked.flags.shape)
    cuts = SurfaceCuts(ALTERNATIVES.placed, RESIDUALS.model_noise, ASSESSMENT.same_surface)
    weigh_in_place(looked.told, looked.flags, frame.noise, cuts, weight)
    weight = (weight * looked.painted)[0]
    if weight.sum() < TUNING.least:
        return None
    both = looked.colour[0], frame.plain_colour_at(looked.u, looked.v, FINE)[0]
    own, shown = (_contrast(colours, weight, less_mean) for colours in both)
    return own, shown


def _contrast(colours: Array, weight: Array, less_mean: bool) -> float:
    """Return the size of the tints of colours (N, 3), RMS with weights (N,); what is grey, as shade is, has none."""
    tints = colours - colours.mean(axis=1, keepdims=True)
    if less_mean:
        tints = tints - weight @ tints / weight.sum()
    return float(np.sqrt(weight @ np.einsum("ni,ni->n", tints, tints) / weight.sum()))
