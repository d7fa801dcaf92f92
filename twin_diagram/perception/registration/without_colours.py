"""An object's model without its colours: what is painted otherwise than its asset is its shape alone.

Before a camera that shows none, it is its shades.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.assets import Asset
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of what shape cannot tell apart, set on six YCB things, a mug and a can."""

    mean: float = 0.045
    """A turned surface is the same to within this share of the radius on average, beside half a spacing, …"""

    most: float = 0.25
    """… and all but a few of its points within this share: a mug's handle is not."""

    share: float = 97.0
    """So many of a hundred points."""

    points: int = 400
    """Of its points."""

    round: int = 20
    """It is round about z if so many of 23 turns about it leave it alike."""

    apart: float = 0.8
    """Turns nearer to one another count once [rad]."""

    light: tuple[float, float, float] = (0.299, 0.587, 0.114)
    """How bright red, green and blue are in a picture of shades (ITU-R BT.601)."""


TUNING = Tuning()


def in_shades(asset: Asset) -> Asset:
    """Return an object as pictures without colours show it."""
    return replace(asset, colours=np.repeat(asset.colours @ TUNING.light, 3).reshape(-1, 3))


def without_colours(model: ModelCloud) -> ModelCloud:
    """Return a model of one grey, whose turns are those that shape leaves alike; about a round thing's axis none count.

    Args:
        model: the object.
    """
    alike = np.array([turn for turn in model.turns if _same(model, turn)]).reshape(-1, 3, 3)
    about = alike[:, 2, 2] > 0.99
    is_round = model.asset.symmetric_axis == "z" or int(about.sum()) >= TUNING.round
    if is_round:
        alike = alike[alike[:, 2, 2] < -0.99][:1]
    grey = replace(
        model.asset,
        colours=np.full_like(model.asset.colours, 0.5),
        symmetric_axis="z" if is_round else model.asset.symmetric_axis,
    )
    colours, none = np.full_like(model.colours, 0.5), np.zeros_like(model.texture)
    return replace(model, asset=grey, colours=colours, texture=none, turns=_distinct(alike))


def _same(model: ModelCloud, turn: Array) -> bool:
    """Return whether a turn (3, 3) about the middle leaves a shape alike."""
    thin = model.points[:: max(1, len(model.points) // TUNING.points)] - model.middle
    distance, _ = model.tree.query(thin @ turn.T + model.middle, workers=1)
    mean = 0.5 * model.spacing + TUNING.mean * model.radius
    return bool(distance.mean() < mean and np.percentile(distance, TUNING.share) < TUNING.most * model.radius)


def _distinct(turns: Array) -> Array:
    """Return those of turns (T, 3, 3) that differ from no turn, and from those before."""
    chosen = [np.eye(3)]
    least = 1.0 + 2.0 * np.cos(TUNING.apart)
    for turn in turns:
        if all(np.trace(turn.T @ one) < least for one in chosen):
            chosen.append(turn)
    return np.array(chosen[1:]).reshape(-1, 3, 3)
