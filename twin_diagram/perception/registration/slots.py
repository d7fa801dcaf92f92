"""What tracking remembers of each object, and how an image changes that."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from twin_diagram import scenario
from twin_diagram.perception.registration.naming import NAMING_SIZE, Naming
from twin_diagram.perception.registration.registration import TUNING as REGISTRATION
from twin_diagram.perception.registration.registration import RegisteredPose
from twin_diagram.perception.registration.rotation import exp, from_quaternion, log, to_quaternion
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, POSE_SIZE, PoseMeasurement

SLOT_SIZE: Final = 1 + POSE_SIZE + 6 + 1 + 1 + 1 + 1 + 1 + 1 + 6 + NAMING_SIZE + 1
"""Numbers of a packed `Slot`: known, pose, velocity, seen, next search, attempts, alike, odds, aloft, aside,
naming, by shape."""


@dataclass(frozen=True)
class Tuning:
    """Constants of an object's memory, chosen by hand for images at 15 Hz of objects that people and arms move.

    `sims/closed_loop.py --seeds 20` shows their effect: objects lost, found anew, and the errors in between.
    """

    coast: float = 0.3
    """A velocity is believed for this long [s]."""

    changes: tuple[float, ...] = (0.2, 0.03)
    """How far a moving object goes from one image to the next [rad], [m]: `where_expected.MOVING`."""

    rests: tuple[float, ...] = (0.1, 0.012)
    """Slower than this is standing still [rad/s], [m/s]."""

    told: float = 1.5
    """And slower than so many deviations of a speed that two images tell: without it nine tenths of what stands still
    before a D435 count as moving (`sims/benchmarks/perception_rate.py`, seed 1)."""

    newest: float = 0.6
    """Share of the newest speed in what is remembered."""

    learns: float = 0.1
    """Share of the newest image in how much an object looks like itself."""

    itself: float = 0.6
    """What looks like itself to less than this share of that is not learnt from: `recognition`'s."""

    open: float = 0.4
    """Share of an object that is seen where that is learnt."""

    longest_wait: int = 4
    """A search that keeps failing is repeated after so many search periods."""

    standing: int = 4
    """After so many attempts an object is looked for as it stands, carried or not (`tracking.orientations`)."""

    away: float = 5.0
    """What was carried may be set down anywhere: for so long each search waits for one period only [s]."""


TUNING = Tuning()


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
        alike: how much it looks like itself before this camera, in this light, of what fits in shape; 0: not known.
        odds: logarithm of the odds that it is not one of its turns that leave the shape alike; see `turned_alike`.
        aloft: it was in the air when it was seen last, be it at rest: something holds it.
        aside: (6,) turn and shift from its last pose to the one that the image alone told. Its velocity is of those:
            what a plane begins or ceases to hold has not moved.
        named: how sure it is that it is this object.
        by_shape: shape alone tells it; it is followed without colours.
    """

    known: bool = False
    R: Array = field(default_factory=lambda: np.eye(3))
    p: Array = field(default_factory=lambda: np.zeros(3))
    velocity: Array = field(default_factory=lambda: np.zeros(6))
    seen: float = NEVER
    next_search: float = NEVER
    attempts: int = 0
    alike: float = 0.0
    odds: float = 0.0
    aloft: bool = False
    aside: Array = field(default_factory=lambda: np.zeros(6))
    named: Naming = field(default_factory=Naming)
    by_shape: bool = False

    def pack(self) -> Array:
        """Return the slot as a vector (SLOT_SIZE,)."""
        tail = [self.seen, self.next_search, float(self.attempts), self.alike, self.odds, float(self.aloft)]
        return np.concatenate(
            [
                [float(self.known)],
                to_quaternion(self.R),
                self.p,
                self.velocity,
                tail,
                self.aside,
                self.named.pack(),
                [float(self.by_shape)],
            ]
        )

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
            alike=float(vector[17]),
            odds=float(vector[18]),
            aloft=bool(vector[19] > 0.5),
            aside=vector[20:26].copy(),
            named=Naming.unpack(vector[26:-1]),
            by_shape=bool(vector[-1] > 0.5),
        )


def predict(slot: Slot, time: float) -> tuple[Array, Array]:
    """Return R (3, 3) and p (3,) at `time`, by constant velocity for a short while."""
    ahead = time - slot.seen
    if not 0.0 < ahead <= TUNING.coast:
        return slot.R, slot.p
    return exp(slot.velocity[:3] * ahead) @ slot.R, slot.p + slot.velocity[3:] * ahead


def seen(slot: Slot, result: RegisteredPose, time: float) -> Slot:
    """Return the slot after the object was found; its velocity is not known after an empty slot or a long gap."""
    velocity, alone = np.zeros(6), result.alone or result
    step = time - slot.seen
    if slot.known and 0.0 < step <= TUNING.coast:
        R, p = exp(slot.aside[:3]) @ slot.R, slot.p + slot.aside[3:]
        rate = np.concatenate([log((alone.R @ R.T)[None])[0], alone.p - p]) / step
        # What the image does not tell it did not do: it would be predicted to go on for ever.
        process = np.diag(np.repeat(np.square(TUNING.changes), 3))
        newest = process @ np.linalg.solve(process + alone.covariance, rate)
        velocity = (1.0 - TUNING.newest) * slot.velocity + TUNING.newest * newest
        if stands_still(velocity, alone.covariance, step):
            velocity = np.zeros(6)
    odds = slot.odds if result.odds is None else result.odds
    named = result.named or slot.named
    shape = slot.by_shape if result.by_shape is None else result.by_shape
    return Slot(
        known=True,
        R=result.R,
        p=result.p,
        velocity=velocity,
        seen=time,
        # How much it looks like itself is another figure without colours.
        alike=_alike(slot.alike if shape == slot.by_shape else 0.0, result),
        odds=odds,
        aside=np.concatenate([log((alone.R @ result.R.T)[None])[0], alone.p - result.p]),
        named=named,
        by_shape=shape,
    )


def _alike(before: float, result: RegisteredPose) -> float:
    """Return how much an object looks like itself, from image to image; half hidden it says nothing of that.

    What suddenly looks far less like itself is another thing that it lies on, or a hand before it.
    """
    if result.shape <= 0.0 or result.visible_share < TUNING.open:
        return before
    newest = result.likeness / result.shape
    if newest < TUNING.itself * before:
        return before
    return newest if before == 0.0 else (1.0 - TUNING.learns) * before + TUNING.learns * newest


def stands_still(velocity: Array, covariance: Array, step: float) -> bool:
    """Return whether a velocity (6,) is none that images a `step` [s] apart can tell, whose poses have a covariance."""
    spread = np.diag(covariance)
    told = TUNING.told * TUNING.newest * np.sqrt(2.0 * np.array([spread[:3].sum(), spread[3:].sum()])) / step
    speed = np.linalg.norm(velocity.reshape(2, 3), axis=1)
    return bool(np.all(speed < np.maximum(TUNING.rests, told)))


def carried(slot: Slot, time: float) -> bool:
    """Return whether an object that is lost was moving or held not long ago, and may be in the air."""
    return slot.known and (slot.aloft or bool(np.any(slot.velocity))) and time - slot.seen < TUNING.away


def postponed(slot: Slot, time: float, params: scenario.Registration) -> Slot:
    """Return the slot after a search in vain: the next one waits the longer, the more have failed."""
    attempts = slot.attempts + 1
    longest = 1 if carried(slot, time) else TUNING.longest_wait
    wait = params.search_period * min(max(1, attempts // 2), longest)
    return replace(slot, next_search=time + wait, attempts=attempts)


def sought(slot: Slot, time: float) -> Slot:
    """Return the slot of an object that is looked for at once, standing, as something new stands there."""
    return replace(slot, next_search=min(slot.next_search, time), attempts=TUNING.standing)


def measurement(slot: Slot, result: RegisteredPose | None, time: float) -> PoseMeasurement:
    """Return what goes out: the pose found, or the last one with quality 0."""
    if result is None:
        widest = np.diag(np.repeat(np.square(REGISTRATION.widest), 3))
        return PoseMeasurement(0.0, time, np.concatenate([to_quaternion(slot.R), slot.p]), widest)
    return PoseMeasurement(result.quality, time, np.concatenate([to_quaternion(result.R), result.p]), result.covariance)
