"""How far the arm is from everything and from itself, with gradients, for many configurations at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.planning.collision.ball_cover import Balls
from twin_diagram.planning.collision.chain import Chain, Ints, Placement, point_jacobian
from twin_diagram.planning.collision.convex_solids import Solid
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """What stands for no distance, chosen by hand: far above any reach."""

    far: float = 1.0e3
    """Stands for a distance beyond reach [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class Body:
    """Something to keep clear of: convex solids in its frame O, and a ball about them all."""

    name: str
    solids: tuple[Solid, ...]
    centre_O: Array
    radius: float

    @staticmethod
    def of(name: str, solids: Sequence[Solid]) -> Body:
        """Return a body made of solids."""
        balls = [solid.ball for solid in solids]
        centre = np.mean([c for c, _ in balls], axis=0)
        return Body(name, tuple(solids), centre, max(float(np.linalg.norm(c - centre)) + r for c, r in balls))


@dataclass(frozen=True)
class Surroundings:
    """Where B bodies are while the arm takes N configurations.

    Attributes:
        X_WO: (B, N, 4, 4) poses.
        grown: (B, N) by how much each is taken to be larger than it is [m].
        present: (B,) bool: those that are not are nowhere.
        still: (B,) bool: the pose is the same in all configurations.
        beside: bodies that come after those that a `Clearance` was made with: they are among the B.
    """

    X_WO: Array
    grown: Array
    present: npt.NDArray[np.bool_]
    still: npt.NDArray[np.bool_]
    beside: tuple[Body, ...] = ()

    def take(self, rows: Ints) -> Surroundings:
        """Return the same for configurations `rows` of these, in any number and order."""
        return Surroundings(self.X_WO[:, rows], self.grown[:, rows], self.present, self.still, self.beside)


@dataclass(frozen=True)
class Contacts:
    """Where the arm is near something: one entry per configuration, part of the arm and body; M entries.

    Attributes:
        row: (M,) the configuration.
        body: (M,) index of the body; the number of bodies where the arm is near to itself.
        distance: (M,) signed [m].
        gradient: (M, n) its derivative by the joints [m/rad].
    """

    row: Ints
    body: Ints
    distance: Array
    gradient: Array


class Clearance:
    """Distances between an arm and bodies. Holds constants alone; calls may be made in any order.

    Args:
        chain: the arm's kinematics.
        balls: the arm's shape.
        bodies: everything else.
        ignored: (n + 1, B) bool: links (by their joint's number, from 1) that do not count against a body.
    """

    def __init__(
        self, chain: Chain, balls: Balls, bodies: Sequence[Body], ignored: npt.NDArray[np.bool_] | None = None
    ) -> None:
        order = np.argsort(balls.links, kind="stable")
        back = np.empty_like(order)
        back[order] = np.arange(len(order))
        self.chain = chain
        self.bodies = tuple(bodies)
        self._balls = balls
        self._centres_L, self._radii = balls.centres_L[order], balls.radii[order]
        self._links, self._groups = balls.links[order], balls.groups[order]
        self._slices = [(k, slice(*np.searchsorted(self._links, [k, k + 1]))) for k in range(1, chain.size + 1)]
        self._group_count = int(self._groups.max()) + 1
        if ignored is None:
            ignored = np.zeros((chain.size + 1, len(bodies)), dtype=bool)
        self._ignored = ignored
        self._all = np.arange(len(self._radii))
        self._counted = [np.flatnonzero(~ignored[self._links, b]) for b in range(len(bodies))]
        self._prepare_self(back[balls.pairs])

    def _prepare_self(self, pairs: Ints) -> None:
        """Sort the pairs of balls by the pairs of groups they belong to, with a ball about each group."""
        self._group_link = np.zeros(self._group_count, dtype=int)
        self._group_centre, self._group_radius = np.zeros((self._group_count, 3)), np.zeros(self._group_count)
        for group in np.unique(self._groups):
            members = self._groups == group
            self._group_link[group] = self._links[members][0]
            centre = self._centres_L[members].mean(axis=0)
            self._group_centre[group] = centre
            reach = np.linalg.norm(self._centres_L[members] - centre, axis=1) + self._radii[members]
            self._group_radius[group] = reach.max()
        key = self._groups[pairs[:, 0]] * self._group_count + self._groups[pairs[:, 1]]
        order = np.argsort(key, kind="stable")
        self._pairs = pairs[order]
        keys, self._pair_start, self._pair_count = np.unique(key[order], return_index=True, return_counts=True)
        self._group_pairs = np.stack([keys // self._group_count, keys % self._group_count], axis=1)

    def drop_group_pairs(self, drop: npt.NDArray[np.bool_]) -> None:
        """Forget pairs of parts of the arm, a bool for each of `group_pairs`."""
        self._group_pairs = self._group_pairs[~drop]
        self._pair_start, self._pair_count = self._pair_start[~drop], self._pair_count[~drop]

    def among(self, bodies: Sequence[Body]) -> Clearance:
        """Return the same for an arm among other bodies, of which the first are those that it has."""
        more = len(bodies) - len(self.bodies)
        ignored = np.hstack([self._ignored, np.zeros((len(self._ignored), more), dtype=bool)])
        result = Clearance(self.chain, self._balls, bodies, ignored)
        kept = {tuple(pair) for pair in self._group_pairs.tolist()}
        result.drop_group_pairs(np.array([tuple(pair) not in kept for pair in result.group_pairs.tolist()], dtype=bool))
        return result

    def carrying(self, more: Balls, last: int, unseen_by: Sequence[int] = ()) -> Clearance:
        """Return the same for an arm that carries something, which is kept clear of the arm's own links, too.

        Args:
            more: what is carried; its groups and pairs do not count.
            last: it is kept clear of the arm's links up to this one.
            unseen_by: bodies that it may touch.
        """
        own, count = self._balls, len(self._balls.radii)
        group = self._group_count
        carried = np.arange(count, count + len(more.radii))
        pairs = [(i, j) for i in np.flatnonzero(own.links <= last) for j in carried]
        joined = Balls(
            np.concatenate([own.centres_L, more.centres_L]),
            np.concatenate([own.radii, more.radii]),
            np.concatenate([own.links, more.links]),
            np.concatenate([own.groups, np.full(len(more.radii), group)]),
            np.concatenate([own.pairs, np.array(pairs, dtype=int).reshape(-1, 2)]),
        )
        result = Clearance(self.chain, joined, self.bodies, self._ignored)
        kept = {tuple(pair) for pair in self._group_pairs.tolist()}
        drop = [group not in pair and tuple(pair) not in kept for pair in result.group_pairs.tolist()]
        result.drop_group_pairs(np.array(drop, dtype=bool))
        for b in unseen_by:
            counted = result._counted[b]
            result._counted[b] = counted[result._groups[counted] != group]
        return result

    @property
    def group_pairs(self) -> Ints:
        """(G, 2) pairs of the arm's parts that are kept apart."""
        return self._group_pairs

    def centres(self, placement: Placement) -> Array:
        """Return (N, S, 3) the balls' centres in W."""
        result = np.empty((len(placement.X_WL), len(self._radii), 3))
        for k, part in self._slices:
            X_WL = placement.X_WL[:, k]
            result[:, part] = self._centres_L[part] @ X_WL[:, :3, :3].transpose(0, 2, 1) + X_WL[:, None, :3, 3]
        return result

    def distances(self, q: Array, around: Surroundings, reach: float, own: bool = True) -> Array:
        """Return the smallest signed distance to each body, and to itself.

        Args:
            q: (N, n) configurations.
            around: the bodies then.
            reach: distances above this are not told apart: they come out as `Tuning.far` or as they are [m].
            own: also the arm's distance to itself.

        Returns:
            (N, B + 1) [m]
        """
        placement = self.chain.place(q)
        centres = self.centres(placement)
        count = len(self.bodies) + len(around.beside)
        result = np.full((len(q), count + 1), TUNING.far)
        for b in range(count):
            row, _, distance, _ = self._near(centres, around, b, reach)
            np.minimum.at(result[:, b], row, distance)
        if own:
            row, _, _, distance, _ = self._near_self(placement, centres, reach)
            np.minimum.at(result[:, -1], row, distance)
        return result

    def link_distances(self, q: Array, around: Surroundings) -> Array:
        """Return the smallest distance of each link (from joint 1's on) to each body, however far: (N, n, B) [m]."""
        centres = self.centres(self.chain.place(q))
        result = np.full((len(q), self.chain.size, len(self.bodies)), TUNING.far)
        for b in range(len(self.bodies)):
            row, ball, distance, _ = self._near(centres, around, b, TUNING.far)
            np.minimum.at(result[:, :, b], (row, self._links[ball] - 1), distance)
        return result

    def own_distances(self, q: Array, reach: float) -> Array:
        """Return the smallest distance between the two parts of each of `group_pairs`, (N, G) [m].

        `Tuning.far` beyond reach.
        """
        placement = self.chain.place(q)
        row, first, second, distance, _ = self._near_self(placement, self.centres(placement), reach)
        column = np.full((self._group_count, self._group_count), -1)
        column[self._group_pairs[:, 0], self._group_pairs[:, 1]] = np.arange(len(self._group_pairs))
        result = np.full((len(q), len(self._group_pairs)), TUNING.far)
        np.minimum.at(result, (row, column[self._groups[first], self._groups[second]]), distance)
        return result

    def contacts(self, q: Array, around: Surroundings, reach: float, own_reach: float) -> Contacts:
        """Return everything within reach, with gradients.

        Arguments as in `distances`, `own_reach` for the arm to itself.
        """
        placement = self.chain.place(q)
        centres = self.centres(placement)
        rows, bodies, distances, gradients = [], [], [], []
        count = len(self.bodies) + len(around.beside)
        for b in range(count):
            row, ball, distance, normal = self._near(centres, around, b, reach)
            best = _smallest(row * self._group_count + self._groups[ball], distance)
            row, ball, distance, normal = row[best], ball[best], distance[best], normal[best]
            velocity = point_jacobian(placement, centres[row, ball], self._links[ball], row, self.chain.prismatic)
            rows.append(row)
            bodies.append(np.full(len(row), b))
            distances.append(distance)
            gradients.append(np.einsum("mnk,mk->mn", velocity, normal))
        row, first, second, distance, normal = self._near_self(placement, centres, own_reach)
        key = (row * self._group_count + self._groups[first]) * self._group_count + self._groups[second]
        best = _smallest(key, distance)
        row, first, second, distance, normal = row[best], first[best], second[best], distance[best], normal[best]
        velocity = point_jacobian(placement, centres[row, first], self._links[first], row, self.chain.prismatic)
        velocity -= point_jacobian(placement, centres[row, second], self._links[second], row, self.chain.prismatic)
        rows.append(row)
        bodies.append(np.full(len(row), count))
        distances.append(distance)
        gradients.append(np.einsum("mnk,mk->mn", velocity, normal))
        return Contacts(
            np.concatenate(rows), np.concatenate(bodies), np.concatenate(distances), np.concatenate(gradients)
        )

    def _near(self, centres: Array, around: Surroundings, b: int, reach: float) -> tuple[Ints, Ints, Array, Array]:
        """Return balls within reach of a body: row, ball, distance, normal in W away from the body."""
        none = np.zeros(0, dtype=int)
        if not around.present[b]:
            return none, none, np.zeros(0), np.zeros((0, 3))
        own = len(self.bodies)
        body, counted = (self.bodies[b], self._counted[b]) if b < own else (around.beside[b - own], self._all)
        R_WO, p_WO = around.X_WO[b, :, :3, :3], around.X_WO[b, :, :3, 3]
        offset = centres[:, counted] - (p_WO + R_WO @ body.centre_O)[:, None]
        limit = reach + body.radius + self._radii[counted] + around.grown[b][:, None]
        row, ball = np.nonzero((offset * offset).sum(axis=2) < limit * limit)
        if not len(row):
            return none, none, np.zeros(0), np.zeros((0, 3))
        ball = counted[ball]
        grown = self._radii[ball] + around.grown[b, row]
        p_W = centres[row, ball]
        if around.still[b]:
            p_O = (p_W - p_WO[0]) @ R_WO[0]
        else:
            p_O = ((p_W - p_WO[row])[:, None, :] @ R_WO[row])[:, 0]
        distance = np.full(len(row), TUNING.far)
        normal_O = np.zeros((len(row), 3))
        for solid in body.solids:
            near = np.flatnonzero(solid.lower_bound(p_O) < np.minimum(distance, reach + grown))
            if not len(near):
                continue
            d, n = solid.distance(p_O[near])
            better = d < distance[near]
            distance[near[better]], normal_O[near[better]] = d[better], n[better]
        distance = distance - grown
        near = np.flatnonzero(distance < reach)
        if around.still[b]:
            normal = normal_O[near] @ R_WO[0].T
        else:
            normal = (R_WO[row[near]] @ normal_O[near][:, :, None])[..., 0]
        return row[near], ball[near], distance[near], normal

    def _near_self(self, placement: Placement, centres: Array, reach: float) -> tuple[Ints, Ints, Ints, Array, Array]:
        """Return pairs of balls within reach of each other.

        Row, first, second, distance, normal from second to first.
        """
        X_WL = placement.X_WL[:, self._group_link]
        middles = (X_WL[..., :3, :3] @ self._group_centre[:, :, None])[..., 0] + X_WL[..., :3, 3]
        i, j = self._group_pairs[:, 0], self._group_pairs[:, 1]
        offset = middles[:, i] - middles[:, j]
        limit = reach + self._group_radius[i] + self._group_radius[j]
        row, pair = np.nonzero(np.einsum("nsi,nsi->ns", offset, offset) < limit**2)
        count = self._pair_count[pair]
        ends = np.cumsum(count)
        within = np.arange(ends[-1] if len(ends) else 0) - np.repeat(ends - count, count)
        chosen = np.repeat(self._pair_start[pair], count) + within
        row = np.repeat(row, count)
        first, second = self._pairs[chosen, 0], self._pairs[chosen, 1]
        offset = centres[row, first] - centres[row, second]
        norm = np.sqrt(np.einsum("mi,mi->m", offset, offset))
        distance = norm - self._radii[first] - self._radii[second]
        near = np.flatnonzero(distance < reach)
        normal = offset[near] / np.maximum(norm[near], 1e-9)[:, None]
        return row[near], first[near], second[near], distance[near], normal


def _smallest(key: Ints, value: Array) -> Ints:
    """For each distinct key the index of its smallest value, ordered by key."""
    order = np.lexsort((value, key))
    ordered = key[order]
    first = np.ones(len(ordered), dtype=bool)
    first[1:] = ordered[1:] != ordered[:-1]
    return order[first]
