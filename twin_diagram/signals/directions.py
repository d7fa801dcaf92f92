"""Directions in space, spread evenly."""

from __future__ import annotations

import numpy as np

from twin_diagram.signals.arrays import Array


def fibonacci_sphere(count: int) -> Array:
    """Return unit vectors (count, 3), spread evenly from pole to pole along a spiral of the golden angle."""
    k = np.arange(count) + 0.5  # from ½: no pole comes twice
    z = 1.0 - 2.0 * k / count
    angle = np.pi * (1.0 + 5.0**0.5) * k
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
