"""The solid texture: its size, its colours, and that it depends on its seed alone."""

from __future__ import annotations

import numpy as np
import pytest

from twin_diagram.assets.texture import PALETTE, patches
from twin_diagram.signals.arrays import Array


def plane(step: float, half: float = 0.15) -> Array:
    """(n, n, 3) points on a plane."""
    line = np.arange(-half, half, step)
    x, y = np.meshgrid(line, line, indexing="ij")
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


def painted(step: float = 0.0025, **how: float) -> Array:
    points = plane(step)
    return patches(points.reshape(-1, 3), 4, **how).reshape(points.shape)  # type: ignore[arg-type]


def edges(colour: Array) -> float:
    """Share of neighbours along x that differ."""
    return float((colour[1:] != colour[:-1]).any(axis=2).mean())


def test_patches_have_their_size() -> None:
    """Of Voronoi cells of edge a, a line crosses 1 to 1.6 borders per a, some of them between equal colours."""
    for size in (0.025, 0.04):
        assert 0.8 < edges(painted(patch=size)) * size / 0.0025 < 1.5
    assert edges(painted()) == edges(painted(patch=0.025))


def test_so_many_colours_of_the_palette_are_used() -> None:
    for count in (3, 5):
        used = np.unique(painted(colours=count).reshape(-1, 3), axis=0)
        assert len(used) == count
        assert all(np.abs(PALETTE - colour).sum(axis=1).min() == 0.0 for colour in used)
    assert len(np.unique(painted().reshape(-1, 3), axis=0)) == 5
    assert PALETTE.max() <= 1.0 and PALETTE.max() > 0.9 and PALETTE.min() >= 0.0


def test_seeds_give_other_patterns() -> None:
    points = plane(0.005).reshape(-1, 3)
    one, again, other = (patches(points, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert (one != other).any(axis=1).mean() > 0.5


@pytest.mark.parametrize("axis", range(3))
def test_rounding_of_the_extent_changes_no_cell(axis: int) -> None:
    points = plane(0.005).reshape(-1, 3)
    points[:, 2] = np.linspace(-0.05, 0.05, len(points))
    wider = points.copy()
    wider[np.argmax(points[:, axis]), axis] += 1e-12
    assert (patches(points, 7) != patches(wider, 7)).any(axis=1).mean() < 1e-3
