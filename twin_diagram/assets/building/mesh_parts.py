"""Triangles with a look: what every reader of meshes makes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.assets.mesh import Image
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    grey: float = 0.7
    """RGB of what has no colour: light enough to be told from a shadow."""


TUNING = Tuning()


@dataclass(frozen=True)
class Part:
    """Triangles with one look, in the file's unit and axes.

    Attributes:
        corners: (F, 3, 3) of each triangle's corners the place; counter-clockwise from outside, if the file is right.
        uv: (F, 3, 2) texture coordinates, v upwards, or None.
        image: RGB, where there is a texture; then `uv` is there, too.
        colours: (F, 3) RGB in [0, 1] of each triangle, where there is no texture.
    """

    corners: Array
    uv: Array | None
    image: Image | None
    colours: Array


def grey(corners: Array) -> Part:
    """Return triangles (F, 3, 3) without a look of their own."""
    return Part(corners, None, None, np.full((len(corners), 3), TUNING.grey))
