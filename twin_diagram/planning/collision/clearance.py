"""How far the arm is from everything and from itself, with gradients, for many configurations at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.planning.collision.ball_cover import Balls
from twin_diagram.planning.collision.chain import Chain, Placement, point_jacobian
from twin_diagram.planning.collision.nearest_pairs import Pairs, Wanting, expanded, into, nearest_of, smallest
from twin_diagram.planning.collision.solid_batch import Body, SolidBatch
from twin_diagram.signals.arrays import Array, Ints


@dataclass(frozen=True)
class Tuning:
    """What stands for no distance, and what is kept at hand; chosen by hand."""

    far: float = 1.0e3
    """Stands for a distance beyond reach [m]: far above any."""

    kept: int = 8
    """Sets of further bodies whose tables are kept at hand: those of the last images, for a Context or two."""

    exact: float = 1e-9
    """Distances that are quickly computed are this exact or better [m]."""


TUNING = Tuning()


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


@dataclass(frozen=True)
class _Arm:
    """The arm in N configurations, as balls.

    Attributes:
        placement: of its links.
        centres: (N, S, 3) of balls in W [m].
        middles: (N, G, 3) of balls about each part [m].
    """

    placement: Placement
    centres: Array
    middles: Array


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
        self._counted = ~ignored[self._links] if bodies else np.ones((len(self._links), 1), dtype=bool)
        self._last_body = len(bodies) - 1
        self._members = np.argsort(self._groups, kind="stable")
        self._member_count = np.bincount(self._groups, minlength=self._group_count)
        self._member_start = np.cumsum(self._member_count) - self._member_count
        self._batch = SolidBatch(self.bodies)
        self._batches: dict[tuple[int, ...], SolidBatch] = {}
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
            result._counted[result._groups == group, b] = False
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

    def distances(
        self, q: Array, around: Surroundings, reach: float, own: bool = True, own_reach: float | None = None
    ) -> Array:
        """Return the smallest signed distance to each body, and to itself.

        Args:
            q: (N, n) configurations.
            around: the bodies then.
            reach: distances above this are not told apart: they come out as `Tuning.far` or as they are [m].
            own: also the arm's distance to itself.
            own_reach: another reach for that [m].

        Returns:
            (N, B + 1) [m]
        """
        arm = self._arm(q)
        pairs = self._pairs_near(arm, around, np.full((len(q), self._count(around)), reach))
        best = nearest_of(pairs, pairs.row * self._count(around) + pairs.body)
        result = np.full((len(q), self._count(around) + 1), TUNING.far)
        result[best.row, best.body] = best.distance
        if own:
            row, _, _, distance, _ = self._near_self(arm, reach if own_reach is None else own_reach)
            np.minimum.at(result[:, -1], row, distance)
        return result

    def link_distances(self, q: Array, around: Surroundings) -> Array:
        """Return the smallest distance of each link (from joint 1's on) to each body, however far: (N, n, B) [m]."""
        n, count = self.chain.size, self._count(around)
        pairs = self._pairs_near(self._arm(q), around, np.full((len(q), count), TUNING.far))
        best = nearest_of(pairs, (pairs.row * (n + 1) + self._links[pairs.ball]) * count + pairs.body)
        result = np.full((len(q), n, count), TUNING.far)
        result[best.row, self._links[best.ball] - 1, best.body] = best.distance
        return result

    def own_distances(self, q: Array, reach: float) -> Array:
        """Return the smallest distance between the two parts of each of `group_pairs`, (N, G) [m].

        `Tuning.far` beyond reach.
        """
        row, first, second, distance, _ = self._near_self(self._arm(q), reach)
        column = np.full((self._group_count, self._group_count), -1)
        column[self._group_pairs[:, 0], self._group_pairs[:, 1]] = np.arange(len(self._group_pairs))
        result = np.full((len(q), len(self._group_pairs)), TUNING.far)
        np.minimum.at(result, (row, column[self._groups[first], self._groups[second]]), distance)
        return result

    def contacts(
        self,
        q: Array,
        around: Surroundings,
        reach: float,
        own_reach: float,
        margins: Array | None = None,
        most: int | None = None,
    ) -> Contacts:
        """Return what is within reach, with gradients: the nearest of each part of the arm to each body.

        Args:
            q: (N, n) configurations.
            around: the bodies then.
            reach: of bodies [m].
            own_reach: the same for the arm to itself.
            margins: (N, B + 1) distances that are wanted [m]; None: none.
            most: about so many entries are enough, those that lack most of their margins; None: all are given. Whatever
                does not keep its margin is given.
        """
        arm = self._arm(q)
        placement, centres, count = arm.placement, arm.centres, self._count(around)
        wanting = Wanting(margins, most, self._group_count) if most is not None and margins is not None else None
        pairs = self._pairs_near(arm, around, np.full((len(q), count), reach), wanting)
        best = nearest_of(pairs, self._key(pairs.row, pairs.body, pairs.ball, around))
        near = np.flatnonzero(best.distance < reach)
        b_row, ball, body = best.row[near], best.ball[near], best.body[near]
        normal = (around.X_WO[body, b_row, :3, :3] @ best.normal_O[near][:, :, None])[..., 0]
        velocity = point_jacobian(placement, centres[b_row, ball], self._links[ball], b_row, self.chain.prismatic)
        row, first, second, distance, own_normal = self._near_self(arm, own_reach)
        key = (row * self._group_count + self._groups[first]) * self._group_count + self._groups[second]
        one = smallest(key, distance)
        row, first, second, distance, own_normal = row[one], first[one], second[one], distance[one], own_normal[one]
        own = point_jacobian(placement, centres[row, first], self._links[first], row, self.chain.prismatic)
        own -= point_jacobian(placement, centres[row, second], self._links[second], row, self.chain.prismatic)
        gradients = (np.einsum("mnk,mk->mn", velocity, normal), np.einsum("mnk,mk->mn", own, own_normal))
        return Contacts(
            np.concatenate([b_row, row]),
            np.concatenate([body, np.full(len(row), count)]),
            np.concatenate([best.distance[near], distance]),
            np.concatenate(gradients),
        )

    def _arm(self, q: Array) -> _Arm:
        """Return where the arm's balls and parts are in configurations (N, n)."""
        placement = self.chain.place(q)
        X_WL = placement.X_WL[:, self._group_link]
        middles = (X_WL[..., :3, :3] @ self._group_centre[:, :, None])[..., 0] + X_WL[..., :3, 3]
        return _Arm(placement, self.centres(placement), middles)

    def _count(self, around: Surroundings) -> int:
        return len(self.bodies) + len(around.beside)

    def _batch_of(self, around: Surroundings) -> SolidBatch:
        """Return the tables of all bodies."""
        if not around.beside:
            return self._batch
        key = tuple(map(id, around.beside))
        found = self._batches.get(key)
        # A table holds its bodies, so that no other can have their identity.
        if found is None:
            while len(self._batches) >= TUNING.kept:
                self._batches.pop(next(iter(self._batches)))
            found = self._batches[key] = SolidBatch([*self.bodies, *around.beside])
        return found

    def _pairs_near(self, arm: _Arm, around: Surroundings, reach: Array, wanting: Wanting | None = None) -> Pairs:
        """Return balls and solids that may be within reach (N, B) of each other: by boxes about the solids.

        With `wanting`, about so many of the parts of the arm and bodies as that asks for.
        """
        batch = self._batch_of(around)
        present = np.flatnonzero(around.present)
        R, p = around.X_WO[present, :, :3, :3], around.X_WO[present, :, :3, 3]
        b, row, part = self._parts_near(arm, around, reach, batch)
        # A box about each body: for parts, then for balls.
        body = present[b]
        far = reach[row, body] + TUNING.exact
        at_least = batch.bodies_at_least(body, into(R[b, row], arm.middles[row, part] - p[b, row]))
        at_least -= self._group_radius[part] + around.grown[body, row]
        kept = np.flatnonzero(at_least < far)
        if wanting is not None:
            kept = kept[wanting.of_parts(row[kept], body[kept], part[kept], at_least[kept], 3)]
        entry, within = expanded(self._member_count[part[kept]])
        entry = kept[entry]
        ball = self._members[self._member_start[part[entry]] + within]
        counted = np.flatnonzero(self._counts(ball, body[entry]))
        entry, ball = entry[counted], ball[counted]
        b, row, body, far = b[entry], row[entry], body[entry], far[entry]
        p_O = into(R[b, row], arm.centres[row, ball] - p[b, row])
        size = self._radii[ball] + around.grown[body, row]
        at_least = batch.bodies_at_least(body, p_O) - size
        kept = np.flatnonzero(at_least < far)
        if wanting is not None:
            kept = kept[wanting.of_parts(row[kept], body[kept], self._groups[ball[kept]], at_least[kept], 2)]
        # Solids.
        entry, within = expanded(batch.count[body[kept]])
        pair = kept[entry]
        solid, p_O = batch.first[body[pair]] + within, p_O[pair]
        at_least = batch.at_least(solid, p_O) - size[pair]
        chosen = np.flatnonzero(at_least < far[pair])
        if wanting is not None:
            on = pair[chosen]
            chosen = chosen[wanting.of_parts(row[on], body[on], self._groups[ball[on]], at_least[chosen], 1)]
        pair = pair[chosen]
        return Pairs(batch, row[pair], ball[pair], body[pair], solid[chosen], p_O[chosen], size[pair], at_least[chosen])

    def _parts_near(self, arm: _Arm, around: Surroundings, reach: Array, batch: SolidBatch) -> tuple[Ints, Ints, Ints]:
        """Return parts of the arm and bodies that may be within reach (N, B) of each other: by balls about them.

        Index among the bodies that are present, configuration, part.
        """
        present, parts = np.flatnonzero(around.present), arm.middles
        X_WO = around.X_WO[present]
        middle = (X_WO[..., :3, :3] @ batch.centres[present][:, None, :, None])[..., 0] + X_WO[..., :3, 3]
        # |c − m|² for all at once.
        squares = np.einsum("ngi,ngi->ng", parts, parts)[None] + np.einsum("bni,bni->bn", middle, middle)[..., None]
        squares -= 2 * np.matmul(middle.transpose(1, 0, 2), parts.transpose(0, 2, 1)).transpose(1, 0, 2)
        wide = batch.radii[present][:, None] + around.grown[present] + reach[:, present].T
        limit = np.maximum(wide[..., None] + self._group_radius + TUNING.exact, 0.0)
        b, row, part = np.nonzero(squares < limit * limit)
        return b, row, part

    def _counts(self, ball: Ints, body: Ints) -> npt.NDArray[np.bool_]:
        """Return (M,) whether balls and bodies (M,) count against each other."""
        result: npt.NDArray[np.bool_] = self._counted[ball, np.minimum(body, self._last_body)]
        return result | (body > self._last_body)

    def _key(self, row: Ints, body: Ints, ball: Ints, around: Surroundings) -> Ints:
        """Return a number for each configuration, body and part of the arm."""
        return (row * self._count(around) + body) * self._group_count + self._groups[ball]

    def _near_self(self, arm: _Arm, reach: float) -> tuple[Ints, Ints, Ints, Array, Array]:
        """Return pairs of balls within reach of each other.

        Row, first, second, distance, normal from second to first.
        """
        middles, centres = arm.middles, arm.centres
        i, j = self._group_pairs[:, 0], self._group_pairs[:, 1]
        offset = middles[:, i] - middles[:, j]
        limit = reach + self._group_radius[i] + self._group_radius[j]
        row, pair = np.nonzero(np.einsum("nsi,nsi->ns", offset, offset) < limit**2)
        count = self._pair_count[pair]
        entry, within = expanded(count)
        chosen = self._pair_start[pair[entry]] + within
        row = row[entry]
        first, second = self._pairs[chosen, 0], self._pairs[chosen, 1]
        offset = centres[row, first] - centres[row, second]
        norm = np.sqrt(np.einsum("mi,mi->m", offset, offset))
        distance = norm - self._radii[first] - self._radii[second]
        near = np.flatnonzero(distance < reach)
        normal = offset[near] / np.maximum(norm[near], 1e-9)[:, None]
        return row[near], first[near], second[near], distance[near], normal
