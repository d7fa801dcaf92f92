"""Views of one thing that contradict each other: which may be left out, and when they are refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.assets.building.colouring import nearest_pixels
from twin_diagram.assets.building.depth_view import DepthView, view_points
from twin_diagram.assets.building.looking_past import TUNING as PAST
from twin_diagram.assets.building.looking_past import looking_past
from twin_diagram.assets.building.selection import grown
from twin_diagram.errors import FramesError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """What counts as a contradiction."""

    beside_mask: int = 2
    """Distance from a mask at which the object is surely not [pixel]; refined poses are off by less."""

    nothing_behind: float = 100.0
    """Depth that is taken where a mask says that the object is not and the camera sees nothing [m]."""

    left_out: float = 0.25
    """Share of the views of a held object that may be left out because they contradict the others: it slips."""

    denied: float = 0.2
    """Share of a view's points that the others look through from which it contradicts them: honest ones have 0.05 at
    most, two of six views that were told each other's poses 0.22 and 0.34."""

    through: float = 0.1
    """How far behind a point a view must see to look through it, as a share of the object's size, …"""

    least_through: float = 0.005
    """… no less than this [m], which is more than refined poses are off, …"""

    most_through: float = 0.012
    """… and no more [m], …"""

    through_noise: float = 6.0
    """… but for noise: no less than so many of its standard deviations."""

    asked: int = 400
    """Points of each view that are asked about."""


TUNING = Tuning()


def denied(views: Sequence[DepthView], low: Array, high: Array, through: float, seed: int = 0) -> Array:
    """Return the share (n,) of each view's points in a box that more of the other views look through than see.

    Those look through a point that see something more than `through` [m] behind it.
    """
    rng = np.random.default_rng(seed)
    shares = np.zeros(len(views))
    for k, view in enumerate(views):
        points, _, _ = view_points(view, 1)
        points = points[((points > low) & (points < high)).all(axis=1)]
        points = points[rng.permutation(len(points))[: TUNING.asked]]
        balance = np.zeros(len(points))
        for other in (*views[:k], *views[k + 1 :]):
            u, v, z = other.camera.project(points)
            row, column, there = nearest_pixels(u, v, other.depth.shape)
            behind = np.where(there & (other.depth[row, column] > 0), other.depth[row, column] - z, np.nan)
            clear = (behind > through) & ~other.near_edge[row, column]
            balance += clear.astype(float) - (np.abs(behind) < through)
        shares[k] = (balance > 0).mean() if len(points) else 0.0
    return shares


def kept_to_mask(view: DepthView, growth: int) -> DepthView:
    """Return the view with surfaces outside its mask, grown by so many pixels, no longer trusted: they are others'.

    Where there is no depth, either, as where nothing stands behind the object, its rays are looked through, as those
    beside an edge are.
    """
    if view.mask is None or view.colour is not view.camera:
        return view
    inside = grown(view.mask, growth)
    nothing = ~grown(view.mask, TUNING.beside_mask) & (view.depth <= 0)
    depth = np.where(nothing, np.float32(TUNING.nothing_behind), view.depth)
    return replace(view.trusted_at(inside), depth=depth, near_edge=view.near_edge | nothing)


def agreeing(views: Sequence[DepthView], low: Array, high: Array, noise: float) -> list[int]:
    """Return the numbers of views without those that contradict the others; all, where too many do to tell which.

    Args:
        views: of one thing, before they are kept to their masks.
        low: (3,) lowest corner of the box about it [m].
        high: (3,) its highest.
        noise: standard deviation of depth [m].
    """
    masked = [kept_to_mask(view, 0) for view in views]
    kept = list(range(len(views)))
    for _ in range(int(TUNING.left_out * len(views))):
        shares = denied([masked[k] for k in kept], low, high, _through(low, high, noise))
        worst = int(np.argmax(shares))
        if shares[worst] <= TUNING.denied:
            return kept
        del kept[worst]
    shares = denied([masked[k] for k in kept], low, high, _through(low, high, noise))
    return kept if shares.max() <= TUNING.denied else list(range(len(views)))


def _through(low: Array, high: Array, noise: float) -> float:
    """Return how far behind a surface others must see for it to be denied [m]."""
    size = float((high - low).max())
    through = float(np.clip(TUNING.through * size, TUNING.least_through, TUNING.most_through))
    return max(through, TUNING.through_noise * noise)


def check_agreement(views: Sequence[DepthView], low: Array, high: Array, noise: float, where: str) -> None:
    """Refuse views one of which contradicts the others; `where` begins the message."""
    through = _through(low, high, noise)
    for shares, most, why in (
        (looking_past(views, low, high, through), PAST.past, "it looks through {:.0f} % of what they show"),
        (denied(views, low, high, through), TUNING.denied, "they look through {:.0f} % of what it shows"),
    ):
        worst = int(np.argmax(shares))
        if shares[worst] > most:
            raise FramesError(f"{where}: view {worst} contradicts the others: {why.format(100 * shares[worst])}")
