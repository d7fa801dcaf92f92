"""What each of several cameras remembers of one set of slots, and how one helps the other: pure functions.

Who is who (slots, identities, unknown things) is common to all cameras. Where an object is each camera remembers for
itself, for their calibrations are off by millimetres: laid into one track, the step from one camera to the other would
pass for motion, and a camera's own colours for another's. A camera goes on from what it saw itself. What it did not
find in its newest image and another has seen since is handed to it: it then knows where to look, does not search all
the table for what another follows, and tells of a place that it sees to be empty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twin_diagram.perception.registration.colour_shift import ALIGNED, COLOUR_SHIFT_SIZE, ColourShift
from twin_diagram.perception.registration.instances import emptiness
from twin_diagram.perception.registration.slots import SLOT_SIZE, Slot, predict
from twin_diagram.perception.registration.slots import TUNING as SLOTS
from twin_diagram.perception.registration.turned_alike import turned
from twin_diagram.perception.registration.view import Known
from twin_diagram.perception.registration.whole_image import ImageSettings, OtherMemory
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.things.clusters import Placed
from twin_diagram.perception.things.memory import MEMORY_SIZE, Remembered
from twin_diagram.perception.things.motion import ShownMotion
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, ObjectStatus
from twin_diagram.signals.things import PIECES, Thing


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    apart: float = 0.04
    """Two cameras that show an object farther apart contradict each other [m]: calibrations off by 5 mm, half a degree
    and 1 % of depth, as cameras come, make 2 cm of a metre."""

    turned: float = 0.6
    """As far turned they do, too [rad]: `turned_alike.TUNING.other`."""


TUNING = Tuning()


@dataclass(frozen=True)
class ViewMemory:
    """What one camera remembers.

    Attributes:
        slots: of the library's objects, then of the further instances' slots.
        identities: (F) which instance each of the latter is; 0: none.
        things: of the slots of unknown things, as this camera saw them last; `last_seen` is by this camera.
        shift: how far its colours lie beside its depth.
        time: of its newest image [s]; `NEVER` before the first.
    """

    slots: tuple[Slot, ...]
    identities: tuple[int, ...] = ()
    things: tuple[Remembered, ...] = ()
    shift: ColourShift = field(default_factory=lambda: ALIGNED)
    time: float = NEVER

    @staticmethod
    def empty(told: ImageSettings, aside: float) -> ViewMemory:
        """Return it before the first image; its colours may lie `aside` [px, RMS]."""
        slots = (Slot(),) * (len(told.library) + told.further)
        unknown = (Remembered(),) * told.slots.unknown
        return ViewMemory(slots, (0,) * told.further, unknown, ColourShift.told(aside))

    def pack(self) -> Array:
        """Return it as a vector."""
        head = [np.array([self.time, *self.identities], dtype=float), self.shift.pack()]
        return np.concatenate([*head, *(one.pack() for one in self.slots), *(one.pack() for one in self.things)])

    @staticmethod
    def unpack(vector: Array, told: ImageSettings) -> ViewMemory:
        """Return the inverse of `pack`."""
        start = 1 + told.further
        middle = start + COLOUR_SHIFT_SIZE
        end = middle + SLOT_SIZE * (len(told.library) + told.further)
        slots = tuple(Slot.unpack(row) for row in vector[middle:end].reshape(-1, SLOT_SIZE))
        things = tuple(Remembered.unpack(row) for row in vector[end:].reshape(-1, MEMORY_SIZE))
        identities = tuple(int(x) for x in vector[1:start])
        return ViewMemory(slots, identities, things, ColourShift.unpack(vector[start:middle]), float(vector[0]))

    def follows(self, k: int, time: float) -> bool:
        """Return whether this camera found what is in slot k in its newest image, just before `time` [s]."""
        one = self.slots[k]
        return one.known and 0.0 <= one.seen == self.time and time - one.seen <= SLOTS.coast


@dataclass(frozen=True)
class ViewEntry:
    """What goes into an image: as `whole_image.advance` takes it.

    Attributes:
        slots: of the library's objects.
        beside: all else.
        elsewhere: what another camera follows, and this one did not find in the image before.
    """

    slots: list[Slot]
    beside: OtherMemory
    elsewhere: list[Placed]


def entering(
    views: Sequence[ViewMemory], which: int, beside: OtherMemory, told: ImageSettings, time: float
) -> ViewEntry:
    """Return what one camera's next image is looked at with. Of one camera alone, what it remembers itself.

    Args:
        views: what the cameras remember.
        which: the camera.
        beside: as the newest image of any camera left it.
        told: what does not change.
        time: of the image [s].
    """
    first = len(told.library)
    current = [one.identity for one in beside.further]
    views = [_of_now(view, current, first) for view in views]
    assets = [*range(first), *(one.asset for one in beside.further)]
    slots: list[Slot] = []
    elsewhere: list[Placed] = []
    for k in range(first + len(current)):
        slot, follows = _handed(views, which, k, time)
        slots.append(slot)
        if follows:
            elsewhere.append((told.every[assets[k]].model, slot.R, slot.p))
    further = tuple(replace(one, slot=slots[first + k]) for k, one in enumerate(beside.further))
    things = tuple(_thing_of(views[which], beside.things[k], k) for k in range(len(beside.things)))
    own = replace(beside, further=further, things=things, shift=views[which].shift)
    return ViewEntry(slots[:first], own, elsewhere)


def left(
    view: ViewMemory, entry: OtherMemory, slots: Sequence[Slot], beside: OtherMemory, time: float
) -> tuple[ViewMemory, OtherMemory]:
    """Return what a camera remembers after its image, and what is common to all.

    Args:
        view: what it remembered.
        entry: what its image was looked at with: `ViewEntry.beside`.
        slots: of the library's objects after it.
        beside: all else after it.
        time: of the image [s].
    """
    every = [*slots, *(one.slot for one in beside.further)]
    # What was not searched because another camera follows it is searched as soon as that one loses it.
    own = tuple(replace(one, next_search=NEVER) if np.isinf(one.next_search) else one for one in every)
    beside = replace(beside, things=_seen_once_elsewhere(view, entry.things, beside.things))
    before = {one.thing.identity: one.thing.last_seen for one in view.things}
    things = tuple(
        one
        if one.thing.last_seen >= time
        else replace(one, thing=replace(one.thing, last_seen=before.get(one.thing.identity, NEVER)))
        for one in beside.things
    )
    identities = tuple(one.identity for one in beside.further)
    return ViewMemory(own, identities, things, beside.shift, time), beside


def contradicted(
    views: Sequence[ViewMemory], which: int, segments: Segments, every: Sequence[Known]
) -> list[tuple[int, int]]:
    """Return which other camera's slots (camera, slot) the newest image of one camera proves to be wrong.

    Where an object was found by both, too far apart, it is not where this image shows what is behind; turned otherwise
    in the same place, it is not as the camera has it whose odds are shorter.

    Args:
        views: what the cameras remember, the newest image taken in.
        which: whose it is.
        segments: that image taken apart.
        every: the object in each slot.
    """
    own, found = views[which], []
    for k, one in enumerate(own.slots):
        for v, other in enumerate(views):
            if v == which or not (own.follows(k, own.time) and other.follows(k, own.time)):
                continue
            its = other.slots[k]
            if np.linalg.norm(predict(its, own.time)[1] - one.p) > TUNING.apart:
                wrong = emptiness(every[k].model, its, segments) > 0.0
            else:
                symmetric = every[k].model.asset.symmetric_axis == "z" or bool(every[k].model.asset.symmetries)
                wrong = bool(not symmetric and turned(its.R, one.R) > TUNING.turned and one.odds > its.odds)
            if wrong:
                found.append((v, k))
    return found


def forgotten(view: ViewMemory, k: int) -> ViewMemory:
    """Return a camera's memory without what it believes to follow in slot k: what others see is handed to it."""
    slots = list(view.slots)
    slots[k] = replace(slots[k], seen=NEVER, velocity=np.zeros(6))
    return replace(view, slots=tuple(slots))


def all_sides(views: Sequence[ViewMemory], things: Sequence[Remembered]) -> list[Thing]:
    """Return unknown things with the pieces that each camera made of them, as many as a thing may have.

    Args:
        views: what the cameras remember.
        things: as the newest image of any left them.
    """
    found = []
    for k, one in enumerate(things):
        pieces = list(one.thing.pieces)
        for view in views:
            its = view.things[k]
            if its.thing.identity != one.thing.identity or not _stands_as_seen(its, one):
                continue
            new = [piece for piece in its.thing.pieces if not any(np.array_equal(piece, other) for other in pieces)]
            pieces += new if len(pieces) + len(new) <= PIECES else []
        found.append(replace(one.thing, pieces=tuple(pieces)))
    return found


def _of_now(view: ViewMemory, identities: Sequence[int], first: int) -> ViewMemory:
    """Return a camera's memory in which slots that changed hands are empty."""
    slots = list(view.slots)
    for k, (was, now) in enumerate(zip(view.identities, identities, strict=True)):
        if was != now:
            slots[first + k] = Slot()
    return replace(view, slots=tuple(slots), identities=tuple(identities))


def _handed(views: Sequence[ViewMemory], which: int, k: int, time: float) -> tuple[Slot, bool]:
    """Return slot k of a camera, and whether it is what another camera follows."""
    own = views[which].slots[k]
    others = [(view.slots[k].seen, v) for v, view in enumerate(views) if v != which and view.slots[k].known]
    if not others or views[which].follows(k, time):
        return own, False
    seen, v = max(others, key=lambda one: (one[0], -one[1]))
    newest = views[v].slots[k]
    if own.known and seen <= own.seen:
        return own, False
    if views[v].follows(k, time):
        R, p = predict(newest, time)
        # Not lost just now, nor searched: another camera sees where it is.
        here = replace(own, known=True, R=R, p=p, velocity=newest.velocity, seen=NEVER, next_search=np.inf)
        return replace(here, odds=newest.odds, aloft=newest.aloft), True
    there = replace(own, known=True, R=newest.R, p=newest.p, velocity=newest.velocity, seen=newest.seen)
    return replace(there, odds=newest.odds, aloft=newest.aloft), False


def _thing_of(view: ViewMemory, common: Remembered, k: int) -> Remembered:
    """Return an unknown thing as a camera remembers it: its own sides, with what all know."""
    own = view.things[k]
    if not common.thing.identity or own.thing.identity != common.thing.identity:
        return replace(common, empty=0, motion=ShownMotion())
    since = own.empty if view.time > common.thing.last_seen else 0
    if not _stands_as_seen(own, common):
        return replace(common, empty=since, motion=own.motion)
    thing = replace(common.thing, middle=own.thing.middle, pieces=own.thing.pieces)
    mine = replace(common, samples=own.samples, made_at=own.made_at, rested_at=own.rested_at, motion=own.motion)
    return replace(mine, thing=thing, empty=since)


def _stands_as_seen(own: Remembered, common: Remembered) -> bool:
    """Return whether what a camera saw of a thing is not older than its last move."""
    return own.thing.last_seen >= max(common.moved, 0.0)


def _seen_once_elsewhere(
    view: ViewMemory, before: Sequence[Remembered], after: Sequence[Remembered]
) -> tuple[Remembered, ...]:
    """Return things after an image, those kept that another camera's newest image has just brought.

    A thing seen once and never again is none; but it is for the camera that saw it to see it again.
    """
    kept, there = list(after), {one.thing.identity for one in after}
    mine = {one.thing.identity for one in view.things}
    for k, one in enumerate(before):
        who = one.thing.identity
        if not who or who in there or who in mine or one.thing.status != ObjectStatus.UNSEEN:
            continue
        free = [j for j in (k, *range(len(kept))) if not kept[j].thing.identity]
        if free:
            kept[free[0]] = one
    return tuple(kept)
