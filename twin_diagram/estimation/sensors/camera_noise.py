"""How much a camera's pose is to be believed, from how the image looks: a small learned regressor.

Hybrid Reality Twins, section 3.3, has R_vision = σ²_base + σ²_occlusion + σ²_lighting, learned. Here the logarithm of
the deviation is linear in a few features of the covered share and of the brightness, which keeps R positive; the
coefficients were fitted by maximum likelihood to simulated frames by `sims/train_camera_noise.py`.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from twin_diagram.signals import Array

COEFFICIENTS: Final = np.array(
    [
        [-3.62, 0.951, 0.779, -1.602, 8.431],
        [-5.789, 0.977, 0.826, -1.555, 8.399],
    ]
)
"""For rotation [log rad] and position [log m], by `features`."""
WORST: Final = 20.0
"""A look beyond those that were learnt from makes a pose at most this many times worse than a good one."""


def features(covered: float, brightness: float) -> Array:
    """What the deviations' logarithm is linear in (5,).

    Args:
        covered: share of the body that is not seen, 0 to 1.
        brightness: mean of its image, 0 to 1.
    """
    c = float(np.clip(covered, 0.0, 1.0))
    off = abs(float(np.clip(brightness, 0.0, 1.0)) - 0.5)
    return np.array([1.0, c, c * c, off, off * off])


def camera_noise(covered: float, brightness: float, coefficients: Array = COEFFICIENTS) -> Array:
    """Standard deviations (6,) of a pose, rotation [rad] then position [m], for `Ekf.update`'s `noise`.

    A look that is not finite counts as the worst.
    """
    base = np.exp(coefficients[:, 0])
    if not (np.isfinite(covered) and np.isfinite(brightness)):
        return np.repeat(base * WORST, 3)
    std = np.exp(coefficients @ features(covered, brightness))
    return np.repeat(np.clip(std, 0.5 * base, WORST * base), 3)
