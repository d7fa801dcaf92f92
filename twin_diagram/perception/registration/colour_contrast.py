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
    looked = look(model, frame, Poses(one.R[None], one.p[None]), TUNING.points, FINE)
    if not looked.coloured:
        return 1.0
    weight = np.empty(looked.flags.shape)
    cuts = SurfaceCuts(ALTERNATIVES.placed, RESIDUALS.model_noise, ASSESSMENT.same_surface)
    weigh_in_place(looked.told, looked.flags, frame.noise, cuts, weight)
    weight = (weight * looked.painted)[0]
    own = _contrast(looked.colour[0], weight)
    if weight.sum() < TUNING.least or own <= VOTES.colour:
        return 1.0
    shown = _contrast(frame.plain_colour_at(looked.u, looked.v, FINE)[0], weight)
    low, high = TUNING.share
    return float(np.clip((shown / own - low) / (high - low), 0.0, 1.0))


def _contrast(colours: Array, weight: Array) -> float:
    """Return the deviation of tints of colours (N, 3), with weights (N,); what is grey, as shade is, has none."""
    total = max(float(weight.sum()), 1e-12)
    tints = colours - colours.mean(axis=1, keepdims=True)
    off = tints - weight @ tints / total
    return float(np.sqrt(weight @ np.einsum("ni,ni->n", off, off) / total))
