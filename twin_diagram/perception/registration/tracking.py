"""Follows the known objects from image to image: the estimator's memory and one step of it, as pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from twin_diagram import scenario
from twin_diagram.perception.registration.frame import Frame
from twin_diagram.perception.registration.global_search import nearby, resting
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.recognition import recognise
from twin_diagram.perception.registration.registration import (
    TUNING as REGISTRATION,
)
from twin_diagram.perception.registration.registration import (
    Registration,
    claimed,
    information,
    register,
)
from twin_diagram.perception.registration.rotation import exp, from_quaternion, log, to_quaternion
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, POSE_SIZE, PoseMeasurement

SLOT_SIZE: Final = 1 + POSE_SIZE + 6 + 1 + 1 + 1


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    least_visible: float = 0.12
    """An object of which less can be seen counts as hidden."""

    least_points: int = 30

    largest_step: tuple[float, ...] = (0.7, 0.08)
    """From one image to the next no object turns or moves farther than this [rad], [m]."""

    coast: float = 0.3
    """A velocity is believed for this long [s]."""

    rests: tuple[float, ...] = (0.1, 0.012)
    """Slower than this is standing still [rad/s], [m/s]."""

    thin: int = 120
    """Image points that pull on an object that is followed."""

    owned: float = 0.012
    """Points this near to an object's surface are its own [m]."""

    longest_wait: int = 4
    """A search that keeps failing is repeated after so many search periods."""


TUNING = Tuning()


MOVING: Final = information(0.2, 0.03)
"""How well the next pose of an object that moves is known."""
RESTING: Final = information(0.03, 0.005)
"""And of one that stands still. Nearly hidden, it is held where it was; in the open, the image has far more to say."""


@dataclass(frozen=True)
class Slot:
    """What is remembered of one object.

    Attributes:
        known: it has been found at least once.
        R: (3, 3) last R_WO.
        p: (3,) last p_WO [m].
        velocity: (6,) angular [rad/s], linear [m/s] in W.
        seen: capture time of the last image in which it was found [s].
        next_search: when to look for it anew [s].
        attempts: searches since it was last seen.
    """

    known: bool = False
    R: Array = field(default_factory=lambda: np.eye(3))
    p: Array = field(default_factory=lambda: np.zeros(3))
    velocity: Array = field(default_factory=lambda: np.zeros(6))
    seen: float = NEVER
    next_search: float = NEVER
    attempts: int = 0

    def pack(self) -> Array:
        """As a vector of `SLOT_SIZE`."""
        tail = [self.seen, self.next_search, float(self.attempts)]
        return np.concatenate([[float(self.known)], to_quaternion(self.R), self.p, self.velocity, tail])

    @staticmethod
    def unpack(vector: Array) -> Slot:
        """Return the inverse of `pack`."""
        return Slot(
            known=bool(vector[0] > 0.5),
            R=from_quaternion(vector[1:5]),
            p=vector[5:8].copy(),
            velocity=vector[8:14].copy(),
            seen=float(vector[14]),
            next_search=float(vector[15]),
            attempts=int(vector[16]),
        )


@dataclass(frozen=True)
class Known:
    """An object of the library, ready to be found: its model and the orientations in which it rests."""

    model: ModelCloud
    upright: list[tuple[Array, float]]
    fallen: list[tuple[Array, float]]

    @staticmethod
    def of(model: ModelCloud) -> Known:
        """From a model."""
        orientations = resting(model.asset)
        return Known(model, orientations[:1], orientations[1:])


def predict(slot: Slot, time: float) -> tuple[Array, Array]:
    """R (3, 3) and p (3,) at `time`, by constant velocity for a short while."""
    ahead = time - slot.seen
    if not 0.0 < ahead <= TUNING.coast:
        return slot.R, slot.p
    return exp(slot.velocity[:3] * ahead) @ slot.R, slot.p + slot.velocity[3:] * ahead


def believable(result: Registration, params: scenario.Registration, R: Array, p: Array) -> bool:
    """Return whether a registration is the object, near where it must be, and not a guess from a few pixels."""
    return bool(
        result.quality >= params.minimum_quality
        and result.visible_share >= TUNING.least_visible
        and result.points >= TUNING.least_points
        and np.linalg.norm(result.p - p) <= TUNING.largest_step[1]
        and np.linalg.norm(log((result.R @ R.T)[None])) <= TUNING.largest_step[0]
    )


def follow(
    known: Known, slot: Slot, segments: Segments, frame: Frame, params: scenario.Registration
) -> Registration | None:
    """Register an object near where it is expected; None where it is not to be seen there."""
    moves = bool(np.any(slot.velocity))
    guesses = [(*predict(slot, segments.time), MOVING if moves else RESTING)]
    if moves:
        guesses.append((slot.R, slot.p, MOVING))
    for R, p, prior in guesses:
        thin = segments.points_W[claimed(known.model, segments, R, p, params.reach, TUNING.thin)]
        result = register(known.model, frame, R, p, params, prior=prior, points_W=thin)
        if believable(result, params, R, p):
            return result
    return None


def regain(
    known: Known,
    slot: Slot,
    segments: Segments,
    frame: Frame,
    free: npt.NDArray[np.bool_],
    params: scenario.Registration,
) -> Registration | None:
    """Look around an object's last pose, among points that nothing else explains."""
    apart = segments.points_W - slot.p
    around = np.flatnonzero(free & (np.einsum("ni,ni->n", apart, apart) < (known.model.radius + 0.06) ** 2))
    if len(around) < TUNING.least_points:
        return None
    found = nearby(known.model, frame, slot.R, slot.p, segments.points_W[around], params)
    if found is None or not believable(found.registration, params, slot.R, slot.p):
        return None
    return found.registration


def seen(slot: Slot, result: Registration, time: float) -> Slot:
    """Return the slot after the object was found; its velocity is not known after an empty slot or a long gap."""
    velocity = np.zeros(6)
    step = time - slot.seen
    if slot.known and 0.0 < step <= TUNING.coast:
        rate = np.concatenate([log((result.R @ slot.R.T)[None])[0], result.p - slot.p]) / step
        velocity = 0.4 * slot.velocity + 0.6 * rate
        if np.linalg.norm(velocity[:3]) < TUNING.rests[0] and np.linalg.norm(velocity[3:]) < TUNING.rests[1]:
            velocity = np.zeros(6)
    return Slot(True, result.R, result.p, velocity, time, NEVER, 0)


def measurement(slot: Slot, result: Registration | None, time: float) -> PoseMeasurement:
    """Return what goes out: the pose found, or the last one with quality 0."""
    if result is None:
        widest = np.diag(np.repeat(np.square(REGISTRATION.widest), 3))
        return PoseMeasurement(0.0, time, np.concatenate([to_quaternion(slot.R), slot.p]), widest)
    return PoseMeasurement(result.quality, time, np.concatenate([to_quaternion(result.R), result.p]), result.covariance)


def step(
    library: Sequence[Known],
    slots: Sequence[Slot],
    segments: Segments,
    params: scenario.Registration,
    smallest: int,
) -> tuple[list[Slot], list[PoseMeasurement]]:
    """Return one image: follows what is tracked, then searches for what is not.

    Args:
        library: the known objects.
        slots: one per object.
        segments: the image taken apart.
        params: tuning.
        smallest: points that make an object.

    Returns:
        The new slots, and one measurement per object; quality 0 where it was not found in this image.
    """
    time = segments.time
    frame = Frame.of(segments)
    results: list[Registration | None] = [None] * len(library)
    after = list(slots)
    for k, (known, slot) in enumerate(zip(library, slots, strict=True)):
        if slot.known:
            results[k] = follow(known, slot, segments, frame, params)
    if all(result is not None for result in results):
        return _told(after, slots, results, time)

    free = np.ones(len(segments.labels), dtype=bool)

    def take(k: int) -> None:
        result = results[k]
        if result is not None:
            free[claimed(library[k].model, segments, result.R, result.p, TUNING.owned)] = False

    for k in range(len(library)):
        take(k)
    for k, (known, slot) in enumerate(zip(library, slots, strict=True)):
        if slot.known and results[k] is None and time - slot.seen <= TUNING.coast:
            results[k] = regain(known, slot, segments, frame, free, params)
            take(k)

    wanted = [k for k in range(len(library)) if results[k] is None and time >= after[k].next_search]
    if wanted and int(free.sum()) >= smallest:
        found = recognise(
            {k: library[k].model for k in wanted},
            # Things mostly stand: every other search tries the other orientations.
            {k: library[k].upright if after[k].attempts % 2 == 0 else library[k].fallen for k in wanted},
            segments,
            frame,
            free,
            params,
            smallest,
        )
        for k in wanted:
            if k in found:
                results[k] = found[k].registration
                # How fast it is, a search cannot say.
                slots = [*slots[:k], Slot(), *slots[k + 1 :]]
            else:
                attempts = after[k].attempts + 1
                wait = params.search_period * min(max(1, attempts // 2), TUNING.longest_wait)
                after[k] = replace(after[k], next_search=time + wait, attempts=attempts)
    return _told(after, slots, results, time)


def _told(
    after: list[Slot], before: Sequence[Slot], results: Sequence[Registration | None], time: float
) -> tuple[list[Slot], list[PoseMeasurement]]:
    """Remembers what was found."""
    for k, result in enumerate(results):
        if result is not None:
            after[k] = seen(before[k], result, time)
    return after, [measurement(slot, result, time) for slot, result in zip(after, results, strict=True)]
