"""Tells the colour of the light by the known things that an image shows, and takes it out of the image.

A lamp is warmer than what an asset's pictures were taken in, and so is a camera whose white is off: all things then
look redder than they are painted, alike. One thing may be painted otherwise; several that are off by the same are lit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from twin_diagram.perception.registration.alternatives import in_place
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import FINE
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants, set on own rendered sequences of six YCB things in warm, cold and dim light."""

    points: int = 150
    """Model points of a thing that are looked up."""

    fewest: int = 40
    """Fewer that are in place tell nothing."""

    dark: float = 0.02
    """What shows or has less than this of a colour does not tell how strong that is in the light [of 1]."""

    grey: float = 0.02
    """Pictures whose three colours differ by less than this have none [of 1]: they tell no light."""

    things: int = 3
    """So many things must agree, …"""

    share: float = 0.6
    """… and such a share of those that tell anything, …"""

    agree: float = 0.12
    """… to within this [logarithm]."""

    least: float = 0.1
    """A light that is off by less is left as it is [logarithm]: registration fits how bright it is, and colours of
    assets are no better."""


TUNING = Tuning()

WHITE = np.zeros(2)
"""The light in which things look as they are painted."""


def tint_on(model: ModelCloud, frame: Frame, R: Array, p: Array) -> Array | None:
    """Return by how much more red and blue than green (2,) a thing shows than its model has [logarithm].

    None where too little of it shows, it lacks one of the three, or the picture has no colours.

    Args:
        model: the object.
        frame: the image.
        R: (3, 3) where it is.
        p: (3,) likewise [m].
    """
    if not model.coloured:
        return None
    looked = look(model, frame, Poses(R[None], p[None]), TUNING.points, FINE)
    own = (in_place(looked, frame) & looked.counted & looked.painted)[0]
    if np.count_nonzero(own) < TUNING.fewest:
        return None
    shown = frame.plain_colour_at(looked.u, looked.v, FINE)[0][own]
    seen, painted = shown.mean(axis=0), looked.colour[0][own].mean(axis=0)
    if min(seen.min(), painted.min()) < TUNING.dark or np.ptp(shown, axis=1).mean() < TUNING.grey:
        return None
    more = np.log(seen / painted)
    return np.asarray(more[[0, 2]] - more[1])


def common_tint(tints: Sequence[Array]) -> Array:
    """Return what most of several things' tints (2,) agree on; `WHITE` where they do not, or it is hardly any."""
    if len(tints) < TUNING.things:
        return WHITE
    each = np.stack(tints)
    middle = np.median(each, axis=0)
    near = np.abs(each - middle).max(axis=1) < TUNING.agree
    if np.count_nonzero(near) < max(TUNING.things, TUNING.share * len(each)):
        return WHITE
    tint = each[near].mean(axis=0)
    return np.asarray(tint) if np.abs(tint).max() > TUNING.least else WHITE


def in_white(segments: Segments, tint: Array) -> Segments:
    """Return an image as it were without a tint (2,) of its light; the strongest of three colours stays as it is."""
    if not tint.any():
        return segments
    gain = np.exp(-np.array([tint[0], 0.0, tint[1]]))
    gain /= gain.max()
    table = np.rint(np.arange(256)[:, None] * gain).astype(np.uint8)[None]
    return replace(segments, rgb=cv2.LUT(segments.rgb, table), colours=segments.colours * gain)
