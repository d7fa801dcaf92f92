"""What the twin lacks to do its work, in its own words: messages, images, objects, a way to its goal, time.

A twin that hears and sees nothing reports what it was told, which looks like an estimate. Here it says so. All is read
off its own ports, and every threshold is a number of periods that the scenario gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final, cast

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from twin_diagram import scenario
from twin_diagram.planning.mpc.planner import TUNING as PLANNER
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, TRACK_SIZE, ObjectStatus


@dataclass(frozen=True)
class Tuning:
    """How much is borne before it is said; chosen by hand, in periods of the scenario."""

    messages: float = 20.0
    """Periods of the arm's driver without a message: the filter has long ceased to carry its state on."""

    images: float = 5.0
    """Periods of the camera without an image, beyond its latency."""

    plans: float = 1.0
    """Periods of the planner by which the arm's clock may be ahead of the loop's: beyond, commands are of the past."""

    searches: float = 1.0
    """Searches for joint goals that are made anew before a goal counts as out of reach."""


TUNING = Tuning()

FIELDS: Final = 3
"""Of a row of the port `health`: whether it stands (1 or 0), since when it was so at first, when it last was [s]."""


class Reason(Enum):
    """Kinds of lack, by the words of ``summary.json``."""

    NO_ARM_MESSAGE = "no_arm_message"
    NO_IMAGE = "no_image"
    OBJECT_NOT_SEEN = "object_not_seen"
    GOAL_OUT_OF_REACH = "goal_out_of_reach"
    SLOWER_THAN_REAL_TIME = "slower_than_real_time"
    SLOTS_EXHAUSTED = "slots_exhausted"


@dataclass(frozen=True)
class Lack:
    """One thing that may be wanting.

    Attributes:
        reason: what kind.
        what: whose, or how: for people.
    """

    reason: Reason
    what: str

    def sentence(self, since: float) -> str:
        """Return it for people, without the time at which it is said: one line."""
        words = {
            Reason.NO_ARM_MESSAGE: f"no message from the arm: {self.what}, since {since:.2f} s",
            Reason.NO_IMAGE: f"no image: {self.what}, since {since:.2f} s",
            Reason.OBJECT_NOT_SEEN: f"the camera has not seen {self.what}, in images since {since:.2f} s",
            Reason.GOAL_OUT_OF_REACH: f"the goal is out of reach: {self.what}",
            Reason.SLOTS_EXHAUSTED: f"no slot is free: {self.what}",
            Reason.SLOWER_THAN_REAL_TIME: f"slower than real time: {self.what}",
        }
        return words[self.reason]


def lacks(twin: scenario.Twin) -> tuple[Lack, ...]:
    """Return what may be wanting to a twin, in the order of the port's rows."""
    result = [
        Lack(Reason.NO_ARM_MESSAGE, "none has come"),
        Lack(Reason.NO_ARM_MESSAGE, "they have ceased"),
        Lack(Reason.NO_ARM_MESSAGE, "what comes are no numbers, or absurd ones"),
        Lack(Reason.SLOWER_THAN_REAL_TIME, "the arm's clock is ahead of the loop's"),
    ]
    cameras = twin.perceiving
    if cameras:
        whose = [f" from {name}" if len(cameras) > 1 else "" for name in cameras]
        for one in whose:
            result += [Lack(Reason.NO_IMAGE, f"none has come{one}"), Lack(Reason.NO_IMAGE, f"they have ceased{one}")]
        result += [Lack(Reason.OBJECT_NOT_SEEN, name) for name in twin.library]
        instances, unknown = max(twin.slots.instances, len(twin.library)), twin.slots.unknown
        result.append(Lack(Reason.SLOTS_EXHAUSTED, f"another object of the library beside {instances} is seen unnamed"))
        result.append(Lack(Reason.SLOTS_EXHAUSTED, f"an unknown thing beside {unknown} is not kept clear of"))
    if twin.task.X_WG is not None:
        tool, where = twin.arm.tool_frame or "the tool", ", ".join(f"{x:g}" for x in twin.task.X_WG.translation)
        result.append(
            Lack(Reason.GOAL_OUT_OF_REACH, f"no joint positions found that bring {tool} to ({where}) m as asked")
        )
    return tuple(result)


@dataclass(frozen=True)
class Patience:
    """How long each kind of lack is borne [s]."""

    message: float
    usable: float
    images: tuple[float, ...]
    unseen: float
    behind: float
    goal: float

    @staticmethod
    def of(twin: scenario.Twin) -> Patience:
        """Return what follows from a twin's periods."""
        return Patience(
            message=TUNING.messages / twin.driver.rate,
            usable=TUNING.messages / twin.driver.rate + 1.0 / twin.filter.rate,
            images=tuple(camera.latency + TUNING.images / camera.rate for camera in twin.perceiving.values()),
            unseen=twin.scene.lost_after,
            behind=TUNING.plans / twin.planner.rate,
            goal=TUNING.searches * PLANNER.retry + 2 * twin.planner.route_after + 2.0 / twin.planner.rate,
        )


def ceased(now: float, newest: float, patience: float, began: float = 0.0) -> list[float]:
    """Return since when no message has come at all, and since when they have ceased; infinity where that is not so.

    Args:
        now: time [s].
        newest: of the newest message [s]; `NEVER` before the first.
        patience: how long is waited [s].
        began: when the clock began [s].
    """
    silent = now - max(newest, began) > patience
    never = newest < 0.0
    return [began if silent and never else np.inf, newest if silent and not never else np.inf]


def noted(rows: Array, since: Array, now: float) -> Array:
    """Return rows (c, FIELDS) with what is so now noted.

    Args:
        rows: as they were.
        since: (c,) since when each has been so [s]; infinity where it is not.
        now: time [s].
    """
    stands = np.isfinite(since)
    after = rows.copy()
    after[:, 0] = stands
    after[:, 1] = np.where(stands & (rows[:, 1] < 0.0), since, rows[:, 1])
    after[:, 2] = np.where(stands, now, rows[:, 2])
    return after


def told(rows: Array, each: Sequence[Lack]) -> list[dict[str, Any]]:
    """Return what was ever wanting, for ``summary.json``: reason, what, first and last [s], in order of time."""
    found = [
        {
            "reason": lack.reason.value,
            "what": lack.what,
            "first": round(float(row[1]), 4),
            "last": round(float(row[2]), 4),
        }
        for lack, row in zip(each, rows, strict=True)
        if row[1] >= 0.0
    ]
    return sorted(found, key=lambda entry: float(cast(float, entry["first"])))


class HealthMonitor(LeafSystem):
    """Says when the twin is blind, deaf, late, or asked for what cannot be.

    .. pydrake_system::

        name: HealthMonitor
        input_ports:
        - measurement_time
        - message_time (optional)
        - image_time (optional)
        - <camera>.image_time (optional)
        - tracks (optional)
        - reach (optional)
        - turned_away (optional)
        output_ports:
        - health

    Ports:
        measurement_time: (1) of the arm's newest message [s], `NEVER` before the first.
        message_time: (1) of the newest message that the filter could use [s], `NEVER` before the first.
        image_time: (1) of the newest image [s], `NEVER` before the first.
        <camera>.image_time: (1) the same of each camera, where the twin looks through several.
        tracks: (K · TRACK_SIZE) a `layouts.Track` per library object.
        reach: (1) of a planner: 0 where it found no joint positions for its goal, above 0 where it did, `NEVER` where
            it has none. A planner without such a port may leave it open.
        turned_away: (2) further instances and unknown things in the newest image for which no slot was free.
        health: (c · FIELDS) for each of `lacks` whether it stands, since when it was so at first and when it last was
            [s], `NEVER` where it was not.

    Rate: `scene.rate`. Latency: one period and how long it is borne, see `Patience`; the time told is that of the last
    message or image, not when it was missed. One from ahead of the loop, as of an arm before a slow loop, counts from
    when it was seen. State: the rows, then when the first image was taken, since when the goal is not reached, when the
    clock began, each input's newest time, and when that was first seen [s].
    """

    def __init__(self, twin: scenario.Twin) -> None:
        """Size the ports; `twin` as it is told."""
        super().__init__()
        self.lacks: Final = lacks(twin)
        self._patience: Final = Patience.of(twin)
        self._sees: Final = bool(twin.perceiving)
        self._objects: Final = len(twin.library) if self._sees else 0
        self._wants: Final = twin.task.X_WG is not None
        self._arm = self.DeclareVectorInputPort("measurement_time", 1)
        self._usable = self.DeclareVectorInputPort("message_time", 1)
        names = list(twin.perceiving) if len(twin.perceiving) > 1 else []
        own = [f"{name}.image_time" for name in names] or ["image_time"]
        self._images = [self.DeclareVectorInputPort(name, 1) for name in own]
        self._tracks = self.DeclareVectorInputPort("tracks", TRACK_SIZE * len(twin.library))
        self._reach = self.DeclareVectorInputPort("reach", 1)
        self._away = self.DeclareVectorInputPort("turned_away", 2)
        size = FIELDS * len(self.lacks)
        self._size: Final = size
        start = np.tile([0.0, NEVER, NEVER], len(self.lacks))
        stamps = np.full(2 * (2 + len(self._images)), NEVER)
        state = self.DeclareDiscreteState(cast(Any, np.concatenate([start, [NEVER, NEVER, 0.0], stamps])))
        self.DeclareInitializationDiscreteUpdateEvent(self._begin)
        self.DeclarePeriodicDiscreteUpdateEvent(1.0 / twin.scene.rate, 0.0, self._update)

        def calc(context: Context, output: BasicVector) -> None:
            output.SetFromVector(cast(Any, np.asarray(context.get_discrete_state_vector().value())[:size]))

        self.DeclareVectorOutputPort("health", size, calc, prerequisites_of_calc={self.discrete_state_ticket(state)})

    def told(self, context: Context) -> list[dict[str, Any]]:
        """Return what was ever wanting, see `told`."""
        return told(self._rows(context), self.lacks)

    def standing(self, context: Context) -> list[tuple[Lack, float]]:
        """Return what is wanting now, and since when it was so at first [s]."""
        return [(lack, float(row[1])) for lack, row in zip(self.lacks, self._rows(context), strict=True) if row[0]]

    def _rows(self, context: Context) -> Array:
        return np.asarray(context.get_discrete_state_vector().value())[: self._size].reshape(-1, FIELDS)

    def _begin(self, context: Context, discrete: DiscreteValues) -> None:
        """Keep the time at which a simulator begins, which may be any."""
        state = np.array(context.get_discrete_state_vector().value())
        state[self._size + 2] = context.get_time()
        discrete.set_value(cast(Any, state))

    def _update(self, context: Context, discrete: DiscreteValues) -> None:
        now, patience = context.get_time(), self._patience
        first_image, missed, began, *before = context.get_discrete_state_vector().value()[self._size :]
        stamps, (told, seen) = self._stamps(context), np.split(np.array(before), 2)
        came = np.where(stamps == told, seen, now)
        newest, usable, *images = np.minimum(stamps, came)
        silent = ceased(now, newest, patience.message, began)
        useless = np.inf
        if self._usable.HasValue(context) and not np.isfinite(silent).any():
            useless = min(ceased(now, usable, patience.usable, began))
        since = [*silent, useless, now if stamps[0] - now > patience.behind else np.inf]
        if self._sees:
            for one, borne in zip(images, patience.images, strict=True):
                since += ceased(now, one, borne, began)
            image = max(stamps[2:])
            first_image = image if first_image < 0.0 else first_image
            tracks = cast(Array, self._tracks.Eval(context)).reshape(-1, TRACK_SIZE)
            looked = first_image >= 0.0 and image - first_image > patience.unseen
            since += [first_image if looked and track[0] == ObjectStatus.UNSEEN else np.inf for track in tracks]
            away = cast(Array, self._away.Eval(context)) if self._away.HasValue(context) else np.zeros(2)
            since += [now if count > 0 else np.inf for count in away]
        if self._wants:
            there = self._reach.HasValue(context)
            lost = there and float(cast(Array, self._reach.Eval(context))[0]) == 0.0
            missed = (now if missed < 0.0 else missed) if lost else NEVER
            since.append(missed if lost and now - missed > patience.goal else np.inf)
        rows = noted(self._rows(context), np.array(since), now)
        kept = [first_image, missed, began, *stamps, *came]
        discrete.set_value(cast(Any, np.concatenate([rows.ravel(), kept])))

    def _stamps(self, context: Context) -> Array:
        """Return the newest times (2 + cameras) of the arm's messages, of what could be used, and of images [s]."""
        told = np.full(2 + len(self._images), NEVER)
        for k, port in enumerate((self._arm, self._usable, *(self._images if self._sees else ()))):
            if port is not self._usable or port.HasValue(context):
                told[k] = cast(Array, port.Eval(context))[0]
        return told
