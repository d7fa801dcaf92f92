"""A solid texture: coloured patches in space, cut by the object's surface.

Because the patches fill space, they run on over edges without seams, have the same size everywhere and make every face,
side and end of an object different from every other: a shape's symmetries end at its colour.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from twin_diagram.signals.arrays import Array

PALETTE: Final[Array] = (
    np.array(
        [
            [214, 48, 49],
            [240, 240, 235],
            [9, 92, 190],
            [250, 200, 20],
            [30, 145, 70],
            [240, 120, 20],
            [120, 60, 160],
            [30, 170, 190],
            [70, 50, 45],
            [235, 130, 165],
            [150, 200, 60],
            [25, 45, 90],
        ],
        dtype=float,
    )
    / 255.0
)
"""Colours of patches, RGB: far apart in hue or in brightness, none too dark to tell its hue."""


def patches(points_O: Array, seed: int, patch: float = 0.025, colours: int = 5) -> Array:
    """Return colours of surface points.

    Args:
        points_O: (M, 3) [m].
        seed: another seed, another pattern and another choice of colours.
        patch: size of a patch [m].
        colours: how many colours of the palette are used.

    Returns:
        (M, 3) RGB in [0, 1].
    """
    rng = np.random.default_rng([seed, 20])
    chosen = PALETTE[rng.permutation(len(PALETTE))[:colours]]
    low, high = points_O.min(axis=0) - patch, points_O.max(axis=0) + patch
    # A whole number of cells, whatever the last bit of the extent says.
    axes = [low[k] + patch * np.arange(int(np.ceil((high[k] - low[k]) / patch - 1e-6)) + 1) for k in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    index = np.indices(grid.shape[:3])
    # Neighbours on the grid never share a colour: two steps of a random walk through the palette per axis.
    colour = (index[0] + 2 * index[1] + 3 * index[2] + rng.integers(0, 2, grid.shape[:3])) % colours
    shuffle = rng.random(grid.shape[:3]) < 0.35
    colour[shuffle] = rng.integers(0, colours, int(shuffle.sum()))
    seeds = (grid + rng.uniform(-0.38, 0.38, grid.shape) * patch).reshape(-1, 3)
    _, nearest = cKDTree(seeds).query(points_O, workers=1)
    return np.asarray(chosen[colour.reshape(-1)[nearest]])
