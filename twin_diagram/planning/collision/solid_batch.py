"""Many bodies of convex solids in a few tables, so that each of many points can be held against a solid of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.planning.collision import solid_distances
from twin_diagram.planning.collision.convex_solids import Ball, Box, Drum, Polytope, Solid, bounding_box
from twin_diagram.planning.collision.forecast_growth import surface_rows
from twin_diagram.planning.collision.solid_distances import Faces
from twin_diagram.signals.arrays import Array, Ints


@dataclass(frozen=True)
class Body:
    """Something to keep clear of: convex solids in its frame O, a ball about them all, and `surface_rows` of them."""

    name: str
    solids: tuple[Solid, ...]
    centre_O: Array
    radius: float
    surface_O: Array

    @staticmethod
    def of(name: str, solids: Sequence[Solid]) -> Body:
        """Return a body made of solids."""
        balls = [solid.ball for solid in solids]
        centre = np.mean([c for c, _ in balls], axis=0)
        radius = max(float(np.linalg.norm(c - centre)) + r for c, r in balls)
        return Body(name, tuple(solids), centre, radius, surface_rows(solids))


class SolidBatch:
    """The solids of B bodies, numbered body by body; S in all. Holds constants alone.

    Args:
        bodies: in order.

    Attributes:
        bodies: these.
        centres, radii: (B, 3) and (B,) of a ball about each body, in its frame [m].
        first, count: (B,) the number of each body's first solid, and how many it has.
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        self.bodies = tuple(bodies)
        self.centres = np.array([body.centre_O for body in bodies]).reshape(-1, 3)
        self.radii = np.array([body.radius for body in bodies], dtype=float)
        self.count = np.array([len(body.solids) for body in bodies], dtype=int)
        self.first = np.cumsum(self.count) - self.count
        solids = [solid for body in bodies for solid in body.solids]
        boxes = [solid.box for solid in solids]
        self._half = np.array([box.half for box in boxes]).reshape(-1, 3)
        self._middle = np.array([box.p_GB for box in boxes]).reshape(-1, 3)
        self._R = np.array([box.R_GB for box in boxes]).reshape(-1, 3, 3)
        self._turned = ~np.isclose(self._R, np.eye(3), atol=1e-12).all(axis=(1, 2))
        whole = [bounding_box(np.vstack([box.vertices for box in boxes[i : i + n]])) for i, n in self._ranges()]
        self._body_half = np.array([box.half for box in whole]).reshape(-1, 3)
        self._body_middle = np.array([box.p_GB for box in whole]).reshape(-1, 3)
        # Of each kind: which solids are of it, and which of the kind a solid is.
        self._kind = np.array([_KINDS.index(type(solid)) for solid in solids], dtype=int)
        self._within = np.zeros(len(solids), dtype=int)
        for kind in range(len(_KINDS)):
            self._within[self._kind == kind] = np.arange((self._kind == kind).sum())
        self._faces = Faces.stacked([solid.faces for solid in solids if isinstance(solid, Polytope)])
        drums = [solid for solid in solids if isinstance(solid, Drum)]
        self._drum_axis = np.array([drum.axis for drum in drums]).reshape(-1, 3)

    def _ranges(self) -> list[tuple[int, int]]:
        return list(zip(self.first.tolist(), self.count.tolist(), strict=True))

    def bodies_at_least(self, body: Ints, p_O: Array) -> Array:
        """Return (M,) what the distances of points (M, 3) to bodies (M,) are never below: those to a box about each."""
        return solid_distances.box_distance(p_O - self._body_middle[body], self._body_half[body])

    def at_least(self, solid: Ints, p_O: Array) -> Array:
        """Return (M,) what the distances of points (M, 3) to solids (M,) are never below: those to a box about each."""
        p_B = p_O - self._middle[solid]
        turned = np.flatnonzero(self._turned[solid])
        if len(turned):
            p_B[turned] = np.einsum("mi,mij->mj", p_B[turned], self._R[solid[turned]])
        return solid_distances.box_distance(p_B, self._half[solid])

    def distance(self, solid: Ints, p_O: Array) -> tuple[Array, Array]:
        """Return signed distances (M,) [m] of points (M, 3) to solids (M,), and outward unit gradients (M, 3), in O."""
        kinds = self._kind[solid]
        present = np.unique(kinds)
        if len(present) == 1:
            return self._of_kind(int(present[0]), solid, p_O)
        distance, slope = np.empty(len(solid)), np.empty((len(solid), 3))
        for kind in present:
            rows = np.flatnonzero(kinds == kind)
            distance[rows], slope[rows] = self._of_kind(int(kind), solid[rows], p_O[rows])
        return distance, slope

    def _of_kind(self, kind: int, solid: Ints, p_O: Array) -> tuple[Array, Array]:
        half = self._half[solid]
        if _KINDS[kind] is Polytope:
            return solid_distances.to_polytope(p_O, self._within[solid], self._faces)
        offset = p_O - self._middle[solid]
        if _KINDS[kind] is Ball:
            return solid_distances.to_ball(offset, half[:, 0])
        if _KINDS[kind] is Drum:
            return solid_distances.to_drum(offset, self._drum_axis[self._within[solid]], half[:, 0], half[:, 2])
        R = self._R[solid]
        distance, slope = solid_distances.to_box(np.einsum("mi,mij->mj", offset, R), half)
        return distance, np.einsum("mij,mj->mi", R, slope)


_KINDS = (Box, Ball, Drum, Polytope)
