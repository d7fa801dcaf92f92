"""Counts contacts of the true world that no step of learning asks for: for scores alone, no stage reads them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from twin_diagram.model.description.followers import Followers
from twin_diagram.runs.learning.cell import FREE, GRASP, RELEASE, Doing
from twin_diagram.signals.arrays import Array

if TYPE_CHECKING:
    from pydrake.systems.framework import Context

    from twin_diagram.station.sim.station import SimStation

Place = Callable[[], Array]
"""Tells where in W something is (3,) [m]."""
NOTHING: Final = -1
"""No object."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    anew: float = 0.3
    """What touches again within this has not let go in between [s]: what is scraped along bounces."""

    near: float = 0.2
    """Within which of a grasp the object that it is of is looked for [m]: the length of the longest one."""


TUNING = Tuning()


@dataclass(frozen=True)
class CellParts:
    """Which bodies of the world are what: numbers of bodies.

    Attributes:
        arm: all of the arm's, those of the gripper among them.
        gripper: fingers and what carries them.
        objects: what lies about and is handled.
    """

    arm: frozenset[int]
    gripper: frozenset[int]
    objects: frozenset[int]


def asked_for(a: int, b: int, parts: CellParts, phase: str, wanted: int) -> bool:
    """Return whether a step asks for a contact of two bodies.

    The gripper may touch the object that is wanted, or held, and nothing else but itself; that object may touch others,
    and what stands still, while it is taken and while it is set down. Objects that nobody handles touch what they like.

    Args:
        a: number of a body.
        b: of the other one.
        parts: which bodies are what.
        phase: what the arm is about.
        wanted: number of the object that is to be grasped, or held; `NOTHING`: none.
    """
    if a in parts.arm or b in parts.arm:
        mine, other = (a, b) if a in parts.arm else (b, a)
        return mine in parts.gripper and (other == wanted or other in parts.gripper)
    return wanted not in (a, b) or phase in (GRASP, RELEASE)


class ContactCount:
    """Watches the true world tick by tick; see `cell.Observer`.

    Attributes:
        count: contacts that began and that no step asked for, things that were lost from the hand among them.
    """

    def __init__(self, tell: Callable[..., None]) -> None:
        """`tell`: is told of each by keywords `between`, `doing`, `at`."""
        self._tell = tell
        self._parts: CellParts | None = None
        self._last: dict[tuple[int, int], float] = {}
        self._wanted, self._gripped = NOTHING, False
        self._before, self._phase = FREE.phase, FREE.phase
        self.count = 0

    def moment(self, name: str, positions: Array) -> None:
        """Take nothing."""

    def ticked(self, station: SimStation, context: Context, doing: Doing) -> None:
        """Count what has begun to touch since the last tick."""
        if self._parts is None:
            self._sort(station)
        assert self._parts is not None
        if doing.phase == GRASP and self._phase != GRASP and doing.places:
            self._wanted, self._gripped = self._meant(station, context, np.array(doing.places)), False
        self._before, self._phase = self._phase, doing.phase
        now = context.get_time()
        # By shapes alone: the plant's own results take a solution for forces, which nobody asks for, of its own.
        plant = station.world.plant
        query: Any = plant.get_geometry_query_input_port().Eval(plant.GetMyContextFromRoot(context))
        found = query.ComputeContactSurfacesWithFallback(plant.get_contact_surface_representation())
        where = {(min(a, b), max(a, b)): at for a, b, at in self._pairs(*found)}
        pairs = set(where)
        self._note_grip(pairs, doing, now)
        for a, b in sorted(pairs):
            if asked_for(a, b, self._parts, doing.phase, self._wanted):
                continue
            if now - self._last.get((a, b), -np.inf) > TUNING.anew:
                self._note([self._names.get(a, "fixture"), self._names.get(b, "fixture")], doing, now, where[a, b]())
            self._last[a, b] = now

    def _note_grip(self, pairs: set[tuple[int, int]], doing: Doing, now: float) -> None:
        """Follow whether what is wanted is in the hand; what leaves it unasked is noted."""
        assert self._parts is not None
        if self._wanted == NOTHING or doing.phase in (GRASP, RELEASE):  # until it is let go the fingers may brush it
            return
        touched = any(self._wanted in pair and (set(pair) & self._parts.gripper) for pair in pairs)
        if touched:
            self._gripped = True
            return
        if self._gripped and self._before != RELEASE:
            self._note([self._names[self._wanted], "nothing"], doing, now)
        self._wanted, self._gripped = NOTHING, False

    def _note(self, between: list[str], doing: Doing, now: float, place: Array | None = None) -> None:
        self.count += 1
        where = {} if place is None else {"place": [round(float(x), 4) for x in place]}
        self._tell(between=between, doing=doing.phase, at=round(now, 3), **where)

    def _sort(self, station: SimStation) -> None:
        """Learn which bodies are what."""
        world, plant = station.world, station.world.plant
        arm = [int(body) for instance in world.arm.arm.instances for body in plant.GetBodyIndices(instance)]
        fingers = Followers.gripping(plant, world.arm.arm)
        hand = {int(body.index()) for finger in fingers for body in (finger.child_body(), finger.parent_body())}
        objects = {name: int(index) for name, index in world.objects.items()}
        self._parts = CellParts(frozenset(arm), frozenset(hand), frozenset(objects.values()))
        self._names = {index: plant.get_body(_index(index)).name() for index in arm}
        self._names |= {index: name for name, index in objects.items()}
        every = [_index(k) for k in range(plant.num_bodies())]
        self._body_of = {g: int(k) for k in every for g in plant.GetCollisionGeometriesForBody(plant.get_body(k))}

    def _meant(self, station: SimStation, context: Context, places: Array) -> int:
        """Return the object that is nearest to most of some places (K, 3) in W.

        Of what is pushed they are all over it: where fingers press on a thing that leans its neighbour may be nearer.
        """
        named = Counter(self._nearest(station, context, place) for place in places)
        return named.most_common(1)[0][0]

    def _nearest(self, station: SimStation, context: Context, place: Array) -> int:
        """Return the object whose surface is about a place (3,) in W, or nearest: a bottle's origin may be far off."""
        assert self._parts is not None
        plant = station.world.plant
        query: Any = plant.get_geometry_query_input_port().Eval(plant.GetMyContextFromRoot(context))
        found = query.ComputeSignedDistanceToPoint(place, TUNING.near)
        near = [(one.distance, self._body_of[one.id_G]) for one in found if one.id_G in self._body_of]
        return min((one for one in near if one[1] in self._parts.objects), default=(0.0, NOTHING))[1]

    def _pairs(self, surfaces: Sequence[Any], points: Sequence[Any]) -> Iterator[tuple[int, int, Place]]:
        """Yield the bodies of each contact, of those over surfaces and those in points, and what tells its place."""
        for point in points:
            yield self._body_of[point.id_A], self._body_of[point.id_B], partial(_middle, point)
        for surface in surfaces:
            yield self._body_of[surface.id_M()], self._body_of[surface.id_N()], surface.centroid


class Watchers:
    """Several observers as one."""

    def __init__(self, *each: Any) -> None:
        """`each`: a `cell.Observer`; None: nobody."""
        self._each = [one for one in each if one is not None]

    def moment(self, name: str, positions: Array) -> None:
        """Tell each."""
        for one in self._each:
            one.moment(name, positions)

    def ticked(self, station: SimStation, context: Context, doing: Doing) -> None:
        """Tell each."""
        for one in self._each:
            one.ticked(station, context, doing)


def _middle(point: Any) -> Array:
    return np.asarray(0.5 * (point.p_WCa + point.p_WCb))


def _index(body: int) -> Any:
    from pydrake.multibody.tree import BodyIndex

    return BodyIndex(body)
