"""Calls registration's compiled sums one by one, for laws that are worked out point by point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.registration import colour_kernels, point_kernels, residual_kernels
from twin_diagram.perception.registration.cloud_kernels import PairRules, opposite
from twin_diagram.perception.registration.data_association import Looked, Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.residuals import TUNING, Normal, colour_terms, depth_pairs
from twin_diagram.perception.registration.silhouette import TUNING as SILHOUETTE
from twin_diagram.perception.registration.silhouette import Silhouette

Array = npt.NDArray[np.float64]


def linearise(looked: Looked, frame: Frame, level: int, reach: float, share: float) -> tuple[Normal, Array]:
    """Normal equations of depth and colour, and the noise of each point."""
    count = len(looked.told)
    H, b = np.zeros((count, 6, 6)), np.zeros((count, 6))
    cuts = (reach, TUNING.deepest * reach, TUNING.model_noise)
    residual_kernels.depth_normal(looked.told, looked.flags, frame.noise, cuts, H, b)
    if share > 0.0:
        colours = colour_terms(looked, frame, level, reach, share).without_shift(frame.shift)
        H, b = H + colours.H, b + colours.b
    return Normal(H, b), depth_pairs(looked, frame, reach)[2]


def inward(silhouette: Silhouette | None, looked: Any, camera: Pinhole) -> Normal:
    """Normal equations of what sticks out, of points told by their names."""
    shape = looked.z.shape
    result = Normal(np.zeros((shape[0], 6, 6)), np.zeros((shape[0], 6)))
    if silhouette is None:
        return result
    told = np.zeros((*shape, point_kernels.COLUMNS))
    told[..., :3] = looked.r
    for column, name in (
        (point_kernels.U, "u"),
        (point_kernels.V, "v"),
        (point_kernels.Z, "z"),
        (point_kernels.DEEPER, "deeper"),
        (point_kernels.FACING, "facing"),
    ):
        told[..., column] = getattr(looked, name)
    flags = (looked.counted * point_kernels.COUNTED).astype(np.uint8)
    pose = np.ascontiguousarray(camera.R_WC), camera.p_WC
    view = point_kernels.LooksFrom(camera.fx, camera.fy, *camera.centre, *pose, np.zeros(3))
    residual_kernels.inward_normal(told, flags, silhouette.cells, view, SILHOUETTE.cuts, result.H, result.b)
    return result


@dataclass(frozen=True)
class OppositePairs:
    """Image points paired with their nearest model points.

    Attributes:
        seen: (N, 3) the image's points in W [m].
        J: (N, 6) of their distance to the model's surface.
        w: (N,) weights.
        n: (N, 3) the model's normals in W.
        H: (6, 6) normal equations, sliding included.
        b: (6,).
    """

    seen: Array
    J: Array
    w: Array
    n: Array
    H: Array
    b: Array


def opposite_pairs(
    model: ModelCloud, points_W: Array, poses: Poses, p_WC: Array, reach: float, share: float = 0.1
) -> OppositePairs:
    """Return the opposite direction, for one pose: image points to their nearest model points.

    Point-to-plane, and with weight `share` point-to-point; a point-to-point distance within the model's own spacing is
    none. A point whose nearest model point faces away from the camera is left out: it is the other side of a thin wall.

    Args:
        model: the object.
        points_W: (N, 3) points that should be the object's.
        poses: one pose.
        p_WC: where the camera is.
        reach: pairs farther apart are cut [m].
        share: weight of the point-to-point part.
    """
    count = len(points_W)
    J, w, n = np.empty((count, 6)), np.empty(count), np.empty((count, 3))
    H, b = np.zeros((6, 6)), np.zeros(6)
    opposite(
        np.ascontiguousarray(points_W),
        (np.ascontiguousarray(poses.R[0]), np.ascontiguousarray(poses.p[0])),
        p_WC,
        model.cloud,
        reach,
        PairRules(share, 2.0 * TUNING.model_noise, model.spacing),
        (J, w, n),
        (H, b),
    )
    on = w >= 0.0
    return OppositePairs(points_W[on], J[on], w[on], n[on], H, b)


def unexplained(cloud: ModelCloud, points_W: Array, poses: Poses, p_WC: Array, reach: float, share: float) -> Normal:
    """Normal equations of image points, each with its nearest model point."""
    pairs = opposite_pairs(cloud, points_W, poses, p_WC, reach, share)
    return Normal(pairs.H[None], pairs.b[None])


def colour_at(frame: Frame, u: Array, v: Array, level: int) -> tuple[Array, Array, Array]:
    """Colours at pixels (B, P), and their derivatives by u and v."""
    every = np.ones(u.shape)
    found = colour_kernels.sloped_colours(frame.colours[level], u, v, every, frame.corner_of_colours())
    return found[..., :3], found[..., 3:6], found[..., 6:]


def counted(image: Array, mask: Array) -> npt.NDArray[np.float32]:
    """Return masked colours (h, w, 3), and the mask (h, w) beside them."""
    return np.dstack([image * mask[..., None], mask]).astype(np.float32)
