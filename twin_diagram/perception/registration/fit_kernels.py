"""Counts how well looked-up points fit an image, compiled; `assessment` says what the counts mean."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.point_kernels import (
    BURIED,
    COLOUR,
    COUNTED,
    DEEPER,
    DISTANCE,
    FACING,
    MATCHED,
    NEAR,
    ROBOT,
    SEEN,
    TEXTURE,
    UNPAINTED,
    NoiseLaw,
    Z,
)
from twin_diagram.perception.registration.residual_kernels import tukey_weight
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled, compiled_in_place


class PlaceCuts(NamedTuple):
    """What is in place.

    Attributes:
        slack: so far off at least may it be [m], …
        deviations: … and so many deviations of the noise more.
        deeper: how much deeper is something else [m].
        model_noise: deviation of the model's surface [m].
    """

    slack: float
    deviations: float
    deeper: float
    model_noise: float


class FitSums(NamedTuple):
    """Sums over the points of B poses, each (B,); all but `points` count by how squarely a point faces the camera.

    Attributes:
        fits: in place and colour.
        alike: the same, by the likeness of colour.
        placed: in place.
        shown: open to see.
        lost: lost to sight.
        whole: all that face the camera.
        points: how many fit.
        untold: in place, but nobody knows of which colour; of these none count as fitting or alike.
        untold_points: how many are.
    """

    fits: Array
    alike: Array
    placed: Array
    shown: Array
    lost: Array
    whole: Array
    points: Array
    untold: Array
    untold_points: Array


@compiled
def placed_weights(
    told: Array,
    flags: npt.NDArray[np.uint8],
    noise: NoiseLaw,
    cuts: PlaceCuts,
) -> Array:
    """Return how squarely points (B, P) face the camera where they are in place, and 0 elsewhere.

    Args:
        told: (B, P, COLUMNS).
        flags: (B, P).
        noise: of depth.
        cuts: of what is in place.
    """
    weight = np.zeros(flags.shape)
    _weigh_placed(told, flags, noise, cuts, weight)
    return weight


@compiled_in_place
def _weigh_placed(told: Array, flags: npt.NDArray[np.uint8], noise: NoiseLaw, cuts: PlaceCuts, weight: Array) -> None:
    """Write what `placed_weights` returns where it is not 0."""
    for b in range(flags.shape[0]):
        for k in range(flags.shape[1]):
            row = told[b, k]
            if flags[b, k] & NEAR and abs(row[DEEPER]) < cuts.deeper:
                depth = noise.floor + noise.growth * (row[Z] - noise.start) ** 2
                sigma = np.sqrt(depth * depth + cuts.model_noise * cuts.model_noise)
                if abs(row[DISTANCE]) < cuts.slack + cuts.deviations * sigma:
                    weight[b, k] = row[FACING]


@compiled
def counts(
    told: Array, flags: npt.NDArray[np.uint8], weight: Array, found: Array, gain: Array, cuts: tuple[float, float]
) -> FitSums:
    """Return sums over the points of each pose.

    Args:
        told: (B, P, COLUMNS).
        flags: (B, P).
        weight: (B, P) of what is in place.
        found: (B, P, 3) the image's colours.
        gain: (B, P) brightness.
        cuts: a colour farther off is another thing's; cosine from which a point faces the camera.
    """
    n = flags.shape[0]
    shares = (np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n))
    sums = FitSums(*shares, np.zeros(n), np.zeros(n), np.zeros(n))
    _count(told, flags, (weight, found, gain), cuts, sums)
    return sums


@compiled_in_place
def _count(
    told: Array,
    flags: npt.NDArray[np.uint8],
    compared: tuple[Array, Array, Array],
    cuts: tuple[float, float],
    sums: FitSums,
) -> None:
    """Add what `counts` returns."""
    weight, found, gain = compared
    colour_cut, least_facing = cuts
    for b in range(flags.shape[0]):
        for k in range(flags.shape[1]):
            row, flag = told[b, k], flags[b, k]
            facing = row[FACING]
            if flag & COUNTED and facing > least_facing:
                sums.whole[b] += facing
            if weight[b, k] != 0.0:
                sums.placed[b] += facing
                sums.shown[b] += facing
                if row[TEXTURE] >= UNPAINTED:
                    sums.untold[b] += facing
                    sums.untold_points[b] += 1.0
                    continue
                size = 0.0
                for i in range(3):
                    off = found[b, k, i] - min(row[COLOUR + i] * gain[b, k], 1.0)
                    size += off * off
                # In proportion to the light, or else everything fits in the dark.
                size = np.sqrt(size) / max(gain[b, k], 0.2)
                sums.alike[b] += facing * tukey_weight(size, colour_cut)
                if size < colour_cut:
                    sums.fits[b] += facing
                    sums.points[b] += 1.0
            elif flag & BURIED or (flag & SEEN and row[DEEPER] >= 0.0):
                sums.shown[b] += facing
            elif facing > least_facing and flag & (SEEN | ROBOT):
                sums.lost[b] += facing


@compiled
def median_excess(
    told: Array, flags: npt.NDArray[np.uint8], noise: NoiseLaw, cuts: tuple[float, float, float]
) -> tuple[float, int]:
    """Return the median size of residuals (P,) in deviations of depth, 0 of none, and how many there are.

    Args:
        told: (P, COLUMNS).
        flags: (P,).
        noise: of depth.
        cuts: how much deeper is something else [m]; a surface is no steeper than of this cosine; no depth is more
            exact [m].
    """
    deeper, least_facing, finest = cuts
    size, n = np.empty(told.shape[0]), 0
    for k in range(told.shape[0]):
        if flags[k] & MATCHED and abs(told[k, DEEPER]) < deeper:
            depth = noise.floor + noise.growth * (told[k, Z] - noise.start) ** 2
            size[n] = abs(told[k, DISTANCE]) / max(depth * max(told[k, FACING], least_facing), finest)
            n += 1
    return (float(np.median(size[:n])) if n else 0.0), n
