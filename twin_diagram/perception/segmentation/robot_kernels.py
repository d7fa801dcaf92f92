"""Which points are near the robot at all, compiled."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled


@compiled
def within_spheres(points: Array, centres: Array, radii: Array) -> npt.NDArray[np.bool_]:
    """Return (K, N) which points (N, 3) lie within each of spheres about centres (K, 3) of radii (K,)."""
    close = np.empty((len(centres), len(points)), dtype=np.bool_)
    for k in range(len(centres)):
        squared = radii[k] * radii[k]
        for n in range(len(points)):
            x, y, z = points[n, 0] - centres[k, 0], points[n, 1] - centres[k, 1], points[n, 2] - centres[k, 2]
            close[k, n] = x * x + y * y + z * z < squared
    return close
