"""Tells poses apart that shape does not: by their colours, point by point.

A mustard bottle's front and back, or a can's sides, look alike to depth. What tells them apart may be a strip at the
rim of what is seen, so that all points vote; where colours change within what a pose may be off by, they count less.
Light, and that in which its asset was seen, brightens and darkens more than it tints: what lies along a colour counts
less than what lies across.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.perception.registration.alternatives import TUNING as ALTERNATIVES
from twin_diagram.perception.registration.assessment import TUNING as ASSESSMENT
from twin_diagram.perception.registration.colour_vote_kernels import (
    ColourLaw,
    SurfaceCuts,
    mean_misses,
    weigh_in_place,
)
from twin_diagram.perception.registration.data_association import Looked, Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import FINE, UNPAINTED
from twin_diagram.perception.registration.residuals import TUNING as RESIDUALS
from twin_diagram.perception.registration.residuals import brightness
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import one_layout


@dataclass(frozen=True)
class Tuning:
    """Constants, set on seeds 0 to 12 of `sims/benchmarks/followed_scenes.py`: 901 poses and rivals."""

    bright: float = 0.15
    """Deviation of how bright a colour is [of 1]: light and shade, in the image and in the pictures of its asset."""

    colour: float = 0.04
    """And of all else of it, where the model has no texture [of 1]: noise, and what a texture's pixels leave out."""

    off: float = 0.002
    """Points are off by so much across the line of sight [m]: a pixel at a metre, and colours' shift beside depth."""

    cut: float = 3.0
    """A deviation larger than this is a reflection's or another thing's: it costs no more."""

    unpainted: float = 0.85
    """Least cost of a point whose colour no picture showed: what one that is right costs in the mean (half-hidden
    ketchup bottle, D435, training seed 101000). Fine paint costs more: then it is what others of the first pose cost,
    or else a side that no picture showed is likelier than one that is seen (half-hidden box, 101029, by 10 to 18)."""

    pixels: float = 85.0
    """So many pixels share one vote, since what is blurred and shifted errs alike: then odds are as often right as they
    say."""

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
    weight, (mean, shown) = np.empty(looked.flags.shape), np.empty((2, len(poses.p)))
    cuts = SurfaceCuts(ALTERNATIVES.placed, RESIDUALS.model_noise, ASSESSMENT.same_surface)
    weigh_in_place(looked.told, looked.flags, frame.noise, cuts, weight)
    found, gain = looked.colour, np.ones(weight.shape)
    if looked.coloured:
        found = frame.plain_colour_at(looked.u, looked.v, FINE)
        gain = brightness(found, looked.colour, looked.n, weight * looked.painted)
    law = ColourLaw(TUNING.bright, TUNING.colour, (TUNING.off / TUNING.colour) ** 2, TUNING.cut, TUNING.unpainted)
    if looked.coloured and not looked.painted.all():
        law = law._replace(unpainted=max(law.unpainted, _usual(looked, found, gain, weight, law)))
    mean_misses(looked.told, (one_layout(found), gain, weight), law, (mean, shown))
    return np.where(shown < TUNING.least * shown[0], TUNING.never, mean * pixel_votes(model, frame, looked, shown[0]))


def _usual(looked: Looked, found: Array, gain: Array, weight: Array, law: ColourLaw) -> float:
    """Return what a point costs in the mean at the first of poses, of those whose colours are known; 0: of too few."""
    known, (mean, shown) = weight[:1] * looked.painted[:1], np.empty((2, 1))
    mean_misses(looked.told[:1], (one_layout(found[:1]), gain[:1], known), law, (mean, shown))
    return float(mean[0]) if shown[0] > TUNING.least * weight[0].sum() else 0.0


def pixel_votes(model: ModelCloud, frame: Frame, looked: Looked, shown: float) -> float:
    """Return how many votes the pixels of the first of poses have, of which points of `shown` weight are in place.

    A row of many points stands for the pixels that the object takes up, and so does one of few.
    """
    share = shown / max(float(looked.counted[0].sum()), 1.0)
    return float(share * model.view_area * (frame.camera.fx / np.median(looked.z[0])) ** 2 / TUNING.pixels)


def missed(off: Array, colour: Array, texture: Array) -> Array:
    """Return (…) what it costs to be off (…, 3) from colours (…, 3) on textures (…) [nat].

    Colours that no picture showed cost the same whatever is off.
    """
    way = colour / np.maximum(np.linalg.norm(colour, axis=-1, keepdims=True), 1e-6)
    along = np.einsum("...i,...i", off, way)
    across = np.maximum(np.einsum("...i,...i", off, off) - along**2, 0.0)
    return np.where(texture < UNPAINTED, likelihood(along, across, texture), TUNING.unpainted)


def likelihood(along: Array, across: Array, texture: Array) -> Array:
    """Return what colours cost that are off by so much along them and, squared, across, on such a texture [1/m²]."""
    variance = 1.0 + texture * (TUNING.off / TUNING.colour) ** 2
    squared = ((along / TUNING.bright) ** 2 + across / TUNING.colour**2) / variance
    return np.asarray(0.5 * np.minimum(squared, TUNING.cut**2) + 0.5 * np.log(variance))
