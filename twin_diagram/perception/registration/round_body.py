"""Finds the body turned about an axis on which most of a surface lies, and what of the surface lies beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with what set them."""

    fewest: int = 30
    """Fewer points show no shape."""

    end: float = 0.7
    """Cosine between normal and axis above which a point is of a body's ends, of which any turn is round."""

    sides: float = 0.3
    """Less than this share of sides tells of no axis: a box's lid is as flat as a can's."""

    askew: float = 0.15
    """Normals of a round side pass the axis within this share of its radius: those of built clouds err by some 5°,
    those of a square box's sides pass it by up to all of it."""

    round: float = 0.6
    """Share of the sides in view that do, of a body that is round but for what it carries: a handle in full view takes
    a fifth, of a square box 0.15 do."""

    goes_round: float = 0.6
    """What a round body shows at one radius and height it shows over such an angle [rad], a handle over 0.3."""

    points: int = 1000
    """Points of an object that show whether it is round itself, …"""

    share: float = 98.0
    """… of which so many of a hundred then lie on a round body: a mug's handle is 3 % of it and more."""

    rounds: int = 6
    """Fits of an axis, each to what the one before left near it: three suffice beside a handle in full view."""


TUNING = Tuning()


def is_round(points: Array, normals: Array) -> bool:
    """Return whether all of a surface, points (N, 3) and normals (N, 3) in O, is round about an axis of O."""
    thin = slice(None, None, max(1, len(points) // TUNING.points))
    off = off_round_body(points[thin], normals[thin])
    return off is not None and float(np.percentile(off, TUNING.share)) == 0.0


def off_round_body(points: Array, normals: Array) -> Array | None:
    """Return how far points (N, 3) lie beside the round body that most of them are on [m]; None: they are on none.

    Args:
        points: in O, about one of whose axes the body is round [m].
        normals: (N, 3).
    """
    if len(points) < TUNING.fewest:
        return None
    nearest, _ = cKDTree(points).query(points, k=2, workers=1)
    spacing = 2.0 * float(np.median(nearest[:, 1]))
    best: Array | None = None
    for along in np.eye(3):
        side = np.abs(normals @ along) < TUNING.end
        if np.count_nonzero(side) < TUNING.sides * len(points):
            continue
        across = np.eye(3)[along == 0.0]
        p, n = points @ across.T, normals @ across.T
        # A normal passes the axis at c by (p - c) × n.
        level = n / np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-9)
        rows, passes = np.stack([level[:, 1], -level[:, 0]], axis=1), p[:, 0] * level[:, 1] - p[:, 1] * level[:, 0]
        near, centre = side, p.mean(axis=0)
        for _ in range(TUNING.rounds):
            # Where the sides tell only one way, as a flat one does, the axis stays by the middle.
            centre = centre + np.linalg.lstsq(rows[near], passes[near] - rows[near] @ centre, rcond=0.1)[0]
            radius = np.linalg.norm(p - centre, axis=1)
            near = side & (np.abs(passes - rows @ centre) < TUNING.askew * radius)
        if np.count_nonzero(near) >= TUNING.round * np.count_nonzero(side):
            off = _off_profile(np.stack([radius, points @ along], axis=1), np.arctan2(*(p - centre).T), spacing)
            best = off if best is None else np.minimum(best, off)
    return best


def _off_profile(profile: Array, azimuth: Array, spacing: float) -> Array:
    """Return how far points (N, 2), radius and height, are beside those that go round the axis in view [m].

    Args:
        profile: (N, 2) [m].
        azimuth: (N,) about the axis [rad].
        spacing: of the points [m].
    """
    alike = cdist(profile, profile) < spacing
    apart = np.abs(azimuth[:, None] - azimuth)
    apart = np.minimum(apart, 2.0 * np.pi - apart)
    body = np.max(apart, axis=1, where=alike, initial=0.0) > TUNING.goes_round
    if not body.any():
        return np.full(len(profile), np.inf)
    # What lies between points is left out.
    return np.asarray(np.maximum(cKDTree(profile[body]).query(profile, workers=1)[0] - spacing, 0.0))
