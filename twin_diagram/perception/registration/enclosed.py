"""What lies as low as its support and is enclosed by what stands: a plate's floor within its rim.

Depth cannot tell it from the table, so that it is none of what stands; but the picture shows its colours. Where a model
lies there in depth, they are compared.
"""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS

LEAST: Final = 60
"""Cells of what is enclosed, as many as make a thing: less, as within a mug's handle, is not looked at."""

GAP: Final = 3
"""Width of the box by which what stands is widened first [cells]: rims have gaps where depth is lost beside edges."""


def enclosed(label: npt.NDArray[np.int16]) -> npt.NDArray[np.bool_]:
    """Return which cells (h, w) show the support, and cannot be left without a way through what stands.

    Args:
        label: (h, w) of the segments' image.
    """
    standing = cv2.dilate((label >= 0).view(np.uint8), np.ones((GAP, GAP), np.uint8))
    _, part, stats, _ = cv2.connectedComponentsWithStats(1 - standing, connectivity=4)
    left, top = stats[:, cv2.CC_STAT_LEFT], stats[:, cv2.CC_STAT_TOP]
    right, bottom = left + stats[:, cv2.CC_STAT_WIDTH], top + stats[:, cv2.CC_STAT_HEIGHT]
    within = (left > 0) & (top > 0) & (right < label.shape[1]) & (bottom < label.shape[0])
    within &= stats[:, cv2.CC_STAT_AREA] >= LEAST
    within[0] = False
    if not within.any():
        return np.zeros(label.shape, bool)
    grown = cv2.dilate(within[part].view(np.uint8), np.ones((GAP, GAP), np.uint8)) > 0
    return np.asarray(grown & (label == SEGMENTS.background))
