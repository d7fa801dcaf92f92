"""Keeps a model within what the image shows of it: where one sees past a thing, the thing is not.

A box with one end hidden is held along its length by the end that is in view, and by nothing else. Pairs of depth
alone do not know of it: points of the model that stick out beyond that end find the table behind them, which pairs
with nothing. Each of them is drawn to the nearest pixel that may show the object.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.registration.data_association import Looked, Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.residuals import Normal, tukey
from twin_diagram.perception.registration.rotation import cross
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants, set on trials below number 100 000 of `sims/benchmarks/registration_peers.py`."""

    behind: float = 0.008
    """What is seen so much deeper than a model point, and not labelled as a thing's, was seen past it [m]."""

    rim: float = 1.2
    """Points so few cells outside are not outside: edges jitter, and cells are wide."""

    deviation: float = 0.003
    """Of an edge in the image, at the object's distance [m]."""

    farthest: float = 0.04
    """What sticks out farther than this is no matter of an edge [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Silhouette:
    """Where around an object the image may show it.

    Attributes:
        corner: (row, column) of the cut-out's first cell in the grid of normals.
        target: (h, w, 2) the nearest cell (column, row) that may show the object, in the whole grid.
        away: (h, w) distance to it [cells].
        stride: pixels of a cell.
    """

    corner: tuple[int, int]
    target: npt.NDArray[np.float32]
    away: npt.NDArray[np.float32]
    stride: int

    @staticmethod
    def of(model: ModelCloud, frame: Frame, poses: Poses) -> Silhouette | None:
        """Return it around all poses; None where they are not in view."""
        camera, stride = frame.camera, frame.stride
        z = (poses.p - camera.p_WC) @ camera.R_WC[:, 2]
        nearest = float(z.min()) - model.radius
        if nearest <= 0.0:
            return None
        u, v, _ = camera.project(poses.p)
        height, width = frame.past.shape
        reach = (model.radius / np.maximum(z, nearest) * max(camera.fx, camera.fy)) + 0.05 * camera.fx / z
        c0, c1 = (int(np.clip(x / stride, 0, width)) for x in ((u - reach).min(), (u + reach).max() + stride))
        r0, r1 = (int(np.clip(x / stride, 0, height)) for x in ((v - reach).min(), (v + reach).max() + stride))
        if c1 - c0 < 3 or r1 - r0 < 3:
            return None
        depth = frame.depth[::stride, ::stride][r0:r1, c0:c1]
        free = frame.past[r0:r1, c0:c1] & (depth > nearest)
        if free.all():
            return None
        away, label = cv2.distanceTransformWithLabels(
            free.astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
        )
        row, column = np.nonzero(~free)
        table = np.zeros((int(label.max()) + 1, 2), dtype=np.float32)
        table[label[row, column]] = np.stack([column + c0, row + r0], axis=1)
        return Silhouette((r0, c0), table[label], away, stride)

    def outside(self, looked: Looked) -> tuple[npt.NDArray[np.bool_], Array, Array]:
        """Return which points looked up stick out (B, P), and by how much [px], along the image's axes (B, P) each."""
        (r0, c0), (height, width) = self.corner, self.away.shape
        column = np.rint(looked.u / self.stride).astype(np.int64) - c0
        row = np.rint(looked.v / self.stride).astype(np.int64) - r0
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        column, row = np.where(inside, column, 0), np.where(inside, row, 0)
        out = inside & looked.counted & (self.away[row, column] > 0.0) & (looked.deeper > TUNING.behind)
        goal = self.target[row, column] * self.stride
        return out, goal[..., 0] - looked.u, goal[..., 1] - looked.v


def inward(silhouette: Silhouette | None, looked: Looked, camera: Pinhole) -> Normal:
    """Return the normal equations that draw what sticks out of a silhouette into it."""
    count = len(looked.r)
    if silhouette is None:
        return Normal(np.zeros((count, 6, 6)), np.zeros((count, 6)))
    out, du, dv = silhouette.outside(looked)
    x, y = du * looked.z / camera.fx, dv * looked.z / camera.fy
    length = np.hypot(x, y)
    rim = TUNING.rim * silhouette.stride * looked.z / camera.fx
    beyond = np.where(out, np.maximum(length - rim, 0.0), 0.0)
    w = np.where(out & (length > 0.0), looked.facing.clip(0.0) * tukey(beyond, TUNING.farthest), 0.0)
    w = w / TUNING.deviation**2 * (beyond > 0.0)
    way = (x[..., None] * camera.R_WC[:, 0] + y[..., None] * camera.R_WC[:, 1]) / np.maximum(length, 1e-9)[..., None]
    J = np.concatenate([cross(looked.r, way), way], axis=2)
    weighted = (J * w[..., None]).transpose(0, 2, 1)
    return Normal(weighted @ J, (weighted @ beyond[..., None])[..., 0])
