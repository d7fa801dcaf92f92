"""Follows the known objects from image to image: one `step` of the estimator, as pure functions on its `slots`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from twin_diagram import scenario
from twin_diagram.perception.registration.alternatives import TUNING as ALTERNATIVES
from twin_diagram.perception.registration.alternatives import compare, votes, weak_directions
from twin_diagram.perception.registration.assessment import assess
from twin_diagram.perception.registration.colour_shift import ALIGNED, ColourShift, learnt
from twin_diagram.perception.registration.data_association import Poses, look
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.global_search import nearby, resting
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.point_kernels import COARSE, FINE
from twin_diagram.perception.registration.recognition import recognise
from twin_diagram.perception.registration.registration import (
    RegisteredPose,
    claimed,
    information,
    register,
)
from twin_diagram.perception.registration.rotation import log
from twin_diagram.perception.registration.slots import TUNING as SLOTS
from twin_diagram.perception.registration.slots import Slot, measurement, postponed, predict, seen
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import PoseMeasurement

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of tracking, chosen by hand for images at 15 Hz of objects that people and arms move.

    `sims/closed_loop.py --seeds 20` shows their effect: objects lost, found anew, and the errors in between.
    """

    least_visible: float = 0.12
    """An object of which less can be seen counts as hidden."""

    least_points: int = 30
    """A registration on fewer model points is a guess."""

    largest_step: tuple[float, ...] = (0.7, 0.08)
    """From one image to the next no object turns or moves farther than this [rad], [m]."""

    stays: tuple[float, ...] = (0.2, 0.02)
    """Within this of where it is expected, an object is believed by its shape alone [rad], [m]."""

    thin: int = 120
    """Image points that pull on an object that is followed."""

    owned: float = 0.012
    """Points this near to an object's surface are its own [m]."""

    rough: float = 0.01
    """Slack of surfaces at a pose that is a guess [m]: a third of a step at half a metre a second."""

    turned: float = 0.07
    """A smaller turn from image to image is found again from either side [rad]."""

    coloured: float = 0.8
    """Where less than this share of what fits in shape fits in colour, too, it may have turned."""

    turning: float = 0.8
    """Share of a turn, in units that weigh alike, in a direction that counts as one."""

    turned_by: tuple[float, ...] = (-0.4, -0.2, 0.2, 0.4)
    """Then turns by so much are tried [rad]: registration finds back from about 0.12."""

    around: float = 0.02
    """Points this near to an object's surface weigh its poses against one another [m]."""

    slipped: float = 0.06
    """An object that was lost just now is looked for among points this far beyond its own radius [m]."""


TUNING = Tuning()


MOVING: Final = information(0.2, 0.03)
"""How well the next pose of an object that moves is known."""
RESTING: Final = information(0.03, 0.005)
"""And of one that stands still. Nearly hidden, it is held where it was; in the open, the image has far more to say."""


@dataclass(frozen=True)
class Known:
    """An object of the library, ready to be found: its model and the orientations in which it rests."""

    model: ModelCloud
    upright: list[tuple[Array, float]]
    fallen: list[tuple[Array, float]]

    @staticmethod
    def of(model: ModelCloud) -> Known:
        """Return a model with the orientations in which it rests."""
        orientations = resting(model.asset)
        return Known(model, orientations[:1], orientations[1:])


@dataclass(frozen=True)
class View:
    """One image and what it is searched with.

    Attributes:
        segments: the image taken apart.
        frame: the same image, ready for registration.
        params: tuning.
        smallest: points that make an object.
    """

    segments: Segments
    frame: Frame
    params: scenario.Registration
    smallest: int


def step(
    library: Sequence[Known],
    slots: Sequence[Slot],
    segments: Segments,
    params: scenario.Registration,
    smallest: int,
    shift: ColourShift = ALIGNED,
) -> tuple[list[Slot], list[PoseMeasurement], ColourShift]:
    """Find the objects in one image: follow what is tracked, then search for what is not.

    Args:
        library: the known objects.
        slots: one per object.
        segments: the image taken apart.
        params: tuning.
        smallest: points that make an object.
        shift: how far colours lie beside depth, as far as that is known.

    Returns:
        The new slots; one measurement per object, quality 0 where it was not found in this image; the shift as it is
        known now.
    """
    time = segments.time
    view = View(segments, Frame.of(segments, shift), params, smallest)
    tracked = follow_known(library, slots, view)
    recognised: dict[int, RegisteredPose] = {}
    searched: list[int] = []
    if len(tracked) < len(library):
        free = unexplained_by(library, tracked, segments)
        tracked |= regain_lost(library, slots, tracked, view, free)
        searched = [k for k, slot in enumerate(slots) if k not in tracked and time >= slot.next_search]
        if int(free.sum()) < smallest:
            searched = []
        recognised = search_for(library, slots, searched, view, free)

    after = list(slots)
    for k in searched:
        # How fast it is, a search cannot say.
        after[k] = seen(Slot(), recognised[k], time) if k in recognised else postponed(slots[k], time, params)
    for k, pose in tracked.items():
        after[k] = seen(slots[k], pose, time)
    results = tracked | recognised
    measured = [measurement(slot, results.get(k), time) for k, slot in enumerate(after)]
    # Depth of what moves may be late, which lays its colours aside by more.
    rests = [pose.evidence for k, pose in tracked.items() if not np.any(slots[k].velocity)]
    return after, measured, learnt(shift, [one for one in rests if one is not None])


def follow_known(library: Sequence[Known], slots: Sequence[Slot], view: View) -> dict[int, RegisteredPose]:
    """Register each object that was found before near where it is expected; return those found, by number."""
    found = {}
    for k, (known, slot) in enumerate(zip(library, slots, strict=True)):
        result = register_where_expected(known, slot, view) if slot.known else None
        if result is not None:
            found[k] = result
    return found


def unexplained_by(library: Sequence[Known], found: Mapping[int, RegisteredPose], segments: Segments) -> Mask:
    """Return (N,) which of the segments' points belong to none of the objects found."""
    free = np.ones(len(segments.labels), dtype=bool)
    for k, pose in found.items():
        free[claimed(library[k].model, segments, pose.R, pose.p, TUNING.owned)] = False
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
        result = register_around(known, slot, view, free)
        if result is not None:
            regained[k] = result
            free[claimed(known.model, segments, result.R, result.p, TUNING.owned)] = False
    return regained


def search_for(
    library: Sequence[Known], slots: Sequence[Slot], wanted: Sequence[int], view: View, free: Mask
) -> dict[int, RegisteredPose]:
    """Search the points that nothing explains for objects of which no pose is known.

    Args:
        library: the known objects.
        slots: one per object.
        wanted: numbers of those that are searched.
        view: the image.
        free: (N,) the segments' points that nothing explains.

    Returns:
        What was recognised, by the object's number.
    """
    found = recognise(
        {k: library[k].model for k in wanted},
        # Things mostly stand: every other search tries the other orientations.
        {k: library[k].upright if slots[k].attempts % 2 == 0 else library[k].fallen for k in wanted},
        view.segments,
        view.frame,
        free,
        view.params,
        view.smallest,
    )
    return {k: one.registration for k, one in found.items()}


def register_where_expected(known: Known, slot: Slot, view: View) -> RegisteredPose | None:
    """Register an object near where it is expected; None where it is not to be seen there.

    What moves goes on, stops, or stops turning. Where the shape fits and the colours do not, it may have turned about
    an axis that the shape does not tell: then turns about it are registered, too. The image tells the likeliest.
    """
    time = view.segments.time
    R, p = predict(slot, time)
    if not np.any(slot.velocity):
        best = _registered(known, view, R, p, RESTING)
    elif _turns(slot, time):
        found = [_registered(known, view, *at, MOVING) for at in ((R, p), (slot.R, slot.p), (slot.R, p))]
        best = likeliest(known, view, [one for one in found if one is not None])
    else:
        best = _goes_on_or_stops(known, slot, view, R, p)
    if best is None or best.quality >= TUNING.coloured * best.shape:
        return best
    turned = [_registered(known, view, *at, MOVING) for at in turns(known, view, best)]
    return likeliest(known, view, [best, *(one for one in turned if one is not None)])


def _goes_on_or_stops(known: Known, slot: Slot, view: View, R: Array, p: Array) -> RegisteredPose | None:
    """Register an object where it is expected (R, p), or where it was: first at that of which the image shows more."""
    starts = Poses(np.stack([R, slot.R]), np.stack([p, slot.p]))
    fits = assess(known.model, view.frame, starts, view.params.model_points, COARSE, TUNING.rough).points
    for k in np.argsort(-fits, kind="stable"):
        result = _registered(known, view, starts.R[k], starts.p[k], MOVING)
        if result is not None:
            return result
    return None


def turns(known: Known, view: View, one: RegisteredPose) -> list[tuple[Array, Array]]:
    """Return poses turned to both sides about the axis, through the object's middle, that its shape tells least of."""
    pose = Poses(one.R[None], one.p[None])
    looked = look(known.model, view.frame, pose, view.params.model_points, FINE)
    for way, _ in weak_directions(looked, view.frame, votes(looked, view.frame, known.model.spacing), 0.0):
        if np.linalg.norm(way[:3]) > TUNING.turning:
            steps = np.array(TUNING.turned_by)[:, None] * (way / np.linalg.norm(way[:3]))
            # Units of turns and shifts differ; see `alternatives`.
            steps[:, 3:] *= ALTERNATIVES.unit[1] / ALTERNATIVES.unit[0]
            R, p = np.repeat(one.R[None], len(steps), axis=0), np.repeat(one.p[None], len(steps), axis=0)
            moved = Poses(R, p).moved(steps)
            return list(zip(moved.R, moved.p, strict=True))
    return []


def likeliest(known: Known, view: View, results: Sequence[RegisteredPose]) -> RegisteredPose | None:
    """Return which of registered poses the image says is the likeliest; None of none."""
    if len(results) < 2:
        return results[0] if results else None
    segments = view.segments
    own = claimed(known.model, segments, results[0].R, results[0].p, TUNING.around)
    poses = Poses(np.stack([one.R for one in results]), np.stack([one.p for one in results]))
    cost = compare(known.model, view.frame, poses, segments.points_W[own], FINE)
    return results[int(np.argmin(cost))]


def _turns(slot: Slot, time: float) -> bool:
    """Return whether an object is expected to have turned by more than registration finds back."""
    return float(np.linalg.norm(slot.velocity[:3])) * (time - slot.seen) > TUNING.turned


def _registered(known: Known, view: View, R: Array, p: Array, prior: Array) -> RegisteredPose | None:
    """Register an object from a guess; None where what comes of it is not believable."""
    thin = view.segments.points_W[claimed(known.model, view.segments, R, p, view.params.reach, TUNING.thin)]
    result = register(known.model, view.frame, R, p, view.params, prior=prior, points_W=thin)
    return result if believable(result, view.params, R, p) else None


def register_around(known: Known, slot: Slot, view: View, free: Mask) -> RegisteredPose | None:
    """Look around an object's last pose, among points (N,) `free` that nothing else explains."""
    segments = view.segments
    apart = segments.points_W - slot.p
    around = np.flatnonzero(free & (np.einsum("ni,ni->n", apart, apart) < (known.model.radius + TUNING.slipped) ** 2))
    if len(around) < TUNING.least_points:
        return None
    found = nearby(
        known.model, view.frame, slot.R, slot.p, segments.points_W[around], segments.normals_W[around], view.params
    )
    if found is None or not believable(found.registration, view.params, slot.R, slot.p):
        return None
    return found.registration


def believable(result: RegisteredPose, params: scenario.Registration, R: Array, p: Array) -> bool:
    """Return whether a registration is the object, near where it must be, and not a guess from a few pixels.

    Where the shape is there, as it should be, colours that are not (a dim light, a camera of colours a few pixels
    aside) do not matter; what is elsewhere must look like the object.
    """
    shift = float(np.linalg.norm(result.p - p))
    turn = float(np.linalg.norm(log((result.R @ R.T)[None])))
    stays = shift <= TUNING.stays[1] and turn <= TUNING.stays[0]
    fits = max(result.quality, result.shape if stays else 0.0)
    return bool(
        fits >= params.minimum_quality
        and result.visible_share >= TUNING.least_visible
        and result.points >= TUNING.least_points
        and shift <= TUNING.largest_step[1]
        and turn <= TUNING.largest_step[0]
    )
