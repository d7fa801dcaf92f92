"""A camera as bad as real ones: what it delivers, from the states in which its colours and its depth were taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import BasicVector, Context, LeafSystem
from pydrake.systems.sensors import ImageDepth32F, ImageRgba8U

from twin_diagram.runtime.timing import timed
from twin_diagram.scenario import Camera, Scenario
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.lens import Lens
from twin_diagram.station.depth_units import Colour, Depth, whole_units
from twin_diagram.station.sim.camera_defects import edges
from twin_diagram.station.sim.camera_edges import Mask, flying, jittered
from twin_diagram.station.sim.camera_light import DimLight, mean_of
from twin_diagram.station.sim.camera_materials import Reflections, incidence_cosine
from twin_diagram.station.sim.camera_noise import TUNING as NOISE
from twin_diagram.station.sim.camera_noise import DepthNoiseField, depth_rms
from twin_diagram.station.sim.camera_profiles import CameraFaults, faults
from twin_diagram.station.sim.camera_truth import TrueCamera
from twin_diagram.station.sim.noise import Stream, generator
from twin_diagram.station.sim.world_renderer import LensView, WorldRenderer


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    still: float = 1e-4
    """What moves less while the shutter is open is not blurred [m; rad]: a tenth of a pixel at 1 m."""


TUNING = Tuning()


class DepthSensor:
    """Turns exact depth into what a real camera measures: a function of seed and frame."""

    def __init__(self, lens: Lens, camera: Camera, off: CameraFaults, unit: float, scale: float, seed: int) -> None:
        """Draw what is fixed for the run.

        Args:
            lens: of depth, as it is.
            camera: of it the range of depth.
            off: how bad it is.
            unit: of depth [m].
            scale: what depth is multiplied by.
            seed: of the scenario.
        """
        shape = (lens.height, lens.width)
        self._lens, self._off, self._unit, self._scale, self._seed = lens, off, unit, scale, seed
        self._range = camera.depth_range
        self._pixel = lens.width / NOISE.width
        self._noise = DepthNoiseField(shape, off, seed)
        self._reflections = Reflections(shape, off, seed)

    def measured(self, depth: Depth, number: int, reflective: Mask | None = None) -> Depth:
        """Return the depth (H, W) of a frame as it is delivered, 0 where nothing was measured.

        Args:
            depth: exact [m], 0 or infinite where there is none; not changed.
            number: of the frame.
            reflective: where the surface reflects.
        """
        off = self._off
        rng = generator(self._seed, Stream.CAMERA_EDGES, number)
        depth = np.where(np.isfinite(depth), depth, np.float32(0.0))
        if off.steepest < np.pi / 2:
            depth[incidence_cosine(depth, self._lens) < np.cos(off.steepest)] = 0.0
        if reflective is not None:
            depth = self._reflections.on(depth, reflective)
        depth = jittered(depth, off.edge_jitter * self._pixel, off.correlation * self._pixel, rng)
        at = edges(depth)
        depth = flying(depth, at, off.flying_pixels, rng)
        depth = depth + np.where(depth > 0, depth_rms(depth, off) * self._noise.frame(number), np.float32(0.0))
        lost = np.flatnonzero(at)
        depth.ravel()[lost[rng.random(len(lost), dtype=np.float32) < off.edge_dropout]] = 0.0
        depth[(depth < self._range[0]) | (depth > self._range[1])] = 0.0
        return whole_units(depth * np.float32(self._scale), self._unit)


class RealCamera(LeafSystem):
    """Renders what the camera saw and turns it into what it delivers.

    .. pydrake_system::

        name: RealCamera
        input_ports:
        - colour_state
        - depth_state
        - capture_time
        output_ports:
        - rgb_image
        - depth_image
        - image_time

    `colour_state` and `depth_state` (nq + nv) are those of the world's plant when each was taken. `depth_image` is in
    the camera's units of length, a whole number of depth units, 0 where nothing was measured. `image_time` is the
    capture time of the colours [s], `NEVER` before the first, while images are black and empty. Computed where they are
    asked for, cached, a function of seed, capture time and states alone; adds no latency. The blur of what moves is the
    mean of two pictures, of the shutter's opening and of its closing.
    """

    def __init__(
        self, scenario: Scenario, truth: TrueCamera, plant: MultibodyPlant, renderer: WorldRenderer, labels: list[int]
    ) -> None:
        """Build the camera.

        Args:
            scenario: its ``twin.camera`` is not None, and its defects were checked.
            truth: where the camera is and what its lenses are.
            plant: the world's, finalized.
            renderer: of the same world.
            labels: of the bodies that reflect.
        """
        super().__init__()
        camera, defects = scenario.twin.camera, scenario.world.camera_defects
        assert camera is not None
        self._camera, self._covered_at = camera, defects.covered
        self._off, self._truth = faults(defects), truth
        self._plant, self._plant_context = plant, plant.CreateDefaultContext()
        self._renderer, self._labels = renderer, labels
        self._views = (LensView(truth.colour), LensView(truth.depth))
        size = camera.width * camera.height * 4
        self._light = DimLight(size, defects.colour_noise, self._off, scenario.seed)
        self._sensor = DepthSensor(truth.depth, camera, self._off, defects.depth_unit, truth.depth_scale, scenario.seed)
        nx = plant.num_multibody_states()
        self._states = [self.DeclareVectorInputPort(name, nx) for name in ("colour_state", "depth_state")]
        self._time = self.DeclareVectorInputPort("capture_time", 1)
        rgb, depth = Value(ImageRgba8U(camera.width, camera.height)), Value(ImageDepth32F(*camera.depth_size))
        ticket = self._time.ticket()
        self.DeclareAbstractOutputPort("rgb_image", rgb.Clone, self._calc_rgb, {ticket, self._states[0].ticket()})
        self.DeclareAbstractOutputPort("depth_image", depth.Clone, self._calc_depth, {ticket, self._states[1].ticket()})
        self.DeclareVectorOutputPort("image_time", 1, self._calc_time, {ticket})

    def _frame(self, context: Context) -> int | None:
        """Return the number of the newest frame; None before the first and while the lens is covered."""
        time = float(self._time.Eval(context)[0])
        if time < 0 or any(start <= time <= end for start, end in self._covered_at):
            return None
        return round(time * self._camera.rate)

    @timed("Camera")
    def _calc_rgb(self, context: Context, output: Value) -> None:
        image = ImageRgba8U(self._camera.width, self._camera.height)
        number = self._frame(context)
        if number is None:
            image.mutable_data[:] = (0, 0, 0, 255)
        else:
            image.mutable_data[:] = self._light.seen(self._exposed(self._states[0].Eval(context)), number)
        output.set_value(image)

    @timed("Camera")
    def _calc_depth(self, context: Context, output: Value) -> None:
        image = ImageDepth32F(*self._camera.depth_size)
        number = self._frame(context)
        if number is None:
            image.mutable_data[:] = 0.0
        else:
            q = self._states[1].Eval(context)[: self._plant.num_positions()]
            view, X_WD = self._views[1], self._truth.X_WD
            depth = self._renderer.depth(q, view, X_WD)
            shining = self._renderer.shows(q, view, X_WD, self._labels) if self._labels else None
            image.mutable_data[..., 0] = self._sensor.measured(depth, number, shining)
        output.set_value(image)

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        output[0] = self._time.Eval(context)[0]

    def _exposed(self, state: Array) -> Colour:
        """Return the picture (H, W, 4) of a shutter that is open about the moment of a state."""
        nq = self._plant.num_positions()
        q, v = state[:nq], state[nq:]
        view, X_WC = self._views[0], self._truth.X_WC
        if float(np.abs(v).max(initial=0.0)) * self._off.exposure < TUNING.still:
            return self._renderer.colour(q, view, X_WC)
        self._plant.SetPositions(self._plant_context, q)
        half = 0.5 * self._off.exposure * self._plant.MapVelocityToQDot(self._plant_context, v)
        # A renderer's image is its own until the next: copied.
        opening = self._renderer.colour(q - half, view, X_WC).copy()
        return mean_of(opening, self._renderer.colour(q + half, view, X_WC))
