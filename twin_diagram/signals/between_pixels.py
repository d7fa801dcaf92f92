"""Depth at places between an image's pixels.

Apart from `lens`, which needs no OpenCV: the slim installation checks a scenario's lenses without it.
"""

from __future__ import annotations

import cv2
import numpy as np

from twin_diagram.signals.lens import Map

STEP = 0.02
"""A step in depth between neighbours, as a share of the depth, that leads from one surface to another: a surface that
leans by 80° makes less where a focal length is 300 px and more."""


def depth_between(depth: Map, u: Map, v: Map) -> Map:
    """Return the depth at places between an image's pixels: that of the surface there, never between two.

    On a plane the inverse of depth is linear in the image, so that is interpolated; where there is a step among the
    four pixels about a place, or one of them has no depth, the nearest pixel's counts.

    Args:
        depth: (H, W) [m], 0 or infinite where there is none.
        u: (h, w) columns [px].
        v: (h, w) rows [px].

    Returns:
        (h, w), 0 or infinite where the nearest pixel is, and 0 beyond the image.
    """
    nearest = cv2.remap(depth, u, v, cv2.INTER_NEAREST)
    known = np.isfinite(depth) & (depth > 0)
    inverse = np.where(known, np.float32(1.0) / np.where(known, depth, np.float32(1.0)), np.float32(0.0))
    found = cv2.remap(inverse, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    # Of each pixel with its neighbours to the right, below, and both.
    most, least = (filter_(inverse, _FOUR, anchor=(0, 0)) for filter_ in (cv2.dilate, cv2.erode))
    even = (most - least < np.float32(STEP) * most).view(np.uint8)
    here = cv2.remap(even, np.floor(u), np.floor(v), cv2.INTER_NEAREST) > 0
    return np.where(here, np.float32(1.0) / np.where(here, found, np.float32(1.0)), nearest)


_FOUR = np.ones((2, 2), np.uint8)
"""The pixels about a place between them."""
