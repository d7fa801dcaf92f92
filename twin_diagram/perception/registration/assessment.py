"""How well a pose explains the image: counts of the model's points that fit, and shares of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.perception.depth_noise import excess_of
from twin_diagram.perception.registration.data_association import TUNING as LOOKING
from twin_diagram.perception.registration.data_association import Looked, Poses, look
from twin_diagram.perception.registration.fit_kernels import PlaceCuts, counts, median_excess, placed_weights
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.registration.residuals import TUNING as RESIDUALS
from twin_diagram.perception.registration.residuals import brightness
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    same_surface: float = 0.03
    """What is seen farther than this from a model point along the line of sight is something else [m]."""

    placed: float = 3.0
    """A point is in place within its slack and so many deviations of depth."""

    enough: float = 0.3
    """Of a pose of which less than this share is looked up, the whole counts: most of it is out of the image."""

    painted: float = 0.1
    """Where less than this share of what is in place has colours that pictures showed, they say little of the rest."""

    finest: float = 0.0001
    """No depth is taken to be more exact [m]: a recording may hold whole units of it."""


TUNING = Tuning()


@dataclass(frozen=True)
class PoseFit:
    """How well poses explain the image, (B,) each.

    Attributes:
        quality: share of the model points that should be seen, and are not hidden by something nearer, that fit in
            place and colour.
        likeness: the same with each point counted by how near its colour comes; tells poses apart that differ little.
        shape: quality without regard to colours.
        visible_share: share of the points facing the camera that are not hidden.
        points: how many fit.
    """

    quality: Array
    likeness: Array
    shape: Array
    visible_share: Array
    points: Array


def assess(
    model: ModelCloud, frame: Frame, poses: Poses, count: int, level: int = FINE, slack: float = 0.003
) -> PoseFit:
    """Compare poses with the image; a surface point is in place within `slack` [m] and three times the noise."""
    return judge(look(model, frame, poses, count, level), frame, level, slack)


def judge(looked: Looked, frame: Frame, level: int = FINE, slack: float = 0.003) -> PoseFit:
    """Compare what was looked up at poses with the model; see `assess`."""
    cuts = PlaceCuts(slack, TUNING.placed, TUNING.same_surface, RESIDUALS.model_noise)
    weight = placed_weights(looked.told, looked.flags, frame.noise, cuts)
    found = frame.plain_colour_at(looked.u, looked.v, level)
    gain = brightness(found, looked.colour, looked.n, weight * looked.painted)
    cut = RESIDUALS.colour_cut if looked.coloured else np.inf
    sums = counts(looked.told, looked.flags, weight, found, gain, (cut, LOOKING.least_facing))
    shown = np.maximum(sums.shown, 1e-9)
    told = sums.shown + sums.lost
    # What no picture showed the colours of fits as well as the rest does; as in shape, where little of that is in view.
    known, few = sums.placed - sums.untold, TUNING.painted * sums.placed
    share = (sums.fits + few) / np.maximum(known + few, 1e-9)
    alike = (sums.alike + few) / np.maximum(known + few, 1e-9)
    return PoseFit(
        quality=(sums.fits + share * sums.untold) / shown,
        likeness=(sums.alike + alike * sums.untold) / shown,
        shape=sums.placed / shown,
        visible_share=sums.shown / np.maximum(np.where(told > TUNING.enough * sums.whole, told, sums.whole), 1e-9),
        points=sums.points + share * sums.untold_points,
    )


def residual_excess(looked: Looked, frame: Frame, pose: int = 0) -> float:
    """Return by which factor depth errs more about a pose than the camera's data sheet says; 1 where it does not.

    Args:
        looked: up at poses, of which one is judged.
        frame: the image.
        pose: its number.
    """
    cuts = (TUNING.same_surface, 0.2, TUNING.finest)
    scatter, count = median_excess(looked.told[pose], looked.flags[pose], frame.noise, cuts)
    return excess_of(scatter, count)
