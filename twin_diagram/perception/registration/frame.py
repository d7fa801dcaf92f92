"""One image made ready for registration: depth, and colour at two scales, to be looked up at many pixels at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import cast

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.perception.pinhole import DepthImage, Pinhole
from twin_diagram.perception.registration.colour_kernels import curvature_counts, cut_out, plain_colours, shared_out
from twin_diagram.perception.registration.colour_shift import ALIGNED, ColourShift
from twin_diagram.perception.registration.enclosed import enclosed
from twin_diagram.perception.registration.point_kernels import Images, LooksFrom, NoiseLaw
from twin_diagram.perception.segmentation.planes import Plane
from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import one_layout

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of the blur, chosen by hand beside `model_cloud`'s blur of the surface.

    `sims/closed_loop.py --seeds 20` shows their effect.
    """

    blur: tuple[int, ...] = (3, 9)
    """Width of the box that blurs the colours, twice [pixel]: fine, coarse; like a Gaussian of 1.2 and 3.7 pixels."""

    every: int = 3
    """Colours' noise is told by every so many pixels both ways: a hundred of them tell it to a tenth."""

    margin: int = 32
    """Pixels around what stands on the table that are blurred, too: three widths of the coarse box and some."""


TUNING = Tuning()


@dataclass(frozen=True)
class Frame:
    """An image for registration.

    Attributes:
        camera: the calibrated camera, without distortion.
        depth: (H, W) along the optical axis [m], 0 where there is none.
        robot: (H, W), the robot's pixels.
        normals: (h, w, 3) at every `stride`-th pixel, of what stands on the table; 0 elsewhere.
        stride: of `normals`.
        colours: fine and coarse, each (h, w, 3) float in [0, 1]: the part of the image from `corner` on.
        corner: (u, v) of the cut-out's first pixel.
        table: (a, b, c) of the table z = a x + b y + c.
        past: (h, w) at every `stride`-th pixel, where nothing stands and something is seen.
        colour_slopes: squared length of the colours' derivatives that the image's noise makes [1/px²]: fine, coarse.
        shift: how far the colours lie beside depth, as far as that is known.
        planes: on which things can stand, the table first.
    """

    camera: Pinhole
    depth: DepthImage
    robot: Mask
    normals: npt.NDArray[np.float32]
    stride: int
    colours: tuple[npt.NDArray[np.float32], ...]
    corner: tuple[int, int]
    table: Array
    past: Mask
    colour_slopes: tuple[float, ...] = (0.0, 0.0)
    shift: ColourShift = ALIGNED
    planes: tuple[Plane, ...] = ()

    @staticmethod
    def of(segments: Segments, shift: ColourShift = ALIGNED) -> Frame:
        """Prepare a segmented image; only the part around what stands on the table is blurred."""
        label = segments.label_image
        height, width = segments.depth.shape
        stride = segments.stride
        standing = label >= 0
        rows, columns = np.flatnonzero(standing.any(axis=1)), np.flatnonzero(standing.any(axis=0))
        if len(rows):
            v0, v1 = max(0, int(rows[0]) * stride - TUNING.margin), min(height, int(rows[-1]) * stride + TUNING.margin)
            u0, u1 = (
                max(0, int(columns[0]) * stride - TUNING.margin),
                min(width, int(columns[-1]) * stride + TUNING.margin),
            )
        else:
            v0, v1, u0, u1 = 0, 2, 0, 2
        robot = label == SEGMENTS.robot
        seen = whole_pixels(robot, stride, (height, width)) if robot.any() else np.zeros((height, width), dtype=bool)
        part = (v0, v1, u0, u1)
        counted = cut_out(segments.rgb, label, stride, part)
        within = enclosed(label)
        floors = None
        if within.any():
            floors = cut_out(segments.rgb, np.where(within, np.int16(0), np.int16(-1)), stride, part)
        colours = tuple(blur_within(counted, width, floors) for width in TUNING.blur)
        normals = np.zeros((*label.shape, 3), dtype=np.float32)
        normals[standing] = segments.normals_W
        return Frame(
            camera=segments.camera,
            depth=segments.depth,
            robot=seen,
            normals=normals,
            stride=stride,
            colours=colours,
            corner=(u0, v0),
            table=segments.table,
            past=label == SEGMENTS.background,
            colour_slopes=noise_slopes(segments.rgb[v0:v1, u0:u1]),
            shift=shift,
            planes=segments.planes,
        )

    @cached_property
    def robot_in_view(self) -> bool:
        """Whether any pixel shows the robot."""
        return bool(self.robot.any())

    @cached_property
    def images(self) -> Images:
        """What `look_up` reads of it."""
        depth = one_layout(self.depth.astype(np.float32, copy=False))
        return Images(depth, one_layout(self.robot), self.robot_in_view, one_layout(self.normals), self.stride)

    @cached_property
    def view(self) -> LooksFrom:
        """How `look_up` takes the camera and the table."""
        one = self.camera
        cx, cy = map(float, one.centre)
        R_WC, p_WC, table = (np.array(part, dtype=float, order="C") for part in (one.R_WC, one.p_WC, self.table))
        return LooksFrom(float(one.fx), float(one.fy), cx, cy, R_WC, p_WC, table)

    @property
    def noise(self) -> NoiseLaw:
        """The deviation of its depth."""
        told = self.camera.depth_noise
        return NoiseLaw(told.floor, told.growth, told.start)

    def corner_of_colours(self) -> tuple[float, float]:
        """Return where the first pixel of `colours` lies, as depth counts pixels."""
        return float(self.corner[0] - self.shift.mean[0]), float(self.corner[1] - self.shift.mean[1])

    def plain_colour_at(self, u: Array, v: Array, level: int) -> Array:
        """Look RGB up of what depth shows at (u, v), each (B, P): (B, P, 3)."""
        return plain_colours(self.colours[level], u, v, self.corner_of_colours())


def whole_pixels(mask: Mask, stride: int, shape: tuple[int, int]) -> Mask:
    """Return a mask of every `stride`-th pixel as one (H, W) of all pixels."""
    wide = cv2.resize(mask.view(np.uint8), None, fx=stride, fy=stride, interpolation=cv2.INTER_NEAREST)
    return cast(Mask, wide[: shape[0], : shape[1]].view(bool))


def blur_within(
    counted: npt.NDArray[np.float32], width: int, floors: npt.NDArray[np.float32] | None = None
) -> npt.NDArray[np.float32]:
    """Blur masked pixels, (h, w, 4) with the mask last, among themselves (normalised convolution): a box, twice.

    A plain blur lets the table into the rim of every object, and registration then shrinks dark objects on light
    tables by pushing them away from the camera. Far from the mask everything is black, but for the `floors` that it
    encloses, likewise blurred among themselves.
    """
    least = np.float32(0.05)
    blurred = _box_twice(counted, width)
    if floors is not None:
        others = _box_twice(floors, width)
        blurred = np.where((blurred[..., 3:] < least) & (others[..., 3:] > 0.0), others, blurred)
    return shared_out(blurred, least)


def _box_twice(image: npt.NDArray[np.float32], width: int) -> npt.NDArray[np.float32]:
    for _ in range(2):
        image = cast("npt.NDArray[np.float32]", cv2.blur(image, (width, width)))
    return image


def noise_slopes(image: npt.NDArray[np.uint8]) -> tuple[float, ...]:
    """Return the mean squared length of derivatives that white noise makes of (h, w, 3) after each blur, of 1.

    The noise is what a difference of Laplacians leaves (Immerkær, Fast Noise Variance Estimation, 1996), as its median,
    so that edges do not count.
    """
    if min(image.shape[:2]) < 5:
        return 0.0, 0.0
    counts = curvature_counts(np.ascontiguousarray(image), TUNING.every)
    middle = np.array([median_of(one) for one in counts]) / 255.0
    variance = (1.4826 * middle) ** 2 / 36.0
    return tuple(float(variance.sum()) * _slope_gain(width) for width in TUNING.blur)


def median_of(counts: npt.NDArray[np.int64]) -> float:
    """Return the median of whole numbers from 0 on, by how often each occurs."""
    below = np.cumsum(counts)
    low, high = np.searchsorted(below, [(below[-1] - 1) // 2, below[-1] // 2], side="right")
    return 0.5 * float(low + high)


@cache
def _slope_gain(width: int) -> float:
    """Return what two boxes and a central difference leave of white noise's variance, both directions together."""
    box = np.convolve(np.full(width, 1.0 / width), np.full(width, 1.0 / width))
    return 2.0 * float((box**2).sum() * (np.convolve(box, [0.5, 0.0, -0.5]) ** 2).sum())
