"""What little light does to colours: they are dark, and the fewer photons there are, the more their number scatters."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.compiled import one_layout
from twin_diagram.station.depth_units import Colour
from twin_diagram.station.sim.camera_noise import TUNING as NOISE
from twin_diagram.station.sim.camera_profiles import CameraFaults
from twin_diagram.station.sim.noise import Stream, generator
from twin_diagram.station.sim.picture_kernels import scattered


class DimLight:
    """Darkens colours and adds read and shot noise: a function of seed and frame."""

    def __init__(self, size: int, colour_noise: float, faults: CameraFaults, seed: int) -> None:
        """Draw a table of noise.

        Args:
            size: numbers in an image, H·W·4.
            colour_noise: standard deviation of dark pixels, of 255.
            faults: of the camera.
            seed: of the scenario.
        """
        self._seed = seed
        rng = generator(seed, Stream.CAMERA_TABLE, 0)
        self._table = rng.standard_normal(size + NOISE.offsets, dtype=np.float32)
        level = np.arange(256, dtype=np.float32) * np.float32(faults.light)
        self._level = level
        self._std = np.sqrt(colour_noise**2 + faults.shot_noise**2 * level / 255.0).astype(np.float32)

    def seen(self, colour: Colour, number: int) -> Colour:
        """Return the colours (H, W, 4) of a frame as the camera delivers them, alpha 255; they are not changed."""
        offset = int(generator(self._seed, Stream.CAMERA_TABLE, 1 + number).integers(NOISE.offsets))
        result: Colour = np.empty_like(colour, order="C")
        noise = self._table[offset : offset + colour.size]
        scattered(one_layout(colour).reshape(-1, 4), self._level, self._std, noise, result.reshape(-1, 4))
        return result


def mean_of(first: Colour, second: Colour) -> npt.NDArray[np.uint8]:
    """Return the mean of two pictures, (H, W, 4) each, rounded up: what moved between them is blurred."""
    return np.asarray((first | second) - ((first ^ second) >> 1))
