"""Finds objects by their shape alone, in what stands on the table and their colours do not tell.

Each thing is compared with all objects of the library of its height, colours left out. It is the one that its shape
speaks for, if no other is nearly as likely: a grey can may be either of two.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.perception.registration.global_search import search
from twin_diagram.perception.registration.height import TUNING as HEIGHT
from twin_diagram.perception.registration.height import as_tall, extent
from twin_diagram.perception.registration.naming_evidence import TUNING as NAMING
from twin_diagram.perception.registration.naming_evidence import colours_speak, naming
from twin_diagram.perception.registration.registration import RegisteredPose, claimed, register
from twin_diagram.perception.registration.settling import settle
from twin_diagram.perception.registration.slots import Slot
from twin_diagram.perception.registration.turned_alike import unweighed
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.perception.registration.where_expected import TUNING as EXPECTED

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants, set on rendered sequences of grey, repainted and stretched things, whose truth is known."""

    fewest: int = 100
    """Points of a thing of whose shape enough is seen."""

    free: float = 0.8
    """A thing of which less than this share is free belongs to what was found already."""

    score: float = 0.88
    """What explains less is not settled and asked for its name: 106 of 107 right finds had more, of others a third."""

    pause: int = 2
    """After the first search only one of so many looks for shapes, at one thing: it takes as long as all tracking."""

    thin: int = 150
    """Points of a thing that weigh its poses."""

    ahead: float = 1.8
    """It is none where another object's odds are not shorter by this [nat]."""


TUNING = Tuning()


def search_by_shape(
    library: Sequence[Known], wanted: Collection[int], view: View, free: Mask, attempt: int = 0
) -> dict[int, RegisteredPose]:
    """Return which objects are told by shape alone among points that nothing explains, by number.

    Args:
        library: the known objects; those that are not wanted are compared with, too.
        wanted: numbers of those that may be found.
        view: the image.
        free: (N,) the segments' points that nothing explains.
        attempt: how often it was searched before: at first all things are tried that stand there, then one by one.
    """
    later, rest = divmod(attempt, TUNING.pause)
    things = _standing(view, free) if rest == 0 else []
    if attempt and things:
        things = [things[later % len(things)]]
    kinds = {id(known): k for k, known in reversed(list(enumerate(library)))}
    found: dict[int, RegisteredPose] = {}
    for own, top in things:
        tried = {k: _tried(library[k].bare, view, own, top) for k in kinds.values()}
        ranked = sorted((-one.named.odds, k) for k, one in tried.items() if one is not None and one.named is not None)
        if not ranked or ranked[0][0] >= 0.0 or (len(ranked) > 1 and ranked[1][0] < ranked[0][0] + TUNING.ahead):
            continue
        kind = ranked[0][1]
        best = tried[kind]
        k = next((k for k in wanted if library[k] is library[kind] and k not in found), None)
        if best is not None and k is not None:
            found[k] = _with_colours(library[k], view, own, best)
    return found


def _with_colours(known: Known, view: View, own: npt.NDArray[np.int64], one: RegisteredPose) -> RegisteredPose:
    """Return a find with its colours, of all its turns, where those speak for it; else it is told by shape."""
    model, points = known.model, view.segments.points_W[own]
    thin = points[:: max(1, len(points) // TUNING.thin)]
    start = register(model, view.frame, one.R, one.p, view.params, points_W=thin)
    result = settle(model, view.frame, [start], thin, view.params, turns=True).registration
    if model.coloured and colours_speak(known, result) > 0.0:
        return replace(result, named=naming(known, view, result), by_shape=False)
    return replace(one, by_shape=True)


def coloured_after_all(
    library: Sequence[Known], slots: Sequence[Slot], tracked: Mapping[int, RegisteredPose], view: View
) -> dict[int, RegisteredPose]:
    """Return poses of an object that was told by shape, and for which colours speak by now, by number; mostly none.

    What a hand hid comes into the open, and how far colours lie beside depth is learnt: until then they may be silent
    about what is painted as its asset is, and which way round it lies is a guess.

    Args:
        library: the known objects, with their colours.
        slots: one per object.
        tracked: what was followed in this image, by number.
        view: the image.
    """
    time, period = view.segments.time, view.params.search_period
    for k, one in tracked.items():
        slot = slots[k]
        again = slot.by_shape and int(time / period) != int(slot.seen / period)
        if not again or one.visible_share < NAMING.shown or not library[k].model.coloured:
            continue
        own = claimed(library[k].model, view.segments, one.R, one.p, EXPECTED.owned)
        if len(own) < TUNING.fewest:
            continue
        found = _with_colours(library[k], view, own, one)
        if not found.by_shape:
            return {k: found}
    return {}


def _standing(view: View, free: Mask) -> list[tuple[npt.NDArray[np.int64], float]]:
    """Return the points of each segment that is free and stands on the table, and how high it is [m]."""
    segments = view.segments
    result = []
    for label in range(segments.count):
        whole = np.flatnonzero(segments.labels == label)
        own = whole[free[whole]]
        if len(own) < max(TUNING.fewest, view.smallest) or len(own) < TUNING.free * len(whole):
            continue
        low, top = extent(segments.points_W[own], segments.table)
        if low < HEIGHT.stands:
            result.append((own, top))
    return result


def _tried(bare: Known, view: View, own: npt.NDArray[np.int64], top: float) -> RegisteredPose | None:
    """Return an object as it fits a thing's points `own` best, `top` [m] high, with how sure its name is."""
    ways = as_tall(bare.model, (*bare.upright, *bare.fallen), top)
    points = view.segments.points_W[own]
    found = search(bare.model, view.frame, points, ways, view.params) if ways else None
    if found is None or found.score < TUNING.score:
        return None
    thin = points[:: max(1, len(points) // TUNING.thin)]
    settled = settle(bare.model, view.frame, [found.registration, *found.others], thin, view.params, turns=True)
    one = unweighed(bare.model, settled.registration)
    return replace(one, named=naming(bare, view, one))
