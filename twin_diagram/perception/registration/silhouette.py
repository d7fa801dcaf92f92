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

from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.outline_kernels import place_labels, see_past, window
from twin_diagram.perception.registration.residual_kernels import (
    OutlineCells,
    OutlineCuts,
)
from twin_diagram.signals.compiled import one_layout


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

    around: float = 0.05
    """So far about an object the image is looked at [m]."""

    @property
    def cuts(self) -> OutlineCuts:
        """As `inward_normal` takes them."""
        return OutlineCuts(self.behind, self.rim, self.farthest, self.deviation)


TUNING = Tuning()


@dataclass(frozen=True)
class Silhouette:
    """Where around an object the image may show it.

    Attributes:
        corner: (row, column) of the cut-out's first cell in the grid of normals.
        target: (T, 2) cells (column, row) that may show the object, in the whole grid.
        nearest: (h, w) the number of the nearest of them.
        away: (h, w) distance to it [cells].
        stride: pixels of a cell.
    """

    corner: tuple[int, int]
    target: npt.NDArray[np.float32]
    nearest: npt.NDArray[np.int32]
    away: npt.NDArray[np.float32]
    stride: int

    @staticmethod
    def of(model: ModelCloud, frame: Frame, poses: Poses) -> Silhouette | None:
        """Return it around all poses; None where they are not in view."""
        stride, shape = frame.stride, frame.past.shape
        around = window(one_layout(poses.p), frame.view, model.radius, TUNING.around, stride, (shape[0], shape[1]))
        nearest, r0, r1, c0, c1 = around
        if c1 - c0 < 3 or r1 - r0 < 3:
            return None
        free = np.empty((r1 - r0, c1 - c0), dtype=np.uint8)
        if see_past(one_layout(frame.past), frame.images.depth, stride, (r0, c0), np.float32(nearest), free):
            return None
        away, label = cv2.distanceTransformWithLabels(free, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
        table = np.zeros((int(label.max()) + 1, 2), dtype=np.float32)
        place_labels(free, label, (r0, c0), table)
        return Silhouette((r0, c0), table, label, away, stride)

    @staticmethod
    def nowhere() -> Silhouette:
        """Return one that holds nothing."""
        return Silhouette(
            (0, 0), np.zeros((1, 2), np.float32), np.zeros((1, 1), np.int32), np.zeros((1, 1), np.float32), 1
        )

    @property
    def cells(self) -> OutlineCells:
        """As `inward_normal` takes it."""
        row, column = self.corner
        return OutlineCells(row, column, self.away, self.nearest, self.target, self.stride)
