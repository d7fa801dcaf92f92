"""Looks at all turns about the vertical of what fits in shape and not in colours: cups and bottles half hidden.

A search refines few starts, chosen by coarse colours. Of something round of which half is in view all turns fit alike
in shape, and where a picture shows it with a few hundred pixels, coarse colours may put twenty turns before the right
one. At a place that is known by then all turns are compared by fine colours in the time of half a registration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram import scenario
from twin_diagram.perception.registration.assessment import assess
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.global_search import Found, explained, judged, with_colours_aligned
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import register
from twin_diagram.perception.registration.rotation import exp
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them; half hidden cup and bottle of 130 to 250 points."""

    turns: int = 48
    """That are compared, 7.5° apart: colours draw in what is 12° off."""

    explained: float = 0.8
    """So much of a segment lies on the surface of what was found there, or it is not that thing."""

    better: float = 1.2
    """A turn that is not so many times as like is not registered: it would come to the same."""


TUNING = Tuning()


def turned_about(
    model: ModelCloud, frame: Frame, found: Found, points_W: Array, params: scenario.Registration
) -> Found:
    """Return what was found, turned about the vertical through its origin as fits best; as it was, where none does.

    Args:
        model: the object, coloured.
        frame: the image.
        found: in it.
        points_W: (N, 3) the segment's points.
        params: tuning.
    """
    one = found.registration
    if explained(model, points_W, one) < TUNING.explained:
        return found
    yaw = np.arange(TUNING.turns) * (2.0 * np.pi / TUNING.turns)
    turns = exp(np.stack([np.zeros_like(yaw), np.zeros_like(yaw), yaw], axis=1))
    laid = Poses(turns @ one.R, np.repeat(one.p[None], TUNING.turns, axis=0))
    likeness = assess(model, frame, laid, params.model_points).likeness
    best = int(np.argmax(likeness))
    if likeness[best] <= TUNING.better * likeness[0]:
        return found
    result = register(model, frame, laid.R[best], laid.p[best], params, points_W=points_W)
    rest = judged(model, points_W, result)
    if result.likeness * rest <= found.likeness:
        return found
    other = Found(result, result.quality * rest, result.likeness * rest, others=(*found.others, one))
    return with_colours_aligned(model, frame, other, points_W, params)
