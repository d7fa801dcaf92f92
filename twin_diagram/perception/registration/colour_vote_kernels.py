"""What an image's colours cost at poses, compiled; `colour_votes` says what the numbers mean."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.point_kernels import (
    COLOUR,
    DEEPER,
    DISTANCE,
    FACING,
    NEAR,
    TEXTURE,
    UNPAINTED,
    NoiseLaw,
    Z,
)
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled_in_place


class SurfaceCuts(NamedTuple):
    """What is in place.

    Attributes:
        deviations: within so many of depth and surface.
        model_noise: deviation of the surface [m].
        deeper: how much deeper or nearer is something else [m].
    """

    deviations: float
    model_noise: float
    deeper: float


class ColourLaw(NamedTuple):
    """Deviations of colours.

    Attributes:
        bright: along the colour [of 1].
        colour: across it [of 1].
        steep: by what texture adds to a variance of 1 [m²].
        cut: no deviation counts for more.
        unpainted: what a point costs whose colour no picture showed.
    """

    bright: float
    colour: float
    steep: float
    cut: float
    unpainted: float


@compiled_in_place
def weigh_in_place(
    told: Array, flags: npt.NDArray[np.uint8], noise: NoiseLaw, cuts: SurfaceCuts, weight: Array
) -> None:
    """Write how squarely points looked up face the camera (B, P), 0 where they are not in place."""
    for b in range(flags.shape[0]):
        for k in range(flags.shape[1]):
            row, weight[b, k] = told[b, k], 0.0
            if flags[b, k] & NEAR and abs(row[DEEPER]) < cuts.deeper:
                depth = (noise.floor + noise.growth * (row[Z] - noise.start) ** 2) * max(row[FACING], 0.3)
                if abs(row[DISTANCE]) < cuts.deviations * np.hypot(depth, cuts.model_noise):
                    weight[b, k] = row[FACING]


@compiled_in_place
def mean_misses(told: Array, looked: tuple[Array, Array, Array], law: ColourLaw, sums: tuple[Array, Array]) -> None:
    """Write what colours cost in the mean, and how much counts in that, (B,) each.

    Args:
        told: (B, P, COLUMNS) looked up.
        looked: (B, P, 3) colours found, (B, P) brightness, (B, P) how much each point counts.
        law: deviations.
        sums: filled.
    """
    found, gain, weight = looked
    mean, shown = sums
    for b in range(weight.shape[0]):
        total = whole = 0.0
        for k in range(weight.shape[1]):
            if weight[b, k] == 0.0:
                continue
            if told[b, k, TEXTURE] >= UNPAINTED:
                total += weight[b, k] * law.unpainted
                whole += weight[b, k]
                continue
            g, size, along, squared = gain[b, k], 0.0, 0.0, 0.0
            for i in range(3):
                lit = min(told[b, k, COLOUR + i] * g, 1.0)
                off = (found[b, k, i] - lit) / max(g, 0.2)
                size, along, squared = size + lit * lit, along + off * lit, squared + off * off
            along /= max(np.sqrt(size), 1e-6)
            variance = 1.0 + told[b, k, TEXTURE] * law.steep
            across = max(squared - along * along, 0.0) / law.colour**2
            missed = min(((along / law.bright) ** 2 + across) / variance, law.cut**2)
            total += weight[b, k] * 0.5 * (missed + np.log(variance))
            whole += weight[b, k]
        mean[b], shown[b] = total / max(whole, 1e-9), whole
