"""Noise of depth as real cameras have it: little of it white, most correlated over pixels, some fixed for the run."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.station.sim.camera_profiles import CameraFaults
from twin_diagram.station.sim.noise import Stream, generator

Field = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    width: float = 640.0
    """Figures in pixels are those of images so wide [px]."""

    offsets: int = 2**18
    """Places in the table of white noise at which a frame may begin: more than frames in a run of hours."""

    reach: float = 4.0
    """The Gaussian that correlates noise ends after so many σ."""


TUNING = Tuning()


def bytes_of(shape: tuple[int, int], rng: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Return uniform bytes: the cheapest random numbers there are; a blur makes them normal."""
    count = shape[0] * shape[1]
    words = rng.integers(0, 2**64, size=-(-count // 8), dtype=np.uint64, endpoint=False)
    return words.view(np.uint8)[:count].reshape(shape)


def correlated(shape: tuple[int, int], sigma: float, rng: np.random.Generator) -> Field:
    """Return a normal field of mean 0 and variance 1, white noise blurred by a Gaussian, the same up to the rim.

    Args:
        shape: (H, W).
        sigma: of the Gaussian [px]: neighbours at a distance d are correlated by exp(-d² / 4σ²).
        rng: of this field.
    """
    rim = max(1, round(TUNING.reach * sigma))
    kernel = cv2.getGaussianKernel(2 * rim + 1, sigma, cv2.CV_32F)
    white = bytes_of((shape[0] + 2 * rim, shape[1] + 2 * rim), rng).astype(np.float32)
    # The mean and the variance of a byte, and what the blur leaves of the variance.
    kept = float(np.square(kernel).sum())
    scale = np.float32(1.0 / (kept * np.sqrt((256.0**2 - 1.0) / 12.0)))
    blurred = cv2.sepFilter2D(white, cv2.CV_32F, kernel * scale, kernel)[rim:-rim, rim:-rim]
    return np.asarray(blurred - np.float32(127.5) * scale)


class DepthNoiseField:
    """The error of depth in units of its RMS, frame by frame: a function of seed and frame."""

    def __init__(self, shape: tuple[int, int], faults: CameraFaults, seed: int) -> None:
        """Draw what is fixed for the run.

        Args:
            shape: (H, W) of the depth images.
            faults: of the camera.
            seed: of the scenario.
        """
        rng = generator(seed, Stream.CAMERA_RUN, 0)
        self._shape, self._seed = shape, seed
        self._sigma = faults.correlation * shape[1] / TUNING.width
        self._fresh = np.float32(np.sqrt(max(0.0, 1.0 - faults.white_share - faults.wave_share)))
        waves = correlated(shape, faults.waves * shape[1] / TUNING.width, rng)
        # An image holds few waves: made to have the run's RMS, not one of many runs.
        waves -= waves.mean()
        waves *= np.float32(np.sqrt(faults.wave_share)) / max(float(waves.std()), 1e-6)
        self.waves: Field = waves
        """(H, W), the part that is fixed for the run."""
        white = rng.standard_normal(shape[0] * shape[1] + TUNING.offsets, dtype=np.float32)
        self._white = white * np.float32(np.sqrt(faults.white_share))

    def frame(self, number: int) -> Field:
        """Return (H, W) the error of a frame, of variance 1."""
        rng = generator(self._seed, Stream.CAMERA_NOISE, number)
        offset = int(rng.integers(TUNING.offsets))
        field = correlated(self._shape, self._sigma, rng)
        field *= self._fresh
        field += self.waves
        field += self._white[offset : offset + field.size].reshape(self._shape)
        return field
