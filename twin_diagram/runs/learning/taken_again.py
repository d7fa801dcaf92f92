"""Whether what was lost from the hand is what was taken later: shapes tell, however it lay by then."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import permutations, product
from zipfile import BadZipFile

import numpy as np
from scipy.spatial import cKDTree

from twin_diagram.assets.building.backends import ColouredSurface
from twin_diagram.errors import TwinError
from twin_diagram.runs.learning.following import register
from twin_diagram.runs.learning.record import Learned, LearningRecord
from twin_diagram.runs.learning.shape_worker import read_shape
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    apart: float = 0.002
    """Typical distance between points on a surface [m]: one in a thousand places has none within `reach`."""

    few: tuple[int, int] = (300, 1500)
    """Of the other one's, drawn apart, with which each of 24 ways round is tried, and the best one told."""

    loose: tuple[float, float] = (0.02, 0.3)
    """By how much principal axes and middles of one thing's two surfaces may differ [m], [rad]: sides that were not
    seen are guessed."""

    reach: tuple[float, float] = (0.02, 0.003)
    """Distance within which points lie on the other surface [m]: as ways round are tried, and in the end."""

    same: float = 0.9
    """Share of each surface that lies on the other one, from which they are one thing's: of 16 shapes that were
    learned those of one kind lie on each other by 0.98 and more, those of two by 0.42 at the most."""


TUNING = Tuning()


def note_taken_again(record: LearningRecord, learned: Sequence[Learned], one: Learned) -> None:
    """Note of what was lost before an object was put away, and is of its shape, that it was taken again.

    Its asset goes with the next state that is kept; its data stay.

    Args:
        record: of the run.
        learned: all objects so far, in order.
        one: that has its asset now.
    """
    if one.state != "finished" or not one.standing:
        return
    for other in learned[: learned.index(one)] if one in learned else ():
        if other.state == "finished" and not other.standing:
            with suppress(TwinError, OSError, ValueError, KeyError, BadZipFile):  # what cannot be compared stays
                if same_shape(*(read_shape(record.of(each.name)) for each in (other, one))):
                    other.state, other.taken_again = "failed", one.name
                    record.event(object=other.name, stage="taken again", outcome=one.name)


def same_shape(first: ColouredSurface, second: ColouredSurface) -> bool:
    """Return whether two surfaces are one thing's, seen from other sides."""
    (a, a_normals), (b, b_normals) = sampled(first.corners, 0), sampled(second.corners, 1)
    tried, told = (slice(None, count) for count in TUNING.few)
    best, best_share, tree = np.eye(4), 0.0, cKDTree(a)
    for start in ways_round(a, b):
        share, X = 0.0, start
        for reach in TUNING.reach:
            X, share = register(a, a_normals, b[tried], b_normals[tried], X, TUNING.loose, reach, tree)
        best, best_share = (X, share) if share > best_share else (best, best_share)
    X, onto = register(a, a_normals, b[told], b_normals[told], best, TUNING.loose, TUNING.reach[1], tree)
    X = np.asarray(np.linalg.inv(X), dtype=float)
    _, back = register(b, b_normals, a[told], a_normals[told], X, TUNING.loose, TUNING.reach[1])
    return min(onto, back) >= TUNING.same


def sampled(corners: Array, seed: int) -> tuple[Array, Array]:
    """Return points and outward normals (N, 3), drawn evenly over triangles (F, 3, 3)."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(across, axis=1)
    if not twice.sum() > 0.0:
        raise TwinError("a surface without area")
    rng = np.random.default_rng(seed)
    count = int(np.ceil(0.5 * twice.sum() / TUNING.apart**2))
    which = rng.choice(len(corners), count, p=twice / twice.sum())
    u, v = rng.uniform(size=(2, count, 1))
    u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
    triangle = corners[which]
    points = triangle[:, 0] + u * (triangle[:, 1] - triangle[:, 0]) + v * (triangle[:, 2] - triangle[:, 0])
    return points, across[which] / twice[which, None]


def ways_round(a: Array, b: Array) -> list[Array]:
    """Return the 24 poses (4, 4) of points b in which their middle and principal axes are those of a, (N, 3) each."""
    axes_a, axes_b = (np.linalg.eigh(np.cov(points.T))[1] for points in (a, b))
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            R = axes_a[:, order] * signs @ axes_b.T
            if np.linalg.det(R) > 0.0:
                X = np.eye(4)
                X[:3, :3], X[:3, 3] = R, a.mean(axis=0) - R @ b.mean(axis=0)
                found.append(X)
    return found
