"""What is remembered of unknown things, and how an image changes that: pure functions.

A thing is held by convex pieces about all that was seen of it, grown away from the camera (see
`segmentation.pieces`). As long as what is seen of it lies in them they stay as they are; where it sticks out they are
made anew. It counts from the second image on that shows it. Nothing but seeing what is behind it, or recognising it,
deletes it: not an arm before it, not an arm beside it, not time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.segmentation.pieces import convex_pieces, floor_below
from twin_diagram.perception.segmentation.planes import Plane
from twin_diagram.perception.segmentation.segmentation import level
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.things.clusters import Placed, reach_at
from twin_diagram.perception.things.flow import flow_since
from twin_diagram.perception.things.hulls import few_corners, inside
from twin_diagram.perception.things.motion import MOTION_SIZE, ShownMotion, shown_again, velocity_of
from twin_diagram.perception.things.seen_through import looked_at, seen_through
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, ObjectStatus
from twin_diagram.signals.things import COAST, CORNERS, PIECES, THING_SIZE, Thing


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them; chosen by hand for things of a hand's size."""

    place_slack: float = 0.006
    """What is seen of a thing lies within this of its pieces [m] …"""

    sigmas: float = 2.0
    """… and so many standard deviations of depth."""

    mine: float = 0.5
    """A cluster of which this share lies in a thing's pieces is that thing."""

    whole: float = 0.9
    """Below this share a thing's pieces are made anew."""

    step: float = 0.12
    """From one image to the next no thing's middle goes farther than this [m]."""

    moved: float = 0.03
    """A thing moves whose middle is farther than this from where it rested [m]; with less of it hidden than that …"""

    hidden: float = 0.2
    """… share, for else its middle only seems to move."""

    calm: float = 0.5
    """A thing moves until so long after it was last seen to [s]."""

    open_share: float = 0.3
    """This share of a thing's surface must be in the open before its place counts as seen empty."""

    empty: float = 0.7
    """And of what is in the open the camera must see through this share."""

    empty_images: int = 3
    """In so many images running: edges jitter, and depth comes half a frame late."""

    known: float = 0.6
    """A thing of whose surface known objects explain this share is one of them."""


TUNING = Tuning()

Indices = npt.NDArray[np.int64]

SAMPLES: Final = 32
"""Places on a thing's surface that are looked up in images."""
MEMORY_SIZE: Final = THING_SIZE + 4 + 1 + 3 * SAMPLES + 6 + MOTION_SIZE
"""A packed `Remembered`."""


@dataclass(frozen=True)
class Remembered:
    """A slot for an unknown thing.

    Attributes:
        thing: what goes out.
        empty: images running that showed its place empty.
        moved: when it was last seen to move [s].
        searches: how often it was compared with the library.
        next_search: when that is done again [s].
        samples: (S, 3) places on its visible surface, in W [m].
        made_at: (3,) its middle when its pieces were made.
        rested_at: (3,) its middle where it was last said to be, or to have moved to.
        motion: what images showed of its motion.
    """

    thing: Thing = field(default_factory=Thing)
    empty: int = 0
    moved: float = NEVER
    searches: int = 0
    next_search: float = NEVER
    samples: Array = field(default_factory=lambda: np.zeros((0, 3)))
    made_at: Array = field(default_factory=lambda: np.zeros(3))
    rested_at: Array = field(default_factory=lambda: np.zeros(3))
    motion: ShownMotion = field(default_factory=ShownMotion)

    def pack(self) -> Array:
        """Return it as a vector of `MEMORY_SIZE`."""
        places = np.zeros((SAMPLES, 3))
        places[: len(self.samples)] = self.samples
        head = [float(self.empty), self.moved, float(self.searches), self.next_search, float(len(self.samples))]
        middles = np.concatenate([self.made_at, self.rested_at])
        return np.concatenate([self.thing.pack(), head, places.ravel(), middles, self.motion.pack()])

    @staticmethod
    def unpack(vector: Array) -> Remembered:
        """Return the inverse of `pack`; copies."""
        empty, moved, searches, next_search, count = vector[THING_SIZE : THING_SIZE + 5]
        motion = ShownMotion.unpack(vector[-MOTION_SIZE:])
        places = vector[THING_SIZE + 5 : -6 - MOTION_SIZE].reshape(SAMPLES, 3)[: int(count)].copy()
        own = Thing.unpack(vector[:THING_SIZE])
        made_at, rested_at = vector[-6 - MOTION_SIZE : -MOTION_SIZE].reshape(2, 3).copy()
        counts = int(empty), float(moved), int(searches), float(next_search)
        return Remembered(own, *counts, places, made_at, rested_at, motion)


@dataclass(frozen=True)
class Observed:
    """What an image made of the slots.

    Attributes:
        slots: as many as before.
        next_identity: of the next new thing.
        turned_away: new things that found no slot.
        cluster_of: by a slot's number, which cluster it is.
    """

    slots: list[Remembered]
    next_identity: int
    turned_away: int
    cluster_of: dict[int, int]


@dataclass(frozen=True)
class Life:
    """When things count as stale and lost: unseen for so long [s]."""

    stale_after: float
    lost_after: float


def observe(
    slots: Sequence[Remembered],
    segments: Segments,
    found: Sequence[Indices],
    known: Sequence[Placed],
    next_identity: int,
    life: Life,
) -> Observed:
    """Take an image in.

    Args:
        slots: what is remembered.
        segments: the image taken apart.
        found: the clusters that nothing explains; see `clusters`.
        known: the library's objects that were found in the image.
        next_identity: of the next new thing.
        life: see there.
    """
    after = [Remembered() if slot.thing.status == ObjectStatus.GONE else slot for slot in slots]
    points = [segments.points_W[own] for own in found]
    cluster_of, taken = matched(after, points, segments)
    for k, slot in enumerate(after):
        if k in cluster_of:
            own = found[cluster_of[k]]
            after[k] = timed(seen(slot, own, segments), own, segments)
        elif slot.thing.identity:
            after[k] = unseen(slot, segments, known, life)
    new = [j for j in range(len(found)) if j not in taken]
    turned_away = 0
    for j in sorted(new, key=lambda j: -len(found[j])):
        made = _made(Remembered(Thing(next_identity, first_seen=segments.time)), points[j], found[j], segments)
        if not made.thing.pieces:
            continue
        free = next((k for k, slot in enumerate(after) if not slot.thing.identity), None)
        if free is None:
            turned_away += 1
            continue
        after[free], cluster_of[free] = timed(made, found[j], segments), j
        next_identity += 1
    return Observed(after, next_identity, turned_away, cluster_of)


def matched(
    slots: Sequence[Remembered], points: Sequence[Array], segments: Segments
) -> tuple[dict[int, int], set[int]]:
    """Return which cluster each slot's thing is, by the slot's number: what lies in its pieces, then what is near.

    A thing in two parts, as an arm before it makes them, is the larger one. The other part lies in its pieces, too, and
    is no thing of its own: it is among the clusters taken, which come second.
    """
    result: dict[int, int] = {}
    taken: set[int] = set()
    shares = {
        (k, j): _share_inside(slot, own, segments)
        for k, slot in enumerate(slots)
        if slot.thing.identity
        for j, own in enumerate(points)
    }
    order = sorted(shares, key=lambda pair: (-shares[pair] * len(points[pair[1]]), pair))
    for k, j in order:
        if shares[k, j] >= TUNING.mine and j not in taken:
            result.setdefault(k, j)
            taken.add(j)
    near = {pair: float(np.linalg.norm(points[pair[1]].mean(axis=0) - slots[pair[0]].thing.middle)) for pair in shares}
    for k, j in sorted(near, key=lambda pair: (near[pair], pair)):
        if k not in result and j not in taken and near[k, j] < TUNING.step:
            result[k] = j
            taken.add(j)
    return result, taken


def seen(slot: Remembered, own: Indices, segments: Segments) -> Remembered:
    """Return a slot after its thing was seen as the segments' points `own`."""
    time, points = segments.time, segments.points_W[own]
    middle = points.mean(axis=0)
    away = float(np.linalg.norm(middle - slot.made_at))
    still = (away < _slack(points, segments) or _stays(slot, away, segments)) and not _shrunk(slot, segments)
    if still and _share_inside(slot, points, segments) >= TUNING.whole:
        thing = replace(slot.thing, last_seen=time, status=_status(slot, time), middle=middle)
        return replace(slot, thing=thing, empty=0)
    there = ~np.logical_or(*looked_at(slot.samples, segments))
    # What an arm hides of a thing that stands still is still there.
    hidden = slot.samples[there] if away < TUNING.moved else np.zeros((0, 3))
    made = _made(slot, np.concatenate([points, hidden]), own, segments)
    if not made.thing.pieces:
        made = replace(made, thing=replace(made.thing, pieces=slot.thing.pieces))
    elsewhere = float(np.linalg.norm(middle - slot.rested_at)) > TUNING.moved
    if elsewhere and there.mean() < TUNING.hidden:
        made = replace(made, moved=time, rested_at=middle)
    return replace(made, thing=replace(made.thing, status=_status(made, time)), empty=0)


def timed(slot: Remembered, own: Indices, segments: Segments) -> Remembered:
    """Return a slot whose thing was seen as the segments' points `own`, with the velocity that images now tell."""
    motion = shown_again(slot.motion, own, segments)
    rows = slot.motion.rows
    recent = len(rows) > 0 and segments.time - rows[-1, 0] <= COAST
    before, doubted = (slot.thing.velocity, slot.thing.velocity_variance) if recent else (np.zeros(3), 0.0)
    surface = flow_since(slot.motion.views, own, segments, before) if recent else None
    velocity, variance = velocity_of(motion, before, segments, surface, doubted)
    status = slot.thing.status
    if velocity.any() and status == ObjectStatus.TRACKED:
        status = ObjectStatus.MOVING
    thing = replace(slot.thing, status=status, velocity=velocity, velocity_variance=variance)
    return replace(slot, thing=thing, motion=motion)


def unseen(slot: Remembered, segments: Segments, known: Sequence[Placed], life: Life) -> Remembered:
    """Return a slot after an image that does not show its thing."""
    if slot.thing.status == ObjectStatus.UNSEEN:
        return Remembered()  # it was seen once, and never again
    if explained(slot.samples, known, segments) >= TUNING.known:
        return replace(slot, thing=replace(slot.thing, status=ObjectStatus.GONE))
    look = seen_through(slot.samples, segments)
    open_ = look.there + look.empty
    through = open_ >= TUNING.open_share and look.empty >= TUNING.empty * open_
    empty = slot.empty + 1 if through else 0
    if empty >= TUNING.empty_images:
        return replace(slot, thing=replace(slot.thing, status=ObjectStatus.GONE), empty=empty)
    age, status = segments.time - slot.thing.last_seen, slot.thing.status
    if age > life.stale_after:
        status = ObjectStatus.LOST if age > life.lost_after else ObjectStatus.STALE
    return replace(slot, thing=replace(slot.thing, status=status), empty=empty)


def beneath(own: Indices, segments: Segments) -> list[Plane]:
    """Return the planes that what the segments' points `own` show may stand on, the table first: not its own lid.

    From above hardly more than that is seen of a thing, and its lowest points lie on it.
    """
    part = int(segments.labels[own[0]])
    return [plane for plane in segments.planes if plane.part != part]


def explained(places: Array, known: Sequence[Placed], segments: Segments) -> float:
    """Return the share of places (S, 3) on a thing's surface that are on known objects' surfaces."""
    if not len(places):
        return 0.0
    on = np.zeros(len(places), dtype=bool)
    for model, R, p in known:
        distance, _ = model.nearest.query((places - p) @ R, reach_at(segments.camera, p))
        on |= np.isfinite(distance)
    return float(on.mean())


def _status(slot: Remembered, time: float) -> ObjectStatus:
    return ObjectStatus.MOVING if slot.moved >= 0.0 and time - slot.moved < TUNING.calm else ObjectStatus.TRACKED


def _shrunk(slot: Remembered, segments: Segments) -> bool:
    look = seen_through(slot.samples, segments)
    return look.empty >= 0.5 * (look.there + look.empty) > 0.0


def _stays(slot: Remembered, away: float, segments: Segments) -> bool:
    """Return whether a thing is where it was though the middle of what is seen of it is `away` [m] from there.

    A handle that is a segment of its own in every other image shifts it by centimetres.
    """
    return away < TUNING.moved and seen_through(slot.samples, segments).there >= TUNING.whole


def _share_inside(slot: Remembered, points: Array, segments: Segments) -> float:
    thin = points[:: max(1, len(points) // 200)]
    return float(inside(thin, slot.thing.pieces, _slack(thin, segments)).mean())


def _slack(points: Array, segments: Segments) -> float:
    """Return how far from its place a thing may be shown [m]."""
    camera = segments.camera
    z = (points.mean(axis=0) - camera.p_WC) @ camera.R_WC[:, 2]
    return TUNING.place_slack + TUNING.sigmas * float(camera.depth_noise(np.array(z)))


def _made(slot: Remembered, points: Array, own: Indices, segments: Segments) -> Remembered:
    """Return a slot with pieces made of points (N, 3), of a thing that the segments' points `own` show."""
    planes: Sequence[Plane] = beneath(own, segments) or (level(float(segments.table[2])),)
    pieces = convex_pieces(points, segments.camera.p_WC, floor_below(points, planes))[:PIECES]
    middle = points.mean(axis=0)
    thing = replace(
        slot.thing,
        last_seen=segments.time,
        middle=middle,
        pieces=tuple(few_corners(piece, CORNERS) for piece in pieces),
    )
    # Evenly over the image: points come in the order of their pixels.
    chosen = np.linspace(0, len(points) - 1, min(SAMPLES, len(points))).round().astype(int)
    rested_at = slot.rested_at if slot.thing.pieces else middle
    return replace(slot, thing=thing, samples=points[chosen], made_at=middle, rested_at=rested_at)
