"""What segmentation hands on: object points with labels, and the images for reasoning about occlusion."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.pinhole import ColourImage, DepthImage, Pinhole
from twin_diagram.perception.segmentation.planes import Plane
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import one_layout
from twin_diagram.signals.layouts import NEVER


@dataclass(frozen=True)
class Tuning:
    """Labels of what is no segment: names, not measures; any negative numbers would do."""

    background: int = -1
    """Label of the table, of all outside the workspace, and of specks."""

    robot: int = -2
    """Label of the robot's own pixels."""

    no_depth: int = -3
    """Label of pixels that the camera measured no depth at."""


TUNING = Tuning()


@dataclass(frozen=True)
class HeldPlaces:
    """Where the hand had what it holds when an image was taken, and before: depth may be older than its time.

    Attributes:
        asset: which of the library's objects it is.
        R: (P, 3, 3) R_WO, the newest first.
        p: (P, 3) p_WO [m].
    """

    asset: int
    R: Array
    p: Array


@dataclass(frozen=True)
class Segments:
    """One image taken apart. All arrays are read-only.

    Attributes:
        time: capture time of the image [s]; `NEVER` before the first.
        points_W: (N, 3) points of objects [m], in the order of their pixels (row by row) in `label_image`.
        normals_W: (N, 3) unit, towards the camera.
        colours: (N, 3) RGB in [0, 1].
        labels: (N,) which segment, from 0.
        count: how many segments there are.
        label_image: (h, w) at every `stride`-th pixel: a segment's number, or a label of `TUNING`.
        stride: of `label_image`.
        depth: (H, W) the whole depth image [m], 0 where there is none.
        rgb: (H, W, 3) the whole colour image.
        camera: the calibrated camera.
        table: (a, b, c) of the table's top z = a x + b y + c in W; level at its told height where none is in view.
        planes: those seen on which things can stand, the table first; empty where no table is in view.
        held: where what the hand holds is in it; None: it holds nothing, or nobody told.
    """

    time: float
    points_W: Array
    normals_W: Array
    colours: Array
    labels: npt.NDArray[np.int64]
    count: int
    label_image: npt.NDArray[np.int16]
    stride: int
    depth: DepthImage
    rgb: ColourImage
    camera: Pinhole
    table: Array
    planes: tuple[Plane, ...] = ()
    held: HeldPlaces | None = None

    def __post_init__(self) -> None:
        """Make the arrays read-only: the object is shared by all who evaluate the port."""
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @cached_property
    def points(self) -> Array:
        """`points_W` as compiled functions take them: copied once, for each call would."""
        return one_layout(self.points_W)

    @cached_property
    def cells(self) -> npt.NDArray[np.int64]:
        """(N,) which cell of `label_image`, row by row, each point is in."""
        return np.flatnonzero(self.label_image.ravel() >= 0)

    @staticmethod
    def empty(camera: Pinhole, stride: int, table_height: float = 0.0) -> Segments:
        """Return what there is before the first image."""
        none = np.zeros((0, 3))
        shape = (camera.height, camera.width)
        label_image = np.full(
            ((shape[0] - 1) // stride + 1, (shape[1] - 1) // stride + 1), TUNING.no_depth, dtype=np.int16
        )
        return Segments(
            time=NEVER,
            points_W=none,
            normals_W=none.copy(),
            colours=none.copy(),
            labels=np.zeros(0, dtype=np.int64),
            count=0,
            label_image=label_image,
            stride=stride,
            depth=np.zeros(shape, dtype=np.float32),
            rgb=np.zeros((*shape, 3), dtype=np.uint8),
            camera=camera,
            table=np.array([0.0, 0.0, table_height]),
        )
