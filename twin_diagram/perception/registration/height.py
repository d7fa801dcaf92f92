"""Tells in which ways an object can lie where something is seen: in those in which it is about as tall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.outline import height_above
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants, set on rendered sequences of grey, repainted and stretched things, whose truth is known."""

    tall: tuple[float, float] = (0.008, 0.05)
    """An object may be so much taller or lower than what is seen [m], and so much for each metre of it."""

    stands: float = 0.08
    """What begins higher above the table does not stand on it [m]: of a narrow bottle's foot 0.05 may be missing."""


TUNING = Tuning()


def extent(points_W: Array, table: Array) -> tuple[float, float]:
    """Return from where to where above a table z = a x + b y + c points (N, 3) reach, but for a few of them [m]."""
    low, top = np.percentile(height_above(table, points_W), [2.0, 98.0])
    return float(low), float(top)


def seen_tall(points_W: Array, table: Array) -> float:
    """Return how tall a thing of points (N, 3) is, down to the table, or to its lowest point above it [m]."""
    low, top = extent(points_W, table)
    return top if low < TUNING.stands else top - low


def as_tall(model: ModelCloud, ways: Sequence[tuple[Array, float]], tall: float) -> list[tuple[Array, float]]:
    """Return those of an object's ways to lie, R (3, 3) and O's height, in which it is about so tall [m]."""
    if not ways:
        return []
    slack = TUNING.tall[0] + TUNING.tall[1] * tall
    heights = np.ptp(model.corners @ np.stack([R[2] for R, _ in ways], axis=1), axis=0)
    return [way for way, height in zip(ways, heights, strict=True) if abs(height - tall) < slack]
