"""Follows the known objects from image to image: one `step` of the estimator, as pure functions on its `slots`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram import scenario
from twin_diagram.perception.registration.asking import asked, set_apart
from twin_diagram.perception.registration.colour_shift import ColourShift, learnt
from twin_diagram.perception.registration.data_association import Poses
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.global_search import TUNING as GLOBAL_SEARCH
from twin_diagram.perception.registration.global_search import coarse_score, judged, nearby
from twin_diagram.perception.registration.instances import taken
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.naming_evidence import TUNING as EVIDENCE
from twin_diagram.perception.registration.naming_evidence import name_believed, with_name
from twin_diagram.perception.registration.recognition import Aloft, looks_like_itself, recognise
from twin_diagram.perception.registration.registration import RegisteredPose, claimed, label_of
from twin_diagram.perception.registration.shape_search import coloured_after_all, search_by_shape
from twin_diagram.perception.registration.slots import TUNING as SLOTS
from twin_diagram.perception.registration.slots import Slot, carried, measurement, postponed, seen
from twin_diagram.perception.registration.turned_alike import odds_kept
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.perception.registration.where_expected import TUNING as EXPECTED
from twin_diagram.perception.registration.where_expected import (
    believable,
    floats,
    held_by_planes,
    register_where_expected,
    stands_out,
    unmistaken,
)
from twin_diagram.perception.registration.where_held import register_where_held
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import PoseMeasurement

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of losing and finding again, chosen by hand.

    `sims/benchmarks/followed_scenes.py` shows their effect: what is wrong and stays so, and what is found late.
    """

    doubtful: float = 0.7
    """Where less than this share of what fits in shape fits in colour, the pose is doubted: 1 in 200 of those that were
    right, and most of those that lay another way (`sims/benchmarks/followed_scenes.py`, seeds 0 to 5)."""

    whole: float = 0.9
    """And where less than this share of what is seen of it is in place: 1 in 450 of those, and nearly all others."""

    shown: float = 0.4
    """Of what is seen to a smaller share colours tell too little."""

    better: float = 0.15
    """It gives way to a pose that is likelier by so much."""

    fastest: float = 1.2
    """What is carried goes no faster [m/s]: `where_expected`'s largest step at 15 Hz."""

    slipped: float = 0.06
    """An object that was lost just now is looked for among points this far beyond its own radius [m]."""


TUNING = Tuning()


def step(
    library: Sequence[Known],
    slots: Sequence[Slot],
    segments: Segments,
    params: scenario.Registration,
    smallest: int,
    frame: Frame | None = None,
) -> tuple[list[Slot], list[PoseMeasurement], ColourShift]:
    """Find the objects in one image: follow what is tracked, then search for what is not.

    Args:
        library: the known objects.
        slots: one per object.
        segments: the image taken apart.
        params: tuning.
        smallest: points that make an object.
        frame: the image ready for registration; None: it is made so here, with colours on depth's pixels.

    Returns:
        The new slots; one measurement per object, quality 0 where it was not found in this image; how far colours lie
        beside depth, as it is known now.
    """
    time = segments.time
    view = View(segments, frame or Frame.of(segments), params, smallest)
    every = library
    library = [known.bare if slot.by_shape else known for known, slot in zip(every, slots, strict=True)]
    tracked = held_by_planes(library, slots, view, asked(library, slots, follow_known(library, slots, view), view))
    recognised: dict[int, RegisteredPose] = {}
    searched: list[int] = []
    if len(tracked) < len(library):
        free = unexplained_by(library, tracked, segments)
        tracked |= held_by_planes(library, slots, view, regain_lost(library, slots, tracked, view, free))
        searched = [k for k, slot in enumerate(slots) if k not in tracked and due(slot, time)]
        if int(free.sum()) < smallest:
            searched = []
        recognised = search_for(every, slots, searched, view, free, tracked)
    challenged = doubted(slots, tracked, time)
    for k in challenged[:1]:
        whose = _challenge(k, library, slots, tracked, recognised, view)
        if whose is not None:
            searched = [*(j for j in searched if j != whose), whose]
    for k, one in coloured_after_all(every, slots, tracked, view).items():
        recognised[k] = one
        searched.append(k)
        del tracked[k]

    after = _remembered(library, slots, searched, recognised, tracked, challenged, view)
    results = tracked | recognised
    measured = [measurement(slot, results.get(k), time) for k, slot in enumerate(after)]
    # Depth of what moves may be late, which lays its colours aside by more.
    rests = [pose.evidence for k, pose in tracked.items() if not np.any(slots[k].velocity)]
    return after, measured, learnt(view.frame.shift, [one for one in rests if one is not None])


def _remembered(
    library: Sequence[Known],
    slots: Sequence[Slot],
    searched: Sequence[int],
    recognised: Mapping[int, RegisteredPose],
    tracked: Mapping[int, RegisteredPose],
    challenged: Sequence[int],
    view: View,
) -> list[Slot]:
    """Return the slots after an image in which some objects were searched and recognised, others tracked."""
    time, params = view.segments.time, view.params
    after = list(slots)
    for k in searched:
        # How fast it is, a search cannot say, but where it was a moment ago does.
        one = recognised.get(k)
        went_on = one is not None and just_lost(slots[k], time) and aloft(slots[k], time).may_be(one)
        before = slots[k] if went_on else Slot(alike=slots[k].alike, named=slots[k].named)
        if one is not None:
            after[k] = _seen(library[k], before, one, view)
        elif k in challenged or not just_lost(slots[k], time):
            before = replace(slots[k], aloft=slots[k].aloft or taken(library[k].model, slots[k], view.segments))
            after[k] = postponed(before, time, params)
    for k, pose in tracked.items():
        after[k] = _seen(library[k], slots[k], pose, view)
        if doubtful(pose, slots[k].alike):
            was = postponed(slots[k], time, params) if k in challenged[:1] else slots[k]
            after[k] = replace(after[k], next_search=was.next_search, attempts=was.attempts)
    return after


def _seen(known: Known, before: Slot, one: RegisteredPose, view: View) -> Slot:
    return replace(seen(before, one, view.segments.time), aloft=floats(known, view, one))


def follow_known(library: Sequence[Known], slots: Sequence[Slot], view: View) -> dict[int, RegisteredPose]:
    """Register each object that was found before near where it is expected, or where the hand has it, by number."""
    found = {}
    for k, (known, slot) in enumerate(zip(library, slots, strict=True)):
        result = register_where_expected(known, slot, view) if slot.known else None
        if slot.known and result is None:
            result = register_where_held(k, known, slot, view)
        if result is not None:
            found[k] = result
    return found


def unexplained_by(library: Sequence[Known], found: Mapping[int, RegisteredPose], segments: Segments) -> Mask:
    """Return (N,) which of the segments' points belong to none of the objects found."""
    free = np.ones(len(segments.labels), dtype=bool)
    for k, pose in found.items():
        free[claimed(library[k].model, segments, pose.R, pose.p, EXPECTED.owned)] = False
    return free


def regain_lost(
    library: Sequence[Known], slots: Sequence[Slot], found: Mapping[int, RegisteredPose], view: View, free: Mask
) -> dict[int, RegisteredPose]:
    """Look around the last poses of objects that were lost just now.

    Args:
        library: the known objects.
        slots: one per object.
        found: those that were not lost, by number.
        view: the image.
        free: (N,) the segments' points that nothing explains; those of what is regained are taken out.

    Returns:
        What was regained, by the object's number.
    """
    segments = view.segments
    regained = {}
    for k, (known, slot) in enumerate(zip(library, slots, strict=True)):
        if not slot.known or k in found or segments.time - slot.seen > SLOTS.coast:
            continue
        if (result := register_around(known, slot, view, free)) is not None:
            regained[k] = unmistaken(known, view, result, odds_kept(slot.odds, slot.R, result.R))
            free[claimed(known.model, segments, result.R, result.p, EXPECTED.owned)] = False
    return regained


def search_for(
    library: Sequence[Known],
    slots: Sequence[Slot],
    wanted: Sequence[int],
    view: View,
    free: Mask,
    tracked: Mapping[int, RegisteredPose],
) -> dict[int, RegisteredPose]:
    """Search the points that nothing explains for objects of which no pose is known.

    Args:
        library: the known objects.
        slots: one per object.
        wanted: numbers of those that are searched.
        view: the image.
        free: (N,) the segments' points that nothing explains.
        tracked: what was followed, by its number.

    Returns:
        What was recognised, by the object's number.
    """
    time = view.segments.time
    found = recognise(
        {k: library[k].model for k in wanted},
        {k: orientations(library[k], slots[k], time) for k in wanted},
        view.segments,
        view.frame,
        free,
        view.params,
        view.smallest,
        {k: aloft(slots[k], time) for k in wanted if in_the_air(slots[k], time)},
        _rivals(library, wanted),
    )
    apart = set_apart(library, slots, tracked, view) if found else view
    convincing = {
        k: with_name(library[k], apart, one.registration)
        for k, one in found.items()
        if _got_to(library[k], slots[k], view, one.registration)
    }
    ask = view.params.told_by_shape
    believed = {
        k: one for k, one in convincing.items() if carried(slots[k], time) or name_believed(library[k], view, one, ask)
    }
    open_ = [k for k in wanted if k not in believed and not in_the_air(slots[k], time)]
    if open_ and ask:
        left = free & unexplained_by(library, believed, view.segments)
        attempt = min(slots[k].attempts for k in open_)
        believed |= search_by_shape(library, open_, view, left, attempt)
    return {k: one if one.by_shape else unmistaken(library[k], view, one) for k, one in believed.items()}


def _got_to(known: Known, slot: Slot, view: View, one: RegisteredPose) -> bool:
    """Return whether a lost object can be where a search found it, and is: it may be hidden where it was, if not."""
    reached = aloft(slot, view.segments.time).reaches(one) or taken(known.model, slot, view.segments)
    return reached and _convincing(known, slot, view, one)


def _rivals(library: Sequence[Known], wanted: Sequence[int]) -> list[tuple[ModelCloud, Sequence[tuple[Array, float]]]]:
    """Return what is not wanted and has no colours, each of its kind once: there may be one more of it."""
    models = {id(library[k].model): library[k] for k in range(len(library)) if k not in wanted}
    return [(one.model, [*one.upright, *one.fallen]) for one in models.values() if not one.model.coloured]


def _convincing(known: Known, slot: Slot, view: View, one: RegisteredPose) -> bool:
    """Return whether a search is believed: what was seen before must look like itself, not only be of its shape."""
    return stands_out(known, view, one, slot.alike, anew=True) and looks_like_itself(one, slot.alike)


def just_lost(slot: Slot, time: float) -> bool:
    """Return whether an object is lost that was carried in one of the last images."""
    return carried(slot, time) and time - slot.seen <= SLOTS.coast


def due(slot: Slot, time: float) -> bool:
    """Return whether an object that is lost is searched for in this image: in each while it cannot be far off."""
    return time >= slot.next_search or just_lost(slot, time)


def in_the_air(slot: Slot, time: float) -> bool:
    """Return whether this search of an object that is lost looks in the air: all at once, every third later."""
    return carried(slot, time) and (just_lost(slot, time) or slot.attempts % 3 == 0)


def aloft(slot: Slot, time: float) -> Aloft:
    """Return what is known of an object that is looked for in the air."""
    near = max(EXPECTED.largest_step[1], TUNING.fastest * (time - slot.seen)) if slot.known else np.inf
    return Aloft(slot.R, slot.p, slot.alike, near, just_lost(slot, time))


def _challenge(
    k: int,
    library: Sequence[Known],
    slots: Sequence[Slot],
    tracked: dict[int, RegisteredPose],
    recognised: dict[int, RegisteredPose],
    view: View,
) -> int | None:
    """Search object k anew, whose pose is doubtful; what is found goes from `tracked` to `recognised`.

    Returns:
        Whose pose it is, that object's or an alike's; None where nothing fits clearly better.
    """
    free = unexplained_by(library, tracked, view.segments)
    other = challenger(library[k], slots[k], tracked[k], view, free)
    if other is None:
        return None
    whose = _nearest_alike(k, other, library, slots, tracked)
    recognised[whose] = other
    tracked.pop(whose, None)
    return whose


def _nearest_alike(
    k: int, one: RegisteredPose, library: Sequence[Known], slots: Sequence[Slot], found: Mapping[int, RegisteredPose]
) -> int:
    """Return which of those that look like object k a pose is: k, or a lost one that was nearer to it."""
    alikes = [j for j, other in enumerate(library) if other is library[k] and j not in found and slots[j].known]
    return min([k, *alikes], key=lambda j: (float(np.linalg.norm(slots[j].p - one.p)), j != k))


def orientations(known: Known, slot: Slot, time: float) -> list[tuple[Array, float]]:
    """Return how an object may lie where it is searched for: things mostly stand, every other time they lie."""
    if in_the_air(slot, time):
        return []
    if not known.model.coloured:
        return [*known.upright, *known.fallen]  # or else what lies is taken for what stands and is shaped alike
    standing = slot.attempts % 3 - 1 if carried(slot, time) else slot.attempts % 2
    return (known.upright, known.fallen)[standing]


def doubtful(one: RegisteredPose, usual: float) -> bool:
    """Return whether an object's shape is not all there, or its colours are not: it may be another thing."""
    fits = one.shape >= TUNING.whole and one.quality >= TUNING.doubtful * one.shape and looks_like_itself(one, usual)
    return not fits and one.visible_share >= TUNING.shown


def doubted(slots: Sequence[Slot], found: Mapping[int, RegisteredPose], time: float) -> list[int]:
    """Return the numbers of the objects found that should be searched anew, the longest waiting first."""
    due = [k for k, one in found.items() if doubtful(one, slots[k].alike) and time >= slots[k].next_search]
    return sorted(due, key=lambda k: (slots[k].next_search, k))


def challenger(known: Known, slot: Slot, one: RegisteredPose, view: View, free: Mask) -> RegisteredPose | None:
    """Search an object whose pose is doubtful anew; None where nothing fits clearly better.

    It may be in the segment that it was followed in, or among points that nothing explains.

    Args:
        known: the object.
        slot: its memory.
        one: the pose.
        view: the image.
        free: (N,) the segments' points that nothing explains.
    """
    segments, time = view.segments, view.segments.time
    own = claimed(known.model, segments, one.R, one.p, EXPECTED.owned)
    if len(own) < EXPECTED.least_points:
        return None
    label = label_of(segments, own)
    mask = free.copy()
    mask[own] = True
    ways = {0: orientations(known, slot, time)}
    floating = {0: aloft(slot, time)} if in_the_air(slot, time) else None
    least = GLOBAL_SEARCH.hopeless * float(coarse_score(known.model, view.frame, Poses(one.R[None], one.p[None]))[0])
    wanted, image = {0: known.model}, (segments, view.frame, mask)
    found = recognise(wanted, ways, *image, view.params, view.smallest, floating, least=least).get(0)
    points = segments.points_W[segments.labels == label]
    if found is None or found.likeness < one.likeness * judged(known.model, points, one) + TUNING.better:
        return None
    if not _convincing(known, slot, view, found.registration):
        return None
    other = replace(with_name(known, view, found.registration), by_shape=slot.by_shape)
    if other.named is not None and other.named.odds < min(slot.named.odds, EVIDENCE.silent[0]):
        return None  # its outline speaks against it, more than against where it was followed
    return unmistaken(known, view, other, odds_kept(slot.odds, one.R, other.R))


def register_around(known: Known, slot: Slot, view: View, free: Mask) -> RegisteredPose | None:
    """Look around an object's last pose, among points (N,) `free` that nothing else explains."""
    segments = view.segments
    apart = segments.points_W - slot.p
    around = np.flatnonzero(free & (np.einsum("ni,ni->n", apart, apart) < (known.model.radius + TUNING.slipped) ** 2))
    if len(around) < EXPECTED.least_points:
        return None
    found = nearby(
        known.model, view.frame, slot.R, slot.p, segments.points_W[around], segments.normals_W[around], view.params
    )
    if found is None or not believable(found.registration, view.params, slot.R, slot.p):
        return None
    return found.registration if _convincing(known, slot, view, found.registration) else None
