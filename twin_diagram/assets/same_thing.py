"""Finds assets that are one thing twice, as a folder that was copied: which of them is claimed is chance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from twin_diagram.assets.asset import Asset


@dataclass(frozen=True)
class Tuning:
    """Constants of this module: what copies and the same source built twice stay below."""

    size: float = 1e-3
    """By so much edges of the boxes that hold two surfaces may differ [m]."""

    apart: float = 2.0
    """95 % of one's points lie no farther from the other's than so many times as far as its own from one another."""

    colour: float = 0.02
    """Mean difference of colours there, of 1: textures that are read at other points differ by more."""


TUNING = Tuning()


def same_things(assets: Mapping[str, Asset]) -> list[tuple[str, str]]:
    """Return the pairs of names whose surfaces and colours are the same in O."""
    return [(one, other) for one, other in combinations(assets, 2) if _same(assets[one], assets[other])]


def told(assets: Mapping[str, Asset]) -> list[str]:
    """Return what people are told of them, a line a pair."""
    return [
        f"warning: {one} and {other} are the same thing: which of them is claimed is chance; remove one"
        for one, other in same_things(assets)
    ]


def _same(one: Asset, other: Asset) -> bool:
    if np.abs(np.ptp(one.points_O, axis=0) - np.ptp(other.points_O, axis=0)).max() > TUNING.size:
        return False
    distance, nearest = cKDTree(other.points_O).query(one.points_O)
    own = cKDTree(one.points_O).query(one.points_O, k=2)[0][:, 1]
    near = bool(np.quantile(distance, 0.95) <= TUNING.apart * np.quantile(own, 0.95))
    return near and float(np.abs(one.colours - other.colours[nearest]).mean()) <= TUNING.colour
