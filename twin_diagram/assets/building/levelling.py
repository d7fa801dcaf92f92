"""Predicted views made to agree: on their common support first, from far off, and then surface against surface.

A network's depth is off by a share that differs from view to view, which at half a metre moves a table by centimetres:
too far for `align`, which starts where surfaces nearly lie on one another. What the support tells of a view, its
tilt, its height and how large its depth is, is found here beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.assets.building.depth_view import DepthView, view_points
from twin_diagram.assets.building.selection import TUNING as CHOICE
from twin_diagram.assets.building.selection import looked_at
from twin_diagram.assets.building.support_plane import find_plane, fit_plane
from twin_diagram.assets.building.view_poses import TUNING as POSES
from twin_diagram.assets.building.view_poses import align, moved
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the levelling."""

    scales: tuple[float, ...] = (0.003, 0.005, 0.008, 0.012, 0.02, 0.03)
    """Standard deviations of views' scales of depth, as shares, of which the likeliest is taken."""

    reach: tuple[float, ...] = (0.04, 0.025, 0.015, 0.01, 0.008)
    """Distance from the common plane within which a view's own support is looked for, round by round [m]: 3 % of
    what is a metre away, at first."""

    near: float = 0.006
    """Distance of a point that speaks for a view's own plane [m]."""

    cosine: float = 0.94
    """Least cosine between the normals of a point and of the plane it speaks for."""

    height: float = 0.002
    """Standard deviation of the height that a view's support has in it, for depth that is bent [m], …"""

    tilt: float = 0.01
    """… and of its tilt [rad]."""

    stands_out: float = 0.006
    """Height above the support from which a point is a thing's [m]."""

    least: int = 100
    """Fewer points tell of no plane."""

    points: int = 3000
    """Points of a view that are used."""


TUNING = Tuning()


@dataclass(frozen=True)
class LevelViews:
    """Views that agree on their support.

    Attributes:
        views: which.
        plane: (4,) their support, n·p = d, n up.
        scale: standard deviation of their scales of depth, as a share, as it was found in them.
    """

    views: list[DepthView]
    plane: Array
    scale: float


def levelled(views: Sequence[DepthView], plane: Array, seed: int = 0) -> LevelViews:
    """Return views that agree on the height and tilt of their support.

    Args:
        views: as predicted, in about metres.
        plane: (4,) n·p = d, n up, as far as it is known.
        seed: of the choice of points.
    """
    now, rng, scale = list(views), np.random.default_rng(seed), max(TUNING.scales)
    above = np.mean([view.camera.p_WC for view in now], axis=0)
    twists = np.zeros((len(now), 7))
    for k, reach in enumerate(TUNING.reach):
        own = [_own_plane(view, plane, reach, rng) for view in now]
        there = [one for one in own if one is not None]
        if not there:
            break
        # The median of heights and of normals: one view that is far off moves neither.
        middle = np.median([foot for _, foot in there], axis=0)
        n = np.median([found[:3] for found, _ in there], axis=0)
        n /= np.linalg.norm(n)
        plane = np.append(n, np.median([foot @ n for _, foot in there]))
        if k == 0:
            scale = _spread_of_scales(now, own, plane)
        prior = np.array([POSES.prior_rotation] * 3 + [POSES.prior_translation] * 3 + [scale]) ** -2.0
        for k, one in enumerate(own):
            if one is not None:
                step = _step(now[k], one, plane, twists[k], prior, middle)
                now[k] = moved(now[k], step, middle)
                twists[k] += step
    near = np.concatenate([_support_points(view, plane, TUNING.near, rng) for view in now])
    return LevelViews(now, fit_plane(near, above) if len(near) >= TUNING.least else plane, scale)


def _spread_of_scales(views: Sequence[DepthView], own: Sequence[tuple[Array, Array] | None], plane: Array) -> float:
    """Return the likeliest standard deviation of scales of depth, as a share.

    A view's support lies off the common one by what its pose is off, and by its scale times the camera's height.
    """
    there = [(view, one[1]) for view, one in zip(views, own, strict=True) if one is not None]
    off = np.array([foot @ plane[:3] - plane[3] for _, foot in there])
    reach = np.array([(foot - view.camera.p_WC) @ plane[:3] for view, foot in there])
    variance = POSES.prior_translation**2 + (np.array(TUNING.scales)[:, None] * reach) ** 2
    unlikely = (np.log(variance) + off**2 / variance).sum(axis=1)
    return TUNING.scales[int(np.argmin(unlikely))]


def surfaces_agree(level: LevelViews, seed: int = 0) -> tuple[list[DepthView], Array]:
    """Return views, in metres, whose surfaces above the support lie on one another, and that plane (4,)."""
    views, plane = level.views, level.plane
    focus, distance = looked_at(views)
    points = np.concatenate([view_points(view, 2, None)[0] for view in views])
    above = points @ plane[:3] - plane[3] > TUNING.stands_out
    own = points[above & (np.linalg.norm(points - focus, axis=1) < CHOICE.reach * distance)]
    if len(own) < CHOICE.least_points:
        return list(views), plane
    low, high = np.quantile(own, [0.005, 0.995], axis=0)
    found = align(views, low, high, plane, seed, level.scale)
    return found.views, plane if found.plane is None else found.plane


def _support_points(view: DepthView, plane: Array, reach: float, rng: np.random.Generator) -> Array:
    """Return points (N, 3) of a view near a plane that face as it does."""
    points, normals, _ = view_points(view, 1, 0.15)
    on = (np.abs(points @ plane[:3] - plane[3]) < reach) & (normals @ plane[:3] > TUNING.cosine)
    which = rng.permutation(np.flatnonzero(on))[: TUNING.points]
    return points[which]


def _own_plane(view: DepthView, plane: Array, reach: float, rng: np.random.Generator) -> tuple[Array, Array] | None:
    """Return a view's own support (4,) near the common one, and the middle of what it shows of it (3,)."""
    points = _support_points(view, plane, reach, rng)
    if len(points) < TUNING.least:
        return None
    own = find_plane(points, np.broadcast_to(plane[:3], points.shape), view.camera.p_WC)
    if own is None:
        return None
    on = np.abs(points @ own[:3] - own[3]) < TUNING.near
    return fit_plane(points[on], view.camera.p_WC), points[on].mean(axis=0)


def _step(view: DepthView, own: tuple[Array, Array], plane: Array, twist: Array, prior: Array, middle: Array) -> Array:
    """Return the likeliest step (7,) that lays a view's own plane on the common one.

    Its height there and its tilt are three numbers, by which seven are led; what they leave open, the prior decides.
    """
    found, foot = own
    x = np.cross(plane[:3], [1.0, 0, 0] if abs(plane[0]) < 0.9 else [0, 1.0, 0])
    x /= np.linalg.norm(x)
    y = np.cross(plane[:3], x)
    e = np.array([foot @ plane[:3] - plane[3], found[:3] @ x, found[:3] @ y])
    J = np.zeros((3, 7))
    J[0] = np.concatenate([np.cross(foot - middle, plane[:3]), plane[:3], [(foot - view.camera.p_WC) @ plane[:3]]])
    J[1, :3], J[2, :3] = np.cross(found[:3], x), np.cross(found[:3], y)
    weight = np.array([TUNING.height, TUNING.tilt, TUNING.tilt]) ** -2.0
    H = (J.T * weight) @ J + np.diag(prior)
    return np.asarray(-np.linalg.solve(H, J.T @ (weight * e) + prior * twist))
