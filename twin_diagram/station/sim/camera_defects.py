"""What a real RGB-D camera does to its images: noise, whole depth units, ragged edges, a covered lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydrake.common.value import Value
from pydrake.systems.framework import BasicVector, Context, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from twin_diagram.errors import ScenarioError
from twin_diagram.runtime.timing import timed
from twin_diagram.scenario import Camera, CameraDefects
from twin_diagram.station.depth_units import TUNING as DEPTH_UNITS
from twin_diagram.station.depth_units import Colour, Depth, whole_units
from twin_diagram.station.sim.camera_profiles import faults
from twin_diagram.station.sim.noise import Stream, generator


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    edge: float = 0.015
    """A step in depth between neighbours, as a share of the depth, at which the camera may see nothing."""


TUNING = Tuning()


def edges(depth: Depth) -> npt.NDArray[np.bool_]:
    """Return true for the pixels next to a step in depth.

    Args:
        depth: (H, W) [m], 0 where there is none.

    Returns:
        (H, W) booleans: both sides of each step.
    """
    mask = np.zeros(depth.shape, dtype=bool)
    reach = TUNING.edge * depth
    columns = ((slice(None), slice(1, None)), (slice(None), slice(None, -1)))
    rows = ((slice(1, None),), (slice(None, -1),))
    for first, second in (columns, rows):
        step = np.abs(depth[first] - depth[second]) > reach[first]
        mask[first] |= step
        mask[second] |= step
    return mask


def spoil_depth(depth: Depth, defects: CameraDefects, depth_range: Sequence[float], rng: np.random.Generator) -> Depth:
    """Return the depth as the camera measures it.

    Args:
        depth: (H, W) true depth [m], 0 or infinite where there is none; not changed.
        defects: noise grows with the square of depth, as a stereo or structured-light camera's does (Khoshelham and
            Elberink, Sensors 12(2), 2012).
        depth_range: nearest and farthest depth [m].
        rng: of this frame.

    Returns:
        (H, W) a whole number of depth units [m], 0 where nothing was measured.
    """
    off = faults(defects)
    noisy = np.where(np.isfinite(depth), depth, np.float32(0.0))
    at = np.flatnonzero(edges(noisy)) if off.edge_dropout > 0 else np.zeros(0, dtype=np.intp)
    if off.depth_noise > 0:
        noise = rng.standard_normal(noisy.shape, dtype=np.float32)
        noise *= np.float32(off.depth_noise)
        noise *= noisy
        noise += np.float32(1.0)
        noisy *= noise
    noisy.ravel()[at[rng.random(len(at), dtype=np.float32) < off.edge_dropout]] = 0.0
    noisy[(noisy < depth_range[0]) | (noisy > depth_range[1])] = 0.0
    return whole_units(noisy, defects.depth_unit)


def spoil_colour(colour: Colour, noise: npt.NDArray[np.int16], offset: int) -> Colour:
    """Return the colour with noise.

    Args:
        colour: (H, W, 4); not changed.
        noise: a table of more than H·W·4 numbers, of which this frame takes those from `offset` on.
        offset: of this frame.

    Returns:
        (H, W, 4), alpha 255.
    """
    part = noise[offset : offset + colour.size].reshape(colour.shape)
    spoilt = np.clip(part + colour, 0, 255).astype(np.uint8)
    spoilt[..., 3] = 255
    return spoilt


def check_defects(camera: Camera, defects: CameraDefects) -> None:
    """Refuse defects that make no sense.

    Raises:
        ScenarioError: names the field.
    """
    faults(defects)
    if not defects.colour_noise >= 0:
        raise ScenarioError("world.camera_defects.colour_noise", f"{defects.colour_noise} is negative")
    if not defects.depth_unit > 0:
        raise ScenarioError("world.camera_defects.depth_unit", f"{defects.depth_unit} is not positive")
    if camera.depth_range[1] > DEPTH_UNITS.most_units * defects.depth_unit:
        raise ScenarioError(
            "world.camera_defects.depth_unit",
            f"{defects.depth_unit} m is too fine for 16 bits to reach the depth range",
        )
    for i, interval in enumerate(defects.covered):
        if len(interval) != 2 or interval[0] > interval[1]:
            raise ScenarioError(f"world.camera_defects.covered[{i}]", f"{interval} is not [start, end]")


class CameraDefectsSystem(LeafSystem):
    """Turns rendered images into what the camera delivers.

    .. pydrake_system::

        name: CameraDefectsSystem
        input_ports:
        - rgb_rendered
        - depth_rendered
        - time_rendered
        output_ports:
        - rgb_image
        - depth_image
        - image_time

    `depth_image` is in metres, a whole number of depth units, 0 where nothing was measured. `image_time` is the
    capture time of the images [s], `NEVER` before the first, while images are black and empty. Computed where they
    are asked for, cached, a function of seed and capture time alone; adds no latency.
    """

    def __init__(self, camera: Camera, defects: CameraDefects, seed: int) -> None:
        """Check the defects and draw the table of colour noise.

        Raises:
            ScenarioError: a defect that makes no sense.
        """
        super().__init__()
        check_defects(camera, defects)
        self._camera, self._defects, self._seed = camera, defects, seed
        size = camera.width * camera.height * 4
        rng = generator(seed, Stream.CAMERA_TABLE, 0)
        table = rng.standard_normal(size + 2**18, dtype=np.float32) * np.float32(defects.colour_noise)
        self._table = np.rint(table).astype(np.int16)
        rgb = Value(ImageRgba8U(camera.width, camera.height))
        depth = Value(ImageDepth32F(camera.width, camera.height))
        self._rgb = self.DeclareAbstractInputPort("rgb_rendered", Value(ImageRgba8U()))
        self._depth = self.DeclareAbstractInputPort("depth_rendered", Value(ImageDepth32F()))
        self._time = self.DeclareVectorInputPort("time_rendered", 1)
        ticket = self._time.ticket()
        # Drake's renderer counts as depending on time, and would render anew at each step. What it shows changes with
        # the capture time, which comes from the same state.
        self.DeclareAbstractOutputPort("rgb_image", rgb.Clone, self._calc_rgb, {ticket})
        self.DeclareAbstractOutputPort("depth_image", depth.Clone, self._calc_depth, {ticket})
        self.DeclareVectorOutputPort("image_time", 1, self._calc_time, {ticket})

    def _frame(self, context: Context) -> tuple[float, int] | None:
        """Capture time and number of the newest frame; None before the first."""
        time = float(self._time.Eval(context)[0])
        return (time, round(time * self._camera.rate)) if time >= 0 else None

    def _covered(self, time: float) -> bool:
        return any(start <= time <= end for start, end in self._defects.covered)

    @timed("Camera")
    def _calc_rgb(self, context: Context, output: Value) -> None:
        image = ImageRgba8U(self._camera.width, self._camera.height)
        frame = self._frame(context)
        if frame is None or self._covered(frame[0]):
            image.mutable_data[:] = (0, 0, 0, 255)
        else:
            offset = int(generator(self._seed, Stream.CAMERA_TABLE, 1 + frame[1]).integers(2**18))
            image.mutable_data[:] = spoil_colour(self._rgb.Eval(context).data, self._table, offset)
        output.set_value(image)

    @timed("Camera")
    def _calc_depth(self, context: Context, output: Value) -> None:
        image = ImageDepth32F(self._camera.width, self._camera.height)
        frame = self._frame(context)
        if frame is None or self._covered(frame[0]):
            image.mutable_data[:] = 0.0
        else:
            rng = generator(self._seed, Stream.CAMERA, frame[1])
            depth = self._depth.Eval(context).data[..., 0]
            image.mutable_data[..., 0] = spoil_depth(depth, self._defects, self._camera.depth_range, rng)
        output.set_value(image)

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        output[0] = self._time.Eval(context)[0]
