"""How far the arm is from everything and from itself, with gradients, for many configurations at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from twin_diagram.planning.collision.ball_cover import Balls
from twin_diagram.planning.collision.chain import Chain, Placement
from twin_diagram.planning.collision.solid_batch import Body, solids_of
from twin_diagram.signals.arrays import Array, Ints

if TYPE_CHECKING:
    from twin_diagram.planning.collision import near_kernels


@dataclass(frozen=True)
class Tuning:
    """What stands for no distance, and what is kept at hand; chosen by hand."""

    far: float = 1.0e3
    """Stands for a distance beyond reach [m]: far above any."""

    tiny: float = 1e-9
    """Lengths below this have no direction [m]."""

    rough: int = 3
    """As long as distances are known roughly, so many times as many are looked at as are wanted."""

    kept: int = 8
    """Sets of further bodies whose tables are kept at hand: those of the last images, for a Context or two."""


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
        self._group_count = int(self._groups.max()) + 1
        if ignored is None:
            ignored = np.zeros((chain.size + 1, len(bodies)), dtype=bool)
        self._ignored = ignored
        self._counted = ~ignored[self._links]
        self._members = np.argsort(self._groups, kind="stable")
        self._member_start = np.append(0, np.cumsum(np.bincount(self._groups, minlength=self._group_count)))
        self._tables: dict[tuple[int, ...], tuple[tuple[Body, ...], near_kernels.Solids]] = {}
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
        keys, counts = np.unique(key[order], return_counts=True)
        self._pair_start = np.append(0, np.cumsum(counts))
        self._group_pairs = np.stack([keys // self._group_count, keys % self._group_count], axis=1)

    def drop_group_pairs(self, drop: npt.NDArray[np.bool_]) -> None:
        """Forget pairs of parts of the arm, a bool for each of `group_pairs`."""
        counts = np.diff(self._pair_start)
        self._pairs = self._pairs[np.repeat(~drop, counts)]
        self._group_pairs, self._pair_start = self._group_pairs[~drop], np.append(0, np.cumsum(counts[~drop]))

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
        return _arm_kernels().carried(placement.X_WL, self._centres_L, self._links)

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
        arm, _ = self._arm(q, np.zeros(self._group_count, dtype=np.int64))
        result = np.full((len(q), self._count(around) + 1), np.inf)
        result[:, :-1] = self._near(arm, around, reach)[0][..., 0]
        if own and len(self._group_pairs):
            result[:, -1] = self._near_self(arm, reach if own_reach is None else own_reach)[0].min(axis=1)
        return np.where(np.isfinite(result), result, TUNING.far)

    def link_distances(self, q: Array, around: Surroundings) -> Array:
        """Return the smallest distance of each link (from joint 1's on) to each body, however far: (N, n, B) [m]."""
        arm, _ = self._arm(q, self._group_link)
        best = self._near(arm, around, TUNING.far)[0][..., 1:]
        every = np.full((*best.shape[:2], self.chain.size), np.inf)  # the last links may have no shape
        every[..., : best.shape[2]] = best
        return np.where(np.isfinite(every), every, TUNING.far).transpose(0, 2, 1)

    def own_distances(self, q: Array, reach: float) -> Array:
        """Return the smallest distance between the two parts of each of `group_pairs`, (N, G) [m].

        `Tuning.far` beyond reach.
        """
        best, _ = self._near_self(self._arm(q, np.zeros(self._group_count, dtype=np.int64))[0], reach)
        return np.where(np.isfinite(best), best, TUNING.far)

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
        arm_loops = _arm_kernels()
        arm, placement = self._arm(q, np.arange(self._group_count))
        best, balls, normals = self._near(arm, around, reach, margins, most)
        wanted = best < reach
        if most is not None and margins is not None:
            wanted &= best - margins[:, :-1, None] <= _limit(best, margins, most)
        # One layout: for another the loops would be compiled anew.
        row, body, part = map(np.ascontiguousarray, np.nonzero(wanted))
        ball = balls[row, body, part]
        normal = arm_loops.turned(np.require(around.X_WO, requirements=("C", "W")), body, row, normals[row, body, part])
        at = placement.axes_W, placement.origins_W, self.chain.prismatic
        gradient = arm_loops.slopes(arm.centres[row, ball], self._links[ball], row, normal, *at)
        own, which = self._near_self(arm, own_reach)
        own_row, pair = map(np.ascontiguousarray, np.nonzero(own < own_reach))
        first, second = map(np.ascontiguousarray, self._pairs[which[own_row, pair]].T)
        p, to = arm.centres[own_row, first], arm.centres[own_row, second]
        across = p - to
        normal = across / np.maximum(np.linalg.norm(across, axis=1), TUNING.tiny)[:, None]
        own_gradient = arm_loops.slopes(p, self._links[first], own_row, normal, *at)
        own_gradient -= arm_loops.slopes(to, self._links[second], own_row, normal, *at)
        return Contacts(
            np.concatenate([row, own_row]),
            np.concatenate([body, np.full(len(own_row), self._count(around))]),
            np.concatenate([best[row, body, part], own[own_row, pair]]),
            np.concatenate([gradient, own_gradient]),
        )

    def _arm(self, q: Array, key: Ints) -> tuple[near_kernels.PlacedBalls, Placement]:
        """Return the arm in configurations (N, n), with what kind of nearest pairs each of its parts (G,) is for."""
        near = _near_kernels()
        placement = self.chain.place(q)
        balls = near.PlacedBalls(
            centres=self.centres(placement),
            radii=self._radii,
            members=self._members,
            first=self._member_start,
            middles=_arm_kernels().carried(placement.X_WL, self._group_centre, self._group_link),
            reaches=self._group_radius,
            key=key,
            kinds=int(key.max()) + 1,
            counted=self._counted,
        )
        return balls, placement

    def _count(self, around: Surroundings) -> int:
        return len(self.bodies) + len(around.beside)

    def _tables_of(self, around: Surroundings) -> near_kernels.Solids:
        """Return the tables of all bodies."""
        key = tuple(map(id, around.beside))
        found = self._tables.get(key)
        if found is None:
            while len(self._tables) >= TUNING.kept:
                self._tables.pop(next(iter(self._tables)))
            # Kept with its bodies, so that no other can have their identity.
            found = self._tables[key] = (around.beside, solids_of([*self.bodies, *around.beside]))
        return found[1]

    def _near(
        self,
        arm: near_kernels.PlacedBalls,
        around: Surroundings,
        reach: float,
        margins: Array | None = None,
        most: int | None = None,
    ) -> tuple[Array, Ints, Array]:
        """Return what is near bodies, see `near_kernels.near_bodies`.

        With margins (N, B + 1) about the `most` that lack most of them are enough.
        """
        # Writable too: for arrays that are not, loops would be compiled once more.
        where = [np.require(part, requirements=("C", "W")) for part in (around.X_WO, around.grown, around.present)]
        tables, near = self._tables_of(around), _near_kernels()
        far = np.full((len(arm.centres), self._count(around)), float(reach))
        if margins is not None and most is not None:
            # Roughly at first: bodies as boxes, parts as balls.
            bounds = near.never_below(arm, tables, *where, float(reach))
            far = np.minimum(far, margins[:, :-1] + _limit(bounds, margins, TUNING.rough * most) + TUNING.tiny)
        return near.near_bodies(arm, tables, *where, far)

    def _near_self(self, arm: near_kernels.PlacedBalls, reach: float) -> tuple[Array, Ints]:
        """Return what is near each other; see `near_kernels.near_itself`."""
        return _near_kernels().near_itself(arm, self._group_pairs, self._pair_start, self._pairs, float(reach))


@cache
def _near_kernels() -> ModuleType:
    """Return compiled loops: they are loaded when first wanted, not with every import."""
    from twin_diagram.planning.collision import near_kernels

    return near_kernels


@cache
def _arm_kernels() -> ModuleType:
    from twin_diagram.planning.collision import arm_kernels

    return arm_kernels


def _limit(distance: Array, margins: Array, most: int) -> float:
    """Return how far (N, B, G) may be beyond their margins (N, B + 1) to be among the `most` that lack most of them.

    Not below 0: whatever does not keep its margin counts.
    """
    lack = distance - margins[:, :-1, None]
    return max(0.0, float(np.partition(lack, most - 1, axis=None)[most - 1])) if lack.size > most else np.inf
