"""From covariances to ellipsoids that can be drawn."""

from __future__ import annotations

from typing import Final

import numpy as np
from pydrake.math import RotationMatrix

from twin_diagram.signals.arrays import Array

DEVIATIONS: Final = 3.0
"""How many standard deviations an ellipsoid's surface is from its centre."""
SMALLEST: Final = 0.002
"""No semi-axis is drawn shorter than this: it would not be seen [m]."""


def ellipsoid(
    covariance: Array, deviations: float = DEVIATIONS, scale: float = 1.0, smallest: float = SMALLEST
) -> tuple[RotationMatrix, Array]:
    """Return directions R_WE and lengths (3,) [m] of the semi-axes that draw a position's covariance (3, 3) [m²].

    Args:
        covariance: in W, symmetric; what rounding makes negative counts as zero.
        deviations: how many standard deviations the surface is from the centre.
        scale: further magnification, for what is too small to see.
        smallest: no semi-axis is shorter [m].
    """
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    if np.linalg.det(vectors) < 0.0:
        vectors[:, 0] = -vectors[:, 0]
    lengths = deviations * scale * np.sqrt(np.maximum(values, 0.0))
    return RotationMatrix(vectors), np.maximum(lengths, smallest)
