"""What of an image nothing explains, in clusters: candidates for unknown things."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import claimed
from twin_diagram.perception.segmentation.planes import Plane
from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    owned: float = 0.015
    """Points this near to a known object's surface are its own [m] …"""

    sigmas: float = 4.0
    """… and so many standard deviations of depth besides, at the object."""

    fewest: int = 60
    """Points that nothing explains make a thing, from so many on, 640 pixels wide and every second taken."""

    rest: float = 0.3
    """Of a part of the image that known objects explain for the most part, a rest below this share is their rim, …"""

    least_size: float = 0.012
    """A thing is at least so large in two directions [m], as a standard deviation times two, …"""

    rest_size: float = 0.02
    """… and a rest that is so large no rim, which is long and narrow: a hand that held a bottle, and a carton
    against another one, cut by the picture's edge, were less than a third of one segment, and no obstacle."""

    floats: float = 0.05
    """What is higher than this above all that it could stand on, and borders on the robot, is the robot's [m]."""

    beside_robot: int = 3
    """Pixels of the working grid: so near borders on the robot."""


TUNING = Tuning()

Placed = tuple[ModelCloud, Array, Array]
"""A model, R_WO (3, 3) and p_WO (3,)."""


def unexplained(segments: Segments, known: Sequence[Placed]) -> Mask:
    """Return (N,) which of the segments' points belong to none of the objects."""
    free = np.ones(len(segments.labels), dtype=bool)
    for model, R, p in known:
        free[claimed(model, segments, R, p, reach_at(segments.camera, p))] = False
    return free


def reach_at(camera: Pinhole, p: Array) -> float:
    """Return how far from an object's surface at p (3,) its points may be shown [m]."""
    z = max(float((p - camera.p_WC) @ camera.R_WC[:, 2]), 0.0)
    return TUNING.owned + TUNING.sigmas * float(camera.depth_noise(np.array(z)))


def clusters(segments: Segments, free: Mask) -> list[npt.NDArray[np.int64]]:
    """Return the indices of the points of each cluster, in the order of the segments.

    Args:
        segments: the image taken apart.
        free: (N,) the points that nothing explains.
    """
    fewest = TUNING.fewest * (segments.camera.width / 640.0 * 2.0 / segments.stride) ** 2
    found = []
    for label in range(segments.count):
        whole = segments.labels == label
        own = np.flatnonzero(free & whole)
        if len(own) < fewest:
            continue
        rim = len(own) < TUNING.rest * np.count_nonzero(whole)
        least = TUNING.rest_size if rim else TUNING.least_size
        if _large(segments.points_W[own], least) and not _robots(segments, own, label):
            found.append(own)
    return found


def _large(points: Array, least: float) -> bool:
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(points.T)), 0.0))
    return bool(2.0 * spread[1] >= least)


def _robots(segments: Segments, own: npt.NDArray[np.int64], label: int) -> bool:
    """Return whether a cluster is what the robot's model leaves over: it borders on the robot and hangs in the air.

    What hangs there so, nothing stands on: a lid of the robot's own, its hand or its elbow, is none.
    """
    if not segments.planes or not _beside_robot(segments, label):
        return False
    points = segments.points_W[own]
    if abs(_foot(segments.planes[0], points)) < TUNING.floats:
        return False
    return not any(
        plane.part != label
        and abs(_foot(plane, points)) < TUNING.floats
        and _beneath(segments, plane, points)
        and not _hangs(segments, plane.part)
        for plane in segments.planes[1:]
    )


def _foot(plane: Plane, points: Array) -> float:
    """Return how high the lowest of points (N, 3) are above a plane [m]."""
    return float(np.percentile(plane.height(points), 2.0))


def _hangs(segments: Segments, label: int) -> bool:
    """Return whether a part of the image borders on the robot and does not reach down to the table."""
    points = segments.points_W[segments.labels == label]
    return _beside_robot(segments, label) and abs(_foot(segments.planes[0], points)) >= TUNING.floats


def _beneath(segments: Segments, plane: Plane, points: Array) -> bool:
    """Return whether the lid of a part is under points (N, 3), or beside them by no more than it may hang over."""
    part = segments.points_W[segments.labels == plane.part]
    lid = part[np.abs(plane.height(part)) < TUNING.floats]
    if not len(lid):
        return False
    low, high = points[:, :2].min(axis=0) - TUNING.floats, points[:, :2].max(axis=0) + TUNING.floats
    return bool(np.any((lid[:, :2] > low).all(axis=1) & (lid[:, :2] < high).all(axis=1)))


def _beside_robot(segments: Segments, label: int) -> bool:
    rows, columns = np.nonzero(segments.label_image == label)
    r, far = TUNING.beside_robot, (segments.label_image.shape[0], segments.label_image.shape[1])
    around = segments.label_image[
        max(rows.min() - r, 0) : min(rows.max() + r + 1, far[0]),
        max(columns.min() - r, 0) : min(columns.max() + r + 1, far[1]),
    ]
    return bool((around == SEGMENTS.robot).any())
