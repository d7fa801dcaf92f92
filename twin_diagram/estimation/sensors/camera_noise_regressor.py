"""How much a camera's pose is to be believed, from how the image looks: a small learned regressor.

Hybrid Reality Twins, section 3.3, has R_vision = σ²_base + σ²_occlusion + σ²_lighting, learned. Here the logarithm of
the deviation is linear in a few features of the covered share and of the brightness, which keeps R positive; the
coefficients were fitted by maximum likelihood to rendered frames of the simulated RGB-D camera, registered as the twin
registers them, by `sims/benchmarks/train_camera_noise.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """How far the law of noise reaches: chosen by hand, about the looks of `sims/benchmarks/train_camera_noise.py`."""

    good: tuple[float, ...] = (0.0, 0.4)
    """A good look: nothing is covered, and neither dusk nor glare."""

    worst: float = 20.0
    """A look beyond those that were learnt from makes a pose at most this many times worse than a good one."""


TUNING = Tuning()
COEFFICIENTS: Final = np.array(
    [
        [-6.773, 0.254, 3.410, 0.569, 2.327],
        [-9.261, 1.241, 1.944, 1.464, 6.200],
    ]
)
"""For rotation [log rad] and position [log m], by `features`."""


def features(covered: float, brightness: float) -> Array:
    """Return what the deviations' logarithm is linear in (5,); the first alone is not zero for a good look.

    Args:
        covered: share of the body's near side that is not seen, 0 to 1.
        brightness: mean of its image, 0 to 1.
    """
    c = float(np.clip(covered, 0.0, 1.0)) - TUNING.good[0]
    b = float(np.clip(brightness, 0.0, 1.0)) - TUNING.good[1]
    return np.array([1.0, c, c * c, b, b * b])


def camera_noise(
    covered: float, brightness: float, good: Array | None = None, coefficients: Array = COEFFICIENTS
) -> Array:
    """Return the standard deviations (6,) of a pose, rotation [rad] then position [m], for `Ekf.update`'s `noise`.

    Args:
        covered: as in `features`. A look that is not finite counts as the worst.
        brightness: as in `features`.
        good: (2,) deviations of a good look, rotation [rad] and position [m], of another camera; the look makes them
            worse as many times. None: those of the camera that was learnt from.
        coefficients: (2, 5).
    """
    base = np.exp(coefficients[:, 0]) if good is None else np.asarray(good)
    if not (np.isfinite(covered) and np.isfinite(brightness)):
        return np.repeat(base * TUNING.worst, 3)
    worse = np.exp(coefficients[:, 1:] @ features(covered, brightness)[1:])
    return np.repeat(base * np.clip(worse, 0.5, TUNING.worst), 3)
