"""Bodies of convex solids, and many of them in a few tables, as compiled loops take them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from twin_diagram.planning.collision.convex_solids import Ball, Box, Drum, Polytope, Solid, bounding_box
from twin_diagram.planning.collision.forecast_growth import surface_rows
from twin_diagram.signals.arrays import Array

if TYPE_CHECKING:
    from twin_diagram.planning.collision.near_kernels import Solids


@dataclass(frozen=True)
class Body:
    """Something to keep clear of: convex solids in its frame O, a ball about them all, and `surface_rows` of them.

    What is `round_about_z` is left as it is by turns about O's z axis, whatever its solids look like: they move no
    surface of it.
    """

    name: str
    solids: tuple[Solid, ...]
    centre_O: Array
    radius: float
    surface_O: Array
    round_about_z: bool = False

    @staticmethod
    def of(name: str, solids: Sequence[Solid], round_about_z: bool = False) -> Body:
        """Return a body made of solids."""
        balls = [solid.ball for solid in solids]
        centre = np.mean([c for c, _ in balls], axis=0)
        radius = max(float(np.linalg.norm(c - centre)) + r for c, r in balls)
        rows = surface_rows(solids)
        rows[:, 2] *= not round_about_z
        return Body(name, tuple(solids), centre, radius, rows, round_about_z)


def solids_of(bodies: Sequence[Body]) -> Solids:
    """Return the tables of several bodies' solids, numbered body by body."""
    from twin_diagram.planning.collision.near_kernels import Solids, starts  # compiled; not with every import

    solids = [solid for body in bodies for solid in body.solids]
    boxes = [solid.box for solid in solids]
    at = starts([len(body.solids) for body in bodies])
    whole = [bounding_box(np.vstack([box.vertices for box in boxes[i:j]])) for i, j in pairwise(at.tolist())]
    polytopes = [solid.faces for solid in solids if isinstance(solid, Polytope)]
    faces = [
        [sides[np.isfinite(sides[:, 3])] for sides in _with(one.side_normals, one.side_offsets)] for one in polytopes
    ]
    flat = [sides for one in faces for sides in one]
    edges = [np.hstack([f.starts, f.spans, 1.0 / (f.spans**2).sum(axis=1, keepdims=True)]) for f in polytopes]
    is_polytope = np.array([isinstance(solid, Polytope) for solid in solids], dtype=bool)
    return Solids(
        centre=np.array([body.centre_O for body in bodies], dtype=float).reshape(-1, 3),
        radius=np.array([body.radius for body in bodies], dtype=float),
        body_middle=np.array([box.p_GB for box in whole], dtype=float).reshape(-1, 3),
        body_half=np.array([box.half for box in whole], dtype=float).reshape(-1, 3),
        first=at,
        kind=np.array([_KINDS.index(type(solid)) for solid in solids], dtype=np.int64),
        middle=np.array([box.p_GB for box in boxes], dtype=float).reshape(-1, 3),
        half=np.array([box.half for box in boxes], dtype=float).reshape(-1, 3),
        R=np.array([box.R_GB for box in boxes], dtype=float).reshape(-1, 3, 3),
        axis=np.array([s.axis if isinstance(s, Drum) else np.zeros(3) for s in solids], dtype=float).reshape(-1, 3),
        polytope=(np.cumsum(is_polytope) - 1).astype(np.int64),
        first_face=starts([len(one.normals) for one in polytopes]),
        first_edge=starts([len(one.starts) for one in polytopes]),
        planes=np.concatenate([np.zeros((0, 4)), *(_with(one.normals, one.offsets) for one in polytopes)]),
        first_side=starts([len(sides) for sides in flat]),
        sides=np.concatenate([np.zeros((0, 4)), *flat]),
        edges=np.concatenate([np.zeros((0, 7)), *edges]),
    )


def _with(normals: Array, offsets: Array) -> Array:
    """Return normals (…, 3) and offsets (…) of planes as one, (…, 4)."""
    return np.concatenate([normals, offsets[..., None]], axis=-1)


_KINDS: Final = (Box, Ball, Drum, Polytope)
"""Kinds of solids, by the numbers that stand for them in `near_kernels.Solids`."""
