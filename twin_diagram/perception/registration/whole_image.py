"""One image, all of it: the library's objects, further instances of them, and what no library knows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from twin_diagram import scenario
from twin_diagram.errors import TwinError
from twin_diagram.perception.registration.colour_shift import ALIGNED, COLOUR_SHIFT_SIZE, ColourShift
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.instances import (
    INSTANCE_SIZE,
    Instance,
    recognised,
    settled,
)
from twin_diagram.perception.registration.instances import (
    TUNING as INSTANCES,
)
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.slots import Slot, measurement, seen, sought
from twin_diagram.perception.registration.tracking import step
from twin_diagram.perception.registration.turned_alike import unweighed
from twin_diagram.perception.registration.view import Known
from twin_diagram.perception.registration.where_held import seen_empty, where_held
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.things import memory as things
from twin_diagram.perception.things.clusters import Placed, clusters, unexplained
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, ObjectStatus, PoseMeasurement
from twin_diagram.signals.things import FURTHER_MEASUREMENT_SIZE, OWNER_SIZE, THING_SIZE

HEAD: Final = 4 + COLOUR_SHIFT_SIZE
"""Numbers before the slots: next identities of an instance and of a thing; instances and things turned away; the
colours' shift."""

ARRIVING: Final = (ObjectStatus.UNSEEN, ObjectStatus.MOVING)
"""What a thing was that has come to rest: seen once, or on its way."""

_FREE: Final = Instance().pack()
"""A slot without an instance: what is to be read of it is known without reading, …"""

_NOTHING: Final = things.Remembered().pack()
"""… as it is of one without a thing."""


@dataclass(frozen=True)
class ImageSettings:
    """What does not change from image to image.

    Attributes:
        library: the known objects.
        registration: tuning.
        smallest: points that make an object.
        slots: how many there are, and how long they are kept.
        life: when things are stale and lost.
        aside: how far off depth colours may lie, RMS [px].
        added: assets that came later; their numbers follow the library's. Which of them count, slots say: see
            `introduced`.
    """

    library: tuple[Known, ...]
    registration: scenario.Registration
    smallest: int
    slots: scenario.Slots
    life: things.Life
    aside: float = 0.0
    added: tuple[Known, ...] = ()

    @property
    def every(self) -> tuple[Known, ...]:
        """All objects by their numbers."""
        return (*self.library, *self.added)

    @property
    def further(self) -> int:
        """Slots for further instances, beside the first of each object."""
        return self.slots.further(len(self.library))


@dataclass(frozen=True)
class OtherMemory:
    """What is remembered beside the first instance of each of the library's objects.

    Attributes:
        further: slots of further instances.
        things: slots of unknown things.
        identities: the next one of an instance, and of a thing.
        turned_away: instances and things for which there was no slot in the newest image.
        shift: how far colours lie beside depth.
    """

    further: tuple[Instance, ...]
    things: tuple[things.Remembered, ...]
    identities: tuple[int, int] = (1, 1)
    turned_away: tuple[int, int] = (0, 0)
    shift: ColourShift = ALIGNED

    @staticmethod
    def empty(told: ImageSettings) -> OtherMemory:
        """Return it before the first image."""
        instances, unknown = (Instance(),) * told.further, (things.Remembered(),) * told.slots.unknown
        return OtherMemory(instances, unknown, shift=ColourShift.told(told.aside))

    def pack(self) -> Array:
        """Return it as a vector."""
        parts = [np.array([*self.identities, *self.turned_away], dtype=float), self.shift.pack()]
        # Most slots are free, and what is free is all alike.
        parts += [one.pack() if one.identity else _FREE for one in self.further]
        parts += [one.pack() if one.thing.identity else _NOTHING for one in self.things]
        return np.concatenate(parts)

    @staticmethod
    def unpack(vector: Array, told: ImageSettings) -> OtherMemory:
        """Return the inverse of `pack`."""
        a, b, c, d = (int(x) for x in vector[: HEAD - COLOUR_SHIFT_SIZE])
        shift = ColourShift.unpack(vector[HEAD - COLOUR_SHIFT_SIZE : HEAD])
        end = HEAD + INSTANCE_SIZE * told.further
        rows, more = vector[HEAD:end].reshape(-1, INSTANCE_SIZE), vector[end:].reshape(-1, things.MEMORY_SIZE)
        further = tuple(Instance.unpack(row) if row[0] else Instance() for row in rows)
        unknown = tuple(things.Remembered.unpack(row) if row[0] else things.Remembered() for row in more)
        return OtherMemory(further, unknown, (a, b), (c, d), shift)


@dataclass(frozen=True)
class Outcome:
    """What an image made of everything.

    Attributes:
        slots: of the library's objects.
        beside: all else that is remembered.
        poses: of the library's objects: (K) measurements; where a place was seen empty, the quality is negative.
        further: (F · FURTHER_MEASUREMENT_SIZE) of further instances.
        things: (T · THING_SIZE) of unknown things.
    """

    slots: list[Slot]
    beside: OtherMemory
    poses: list[PoseMeasurement]
    further: Array
    things: Array


def advance(
    slots: Sequence[Slot],
    beside: OtherMemory,
    segments: Segments,
    told: ImageSettings,
    elsewhere: Sequence[Placed] = (),
) -> Outcome:
    """Take an image in.

    Args:
        slots: of the library's objects, in order.
        beside: all else that is remembered.
        segments: the image taken apart.
        told: what does not change.
        elsewhere: known objects that another camera sees: what is in their places is no unknown thing.
    """
    first, every = len(slots), told.every
    held = [k for k, one in enumerate(beside.further) if one.identity]
    assets = [*range(first), *(beside.further[k].asset for k in held)]
    library = [every[a] for a in assets]
    before = [*slots, *(beside.further[k].slot for k in held)]
    frame = Frame.of(segments, beside.shift)
    after, measured, shift = step(library, before, segments, told.registration, told.smallest, frame=frame)
    after, measured = settled(assets, [one.model.radius for one in every], before, after, measured)
    known: list[Placed] = [*elsewhere, *where_held(segments.held, library, measured)]
    for k, one in enumerate(measured):
        if one.quality > 0:
            known.append((library[k].model, after[k].R, after[k].p))
        elif after[k].known:
            measured[k] = replace(one, quality=-seen_empty(k, library[k], after[k], segments))

    pool = _Pool([*beside.further], np.zeros((told.further, FURTHER_MEASUREMENT_SIZE)), beside.identities[0])
    for k, slot, one in zip(held, after[first:], measured[first:], strict=True):
        pool.keep(k, _kept(pool.slots[k], slot, one, told.slots.forget_after), one)
    found = clusters(segments, unexplained(segments, known))
    observed = things.observe(beside.things, segments, found, known, beside.identities[1], told.life)
    remembered = list(observed.slots)
    if told.further:
        named = [*range(first), *(first + j for j, k in enumerate(held) if beside.further[k].own)]
        usual = {assets[k]: after[k].alike for k in named if measured[k].quality > 0}
        among = {assets[k]: library[k] for k in named}
        waiting = [k for k in observed.cluster_of if segments.time >= remembered[k].next_search]
        if waiting:
            k, now = min(waiting, key=lambda k: (remembered[k].searches, k)), replace(frame, shift=shift)
            of = found[observed.cluster_of[k]]
            remembered[k], asset, pose = _compared(remembered[k], of, segments, told, among, usual, now)
            if pose is not None:
                pose = unweighed(among[asset].model, pose)
                if not _found_again(asset, pose, among[asset].model.radius, after, measured, first, pool):
                    pool.take_in(asset, pose, segments.time)
    if _came_to_rest(beside.things, remembered):
        after = [slot if one.quality > 0 else sought(slot, one.time) for slot, one in zip(after, measured, strict=True)]
    identities, turned_away = (pool.next_identity, observed.next_identity), (pool.turned_away, observed.turned_away)
    return Outcome(
        after[:first],
        OtherMemory(tuple(pool.slots), tuple(remembered), identities, turned_away, shift),
        measured[:first],
        pool.rows.ravel(),
        np.concatenate([np.zeros(0), *(one.thing.pack() for one in remembered)]),
    )


@dataclass
class _Pool:
    """Slots of further instances while an image is taken in.

    Attributes:
        slots: of instances.
        rows: (F, FURTHER_MEASUREMENT_SIZE) what goes out.
        next_identity: of the next new instance.
        turned_away: new instances that found no slot.
    """

    slots: list[Instance]
    rows: Array
    next_identity: int
    turned_away: int = 0

    def keep(self, k: int, instance: Instance, one: PoseMeasurement) -> None:
        """Put an instance into slot k, with what was measured of it."""
        self.slots[k] = instance
        if instance.identity:
            self.rows[k] = [instance.identity, instance.asset, *one.pack()]

    def take_in(self, asset: int, pose: RegisteredPose, time: float) -> None:
        """Give a new instance of an asset a slot; without one it stays an unknown thing, nameless but kept clear of."""
        free = next((k for k, one in enumerate(self.slots) if not one.identity), None)
        if free is None:
            self.turned_away += 1
            return
        slot = seen(Slot(), pose, time)
        self.keep(free, Instance(self.next_identity, asset, NEVER, slot), measurement(slot, pose, time))
        self.next_identity += 1


def _came_to_rest(before: Sequence[things.Remembered], after: Sequence[things.Remembered]) -> bool:
    """Return whether a thing that nobody knows is new in its place: it may be one of those that are looked for."""
    rests = ObjectStatus.TRACKED
    return any(
        now.thing.status == rests and (then.thing.identity != now.thing.identity or then.thing.status in ARRIVING)
        for then, now in zip(before, after, strict=True)
    )


def _compared(
    thing: things.Remembered,
    of: npt.NDArray[np.int64],
    segments: Segments,
    told: ImageSettings,
    among: Mapping[int, Known],
    usual: Mapping[int, float],
    frame: Frame,
) -> tuple[things.Remembered, int, RegisteredPose | None]:
    """Compare a thing, which points `of` show, with known objects; return it, which one it is (-1: none), and where."""
    asset, pose, searches = recognised(
        among, of, thing.searches, segments, told.registration, told.smallest, usual, frame
    )
    wait = segments.time + INSTANCES.again if searches < 0 else NEVER
    return replace(thing, searches=max(searches, 0), next_search=wait), asset, pose


def _found_again(
    asset: int,
    pose: RegisteredPose,
    radius: float,
    after: list[Slot],
    measured: list[PoseMeasurement],
    first: int,
    pool: _Pool,
) -> bool:
    """Give what was recognised where one of its kind was lost to that one; return whether there is such a one."""
    place = INSTANCES.same_place * radius
    now = measured[0].time if measured else NEVER

    def lost_here(one: PoseMeasurement, slot: Slot) -> bool:
        return one.quality <= 0.0 and slot.known and bool(np.linalg.norm(slot.p - pose.p) < place)

    if asset < first and lost_here(measured[asset], after[asset]):
        after[asset] = seen(after[asset], pose, now)
        measured[asset] = measurement(after[asset], pose, now)
        return True
    for k, one in enumerate(pool.slots):
        quality = PoseMeasurement.unpack(pool.rows[k][OWNER_SIZE:])
        if one.identity and one.asset == asset and lost_here(quality, one.slot):
            slot = seen(one.slot, pose, now)
            pool.keep(k, replace(one, gone_since=NEVER, slot=slot), measurement(slot, pose, now))
            return True
    return False


def _kept(instance: Instance, slot: Slot, one: PoseMeasurement, forget_after: float) -> Instance:
    """Return a further instance after an image; its slot is free once its place has been empty for long enough."""
    if one.quality >= 0.0:
        return replace(instance, slot=slot, gone_since=NEVER if one.quality > 0.0 else instance.gone_since)
    since = instance.gone_since if instance.gone_since >= 0.0 else one.time
    forgotten = one.time - since > forget_after and not instance.own
    return Instance() if forgotten else replace(instance, slot=slot, gone_since=since)


def introduced(beside: OtherMemory, asset: int, slot: Slot) -> OtherMemory:
    """Return a memory in which the first instance of an asset that came later has a slot; it is looked for from now on.

    Args:
        beside: what is remembered.
        asset: its number, after the library's; one that has a slot already keeps it.
        slot: what is known of where it is; an empty one: nothing.

    Raises:
        TwinError: no slot is free.
    """
    if any(one.identity and one.own and one.asset == asset for one in beside.further):
        return beside
    free = next((k for k, one in enumerate(beside.further) if not one.identity), None)
    if free is None:
        raise TwinError(
            f"no slot is free for another asset: all {len(beside.further)} beside the library's are taken; "
            f"give the twin more (twin.slots.instances)"
        )
    identity, thing = beside.identities
    further = list(beside.further)
    further[free] = Instance(identity, asset, NEVER, slot, own=True)
    return replace(beside, further=tuple(further), identities=(identity + 1, thing))


def sizes(told: ImageSettings) -> tuple[int, int]:
    """Return how many numbers the ports `further_poses` and `things` have."""
    return told.further * FURTHER_MEASUREMENT_SIZE, told.slots.unknown * THING_SIZE
