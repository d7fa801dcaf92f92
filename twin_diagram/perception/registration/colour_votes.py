"""Tells poses apart that shape does not: by their colours, point by point.

A mustard bottle's front and back, or a can's sides, look alike to depth. What tells them apart may be a strip at the
rim of what is seen, so that all points vote; where colours change within what a pose may be off by, they count less.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.perception.registration.alternatives import colours_off, in_place
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants, set on seeds 0 to 2 of `sims/benchmarks/followed_scenes.py` before a D435."""

    colour: float = 0.06
    """Deviation of a colour where the model has no texture [of 1]: light, and what a texture's pixels leave out."""

    off: float = 0.002
    """Points are off by so much across the line of sight [m]: a pixel at a metre, and colours' shift beside depth."""

    cut: float = 3.0
    """A deviation larger than this is a reflection's or another thing's: it costs no more."""

    pixels: float = 150.0
    """So many pixels share one vote: what is blurred and shifted errs alike."""

    least: float = 0.3
    """A pose of which less than this share of what the first one shows is in place has no colours to speak of."""

    never: float = 1e3
    """Cost of such a one [nat]."""


TUNING = Tuning()


def colour_costs(model: ModelCloud, frame: Frame, poses: Poses, points: int) -> Array:
    """Return (B,) negative log-likelihoods of an image's colours at poses, up to what all share [nat].

    Args:
        model: the object.
        frame: the image.
        poses: B of them, alike in shape.
        points: model points that are looked up, at most.
    """
    looked = look(model, frame, poses, points, FINE)
    weight = looked.facing * in_place(looked, frame)
    squared = np.square(colours_off(looked, frame, weight, FINE))
    variance = 1.0 + looked.texture * (TUNING.off / TUNING.colour) ** 2
    each = 0.5 * np.minimum(squared / (TUNING.colour**2 * variance), TUNING.cut**2) + 0.5 * np.log(variance)
    shown = weight.sum(axis=1)
    mean = np.einsum("bp,bp->b", each, weight) / np.maximum(shown, 1e-9)
    z = float(np.median(looked.z[0]))
    # A row of many points stands for the pixels that the object takes up, and so does one of few.
    share = shown[0] / max(float(looked.counted[0].sum()), 1.0)
    area = share * model.view_area * (frame.camera.fx / z) ** 2
    return np.where(shown < TUNING.least * shown[0], TUNING.never, mean * area / TUNING.pixels)
