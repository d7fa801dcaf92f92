"""The compiled part of `flow`: places on a thing meet the surface that an image shows."""

from __future__ import annotations

import numpy as np

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled


@compiled
def meet(
    places: Array, normals: Array, points: Array, facing: Array, shift: Array, reach: float, least: float
) -> Array:
    """Return (S, 2) of places shifted by `shift` (3): how far along its normal the surface is [m], and whether it is.

    The surface there is the nearest of the image's points; it does not count farther than `reach` [m], nor where it
    faces another way.

    Args:
        places: (S, 3) [m].
        normals: (S, 3) theirs.
        points: (N, 3) the image's [m].
        facing: (N, 3) theirs.
        shift: (3,) [m].
        reach: [m].
        least: cosine between two normals that face alike.
    """
    result = np.zeros((len(places), 2))
    for s in range(len(places)):
        x, y, z = places[s, 0] + shift[0], places[s, 1] + shift[1], places[s, 2] + shift[2]
        best, nearest = reach * reach, -1
        for k in range(len(points)):
            off = (points[k, 0] - x) ** 2
            if off >= best:
                continue
            off += (points[k, 1] - y) ** 2 + (points[k, 2] - z) ** 2
            if off < best:
                best, nearest = off, k
        if nearest < 0:
            continue
        a, b, c = normals[s, 0], normals[s, 1], normals[s, 2]
        if a * facing[nearest, 0] + b * facing[nearest, 1] + c * facing[nearest, 2] < least:
            continue
        result[s, 0] = a * (points[nearest, 0] - x) + b * (points[nearest, 1] - y) + c * (points[nearest, 2] - z)
        result[s, 1] = 1.0
    return result
