"""Where real depth cameras see nothing or wrongly: surfaces that they see too steeply, and those that reflect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from twin_diagram.signals.compiled import one_layout
from twin_diagram.signals.lens import Lens
from twin_diagram.station.depth_units import Depth
from twin_diagram.station.sim.camera_noise import TUNING as NOISE
from twin_diagram.station.sim.camera_noise import Field, correlated
from twin_diagram.station.sim.camera_profiles import CameraFaults
from twin_diagram.station.sim.noise import Stream, generator
from twin_diagram.station.sim.picture_kernels import cosines

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    patch: float = 8.0
    """σ of the Gaussian that makes patches of a reflective surface, at 640 pixels a row [px]: some 2 to 4 cm at 1 m."""


TUNING = Tuning()


def incidence_cosine(depth: Depth, lens: Lens) -> Field:
    """Return the cosine of the angle between line of sight and normal, from the slopes of depth.

    With depth z(u, v), the normal is along (fx z_u, fy z_v, -(z + (u - cx) z_u + (v - cy) z_v)), and its product with
    the line of sight ((u - cx) / fx, (v - cy) / fy, 1) is -z. Of the slopes to both neighbours the flatter one is
    taken: the other may lead over an edge.

    Args:
        depth: (H, W) [m], exact.
        lens: without distortion, or with so little that slopes do not mind.

    Returns:
        (H, W) from 0 to 1; of pixels without depth it means nothing.
    """
    u = np.arange(lens.width, dtype=np.float32) - np.float32(lens.cx)
    v = np.arange(lens.height, dtype=np.float32) - np.float32(lens.cy)
    result = np.empty(depth.shape, np.float32)
    cosines(one_layout(np.asarray(depth, np.float32)), u, v, np.float32(lens.fx), np.float32(lens.fy), result)
    return result


class Reflections:
    """The patches of a reflective surface that have no depth, or are seen too deep: fixed in the image for the run."""

    def __init__(self, shape: tuple[int, int], faults: CameraFaults, seed: int) -> None:
        """Draw the patches.

        Args:
            shape: (H, W) of the depth images.
            faults: of the camera.
            seed: of the scenario.
        """
        rng = generator(seed, Stream.CAMERA_RUN, 1)
        sigma = TUNING.patch * shape[1] / NOISE.width
        level = _uniform(correlated(shape, sigma, rng))
        low, high = faults.too_deep
        self.lost: Mask = level < faults.reflective_lost
        """(H, W), where there would be none."""
        deeper = low + (high - low) * _uniform(correlated(shape, sigma, rng))
        self.deeper: Field = np.where(level > 1.0 - faults.reflective_deep, deeper, 0.0).astype(np.float32)
        """(H, W), what would be added to depth [m]."""

    def on(self, depth: Depth, reflective: Mask) -> Depth:
        """Return the depth with its reflective pixels (H, W) disturbed."""
        result = depth + np.where(reflective & (depth > 0), self.deeper, np.float32(0.0))
        result[reflective & self.lost] = 0.0
        return np.asarray(result)


def _uniform(normal: Field) -> Field:
    """Return a standard normal field as a uniform one from 0 to 1."""
    return np.asarray(ndtr(normal))
