"""What a real camera measures of exact depth: seeded, a function of the frame's number."""

from __future__ import annotations

import numpy as np

from twin_diagram.scenario import Camera
from twin_diagram.signals.lens import Lens
from twin_diagram.station.depth_units import TUNING as UNITS
from twin_diagram.station.depth_units import Depth
from twin_diagram.station.sim.camera_defects import edges
from twin_diagram.station.sim.camera_edges import Mask, flying, jittered
from twin_diagram.station.sim.camera_materials import Reflections, incidence_cosine
from twin_diagram.station.sim.camera_noise import TUNING as NOISE
from twin_diagram.station.sim.camera_noise import DepthNoiseField
from twin_diagram.station.sim.camera_profiles import CameraFaults
from twin_diagram.station.sim.noise import Stream, generator
from twin_diagram.station.sim.picture_kernels import delivered


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
        lost = np.flatnonzero(at)
        depth.ravel()[lost[rng.random(len(lost), dtype=np.float32) < off.edge_dropout]] = 0.0
        single = np.float32
        delivered(
            depth.ravel(),
            self._noise.frame(number).ravel(),
            (single(off.depth_noise_start), single(off.depth_noise), single(off.depth_noise_floor)),
            (single(self._range[0]), single(self._range[1])),
            single(self._scale),
            (single(1.0 / self._unit), self._unit, single(UNITS.most_units)),
        )
        return depth
