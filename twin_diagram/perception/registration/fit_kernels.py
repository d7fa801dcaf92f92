"""Counts how well looked-up points fit an image, compiled; `assessment` says what the counts mean."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.point_kernels import (
    BURIED,
    COLOUR,
    COUNTED,
    DEEPER,
    DISTANCE,
    FACING,
    NEAR,
    ROBOT,
    SEEN,
    Z,
    tukey_weight,
)
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled


@compiled
def placed_weights(
    told: Array,
    flags: npt.NDArray[np.uint8],
    noise: tuple[float, float, float],
    cuts: tuple[float, float, float, float],
) -> Array:
    """Return how squarely points (B, P) face the camera where they are in place, and 0 elsewhere.

    Args:
        told: (B, P, COLUMNS).
        flags: (B, P).
        noise: of depth: floor, growth, start.
        cuts: slack [m]; deviations that are in place; how much deeper is something else [m]; the model's noise [m].
    """
    weight = np.zeros(flags.shape)
    for b in range(flags.shape[0]):
        for k in range(flags.shape[1]):
            row = told[b, k]
            if flags[b, k] & NEAR and abs(row[DEEPER]) < cuts[2]:
                depth = noise[0] + noise[1] * (row[Z] - noise[2]) ** 2
                sigma = np.sqrt(depth * depth + cuts[3] * cuts[3])
                if abs(row[DISTANCE]) < cuts[0] + cuts[1] * sigma:
                    weight[b, k] = row[FACING]
    return weight


@compiled
def counts(
    told: Array, flags: npt.NDArray[np.uint8], weight: Array, found: Array, gain: Array, cuts: tuple[float, float]
) -> Array:
    """Return sums over the points of each pose (B, 7).

    What fits in place and colour, the same by its likeness, what is in place, what is open to see, what is lost to
    sight, the whole, each by how squarely it faces the camera; and how many points fit.

    Args:
        told: (B, P, COLUMNS).
        flags: (B, P).
        weight: (B, P) of what is in place.
        found: (B, P, 3) the image's colours.
        gain: (B, P) brightness.
        cuts: a colour farther off is another thing's; cosine from which a point faces the camera.
    """
    result = np.zeros((flags.shape[0], 7))
    for b in range(flags.shape[0]):
        sums = result[b]
        for k in range(flags.shape[1]):
            row, flag = told[b, k], flags[b, k]
            facing = row[FACING]
            if flag & COUNTED and facing > cuts[1]:
                sums[5] += facing
            if weight[b, k] != 0.0:
                size = 0.0
                for i in range(3):
                    off = found[b, k, i] - min(row[COLOUR + i] * gain[b, k], 1.0)
                    size += off * off
                # In proportion to the light, or else everything fits in the dark.
                size = np.sqrt(size) / max(gain[b, k], 0.2)
                sums[1] += facing * tukey_weight(size, cuts[0])
                sums[2] += facing
                sums[3] += facing
                if size < cuts[0]:
                    sums[0] += facing
                    sums[6] += 1.0
            elif flag & BURIED or (flag & SEEN and row[DEEPER] >= 0.0):
                sums[3] += facing
            elif facing > cuts[1] and flag & (SEEN | ROBOT):
                sums[4] += facing
    return result


@compiled
def lay(a: Array, u: Array, v: Array, cell: float, margin: int) -> npt.NDArray[np.float32]:
    """Return an image (h, w, k) of the sums of rows a (N, k) over square cells [px], with empty cells all round.

    Args:
        a: (N, k).
        u: (N,) where they are [px].
        v: (N,).
        cell: edge of a cell [px].
        margin: cells all round.
    """
    left, top, right, bottom = u[0], v[0], u[0], v[0]
    for k in range(u.shape[0]):
        left, right = min(left, u[k]), max(right, u[k])
        top, bottom = min(top, v[k]), max(bottom, v[k])
    width, height = int(np.rint((right - left) / cell)) + 1, int(np.rint((bottom - top) / cell)) + 1
    image = np.zeros((height + 2 * margin, width + 2 * margin, a.shape[1]), dtype=np.float32)
    for k in range(u.shape[0]):
        line, column = int(np.rint((v[k] - top) / cell)) + margin, int(np.rint((u[k] - left) / cell)) + margin
        for i in range(a.shape[1]):
            image[line, column, i] += a[k, i]
    return image
