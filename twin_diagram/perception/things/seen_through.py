"""Whether places on a surface are still what the camera sees there, are hidden, or are seen to be empty."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    slack: float = 0.02
    """What is seen within this of a place, along the line of sight, is seen there [m]: a registration's reach."""

    sigmas: float = 4.0
    """And within so many standard deviations of depth."""


TUNING = Tuning()


class Seen(NamedTuple):
    """Shares of places on a surface."""

    there: float
    """What is seen is there."""
    empty: float
    """The camera sees what is behind."""
    hidden: float
    """Something nearer is in the way, the robot is at them, there is no depth, or they are out of the image."""


def seen_through(places_W: Array, segments: Segments) -> Seen:
    """Look places (N, 3) in W up in an image; with none, all is hidden."""
    if not len(places_W):
        return Seen(0.0, 0.0, 1.0)
    there, empty = looked_at(places_W, segments)
    shares = float(there.mean()), float(empty.mean())
    return Seen(*shares, 1.0 - sum(shares))


def looked_at(places_W: Array, segments: Segments) -> tuple[Mask, Mask]:
    """Return (N,) which of places (N, 3) in W an image shows to be there, and which to be empty; others are hidden."""
    u, v, z = segments.camera.project(places_W)
    height, width = segments.depth.shape
    within = (u > -0.5) & (u < width - 0.5) & (v > -0.5) & (v < height - 0.5) & (z > 1e-3)
    column, row = (np.where(within, np.rint(x), 0.0).astype(int) for x in (u, v))
    depth = segments.depth[row, column].astype(float)
    label = segments.label_image[row // segments.stride, column // segments.stride]
    measured = within & (depth > 0.0)
    farther = depth - z
    slack = TUNING.slack + TUNING.sigmas * segments.camera.depth_noise(z)
    # The robot behind a place shows it to be empty as anything else does; what of it is at the place tells nothing.
    return measured & (np.abs(farther) <= slack) & (label != SEGMENTS.robot), measured & (farther > slack)
