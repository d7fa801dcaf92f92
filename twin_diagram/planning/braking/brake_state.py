"""What the stop monitor remembers from look to look, how that is a vector, and what it tells of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from enum import IntEnum
from functools import cache
from typing import Any, Final

import numpy as np

from twin_diagram.planning.braking.stopping_motion import Rejoin, StraightStop
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER

NOTE_FIELDS: Final = 7
"""Of what is told: time [s], whether it is a brake, `Cause`, link, body, distance [m], speed [rad/s]."""
RING: Final = 32
"""So many of the newest are kept."""
STAMPS: Final = 4
"""So many times are watched: of the arm's message, of a usable one, of an image, of a plan."""


class BrakeMode(IntEnum):
    """What the monitor does with commands."""

    WAIT = 0
    """Nothing is known of the arm yet: commands pass."""
    PASS = 1
    BRAKE = 2
    REJOIN = 3


class Cause(IntEnum):
    """Why the arm is stopped."""

    NONE = 0
    NOT_A_NUMBER = 1
    STALE_STATE = 2
    STALE_SCENE = 3
    HANGING_PLANNER = 4
    JUMP = 5
    CLEARANCE = 6


SENTENCES: Final = {
    Cause.NOT_A_NUMBER: "a command or the arm's state is not a number",
    Cause.STALE_STATE: "no message from the arm",
    Cause.STALE_SCENE: "no image",
    Cause.HANGING_PLANNER: "no new plan",
    Cause.JUMP: "the command jumps",
    Cause.CLEARANCE: "it would not stand before it comes too near",
}
"""For people."""


@dataclass(frozen=True)
class BrakeState:
    """All that is remembered.

    Attributes:
        mode: see `BrakeMode`.
        looked: when it looked last [s].
        command, rate: (n,) what was commanded then, and how fast that changed.
        asked, asked_rate: (n,) the same of what the planner asked for.
        torque: (n,) feed-forward that was last a number [N·m].
        stop_start, stop_time, stop_q0, stop_v0: of the newest stop, see `StraightStop`.
        rejoin_start, rejoin_time, rejoin_offset, rejoin_rate: of the newest `Rejoin`.
        clear: since when nothing stands against going on [s]; `NEVER` while something does.
        began: when the arm was heard first [s].
        brakes: how many there were.
        braked: how long in all that are over [s].
        notes: (RING · NOTE_FIELDS) newest last.
        stamps: (STAMPS) newest times that were told [s]; infinite where nobody tells.
        came: (STAMPS) when these were first seen [s].
    """

    mode: float
    looked: float
    command: Array
    rate: Array
    asked: Array
    asked_rate: Array
    torque: Array
    stop_start: float
    stop_time: float
    stop_q0: Array
    stop_v0: Array
    rejoin_start: float
    rejoin_time: float
    rejoin_offset: Array
    rejoin_rate: Array
    clear: float = NEVER
    began: float = NEVER
    brakes: float = 0.0
    braked: float = 0.0
    notes: Array = field(default_factory=lambda: np.tile([NEVER, *[0.0] * (NOTE_FIELDS - 1)], RING))
    stamps: Array = field(default_factory=lambda: np.full(STAMPS, NEVER))
    came: Array = field(default_factory=lambda: np.full(STAMPS, NEVER))

    @staticmethod
    def initial(q: Array) -> BrakeState:
        """Return the state before anything is known; `q` (n,) is commanded where the planner's is not a number."""
        none = np.zeros(len(q))
        return BrakeState(
            BrakeMode.WAIT, NEVER, q, none, q, none, none, NEVER, 0.0, q, none, NEVER, 1.0, none, none
        )  # fmt: skip

    @property
    def stop(self) -> StraightStop:
        """The newest stop."""
        return StraightStop(self.stop_start, self.stop_q0, self.stop_v0, self.stop_time)

    @property
    def rejoin(self) -> Rejoin:
        """How the plan is joined again."""
        return Rejoin(self.rejoin_start, self.rejoin_time, self.rejoin_offset, self.rejoin_rate)

    def hearing(self, now: float, stamps: Array) -> BrakeState:
        """Return the state once `stamps` (STAMPS) are told at `now` [s]."""
        return replace(self, stamps=stamps, came=np.where(stamps == self.stamps, self.came, now))

    @property
    def newest(self) -> Array:
        """How new what was told is, (STAMPS) [s].

        No newer than when it came: what an arm ahead of a slow loop said last would be new until the loop is there.
        """
        return np.where(np.isinf(self.stamps), np.inf, np.minimum(self.stamps, self.came))

    def noting(self, *row: float) -> Array:
        """Return `notes` with one more."""
        return np.concatenate([self.notes, row])[-RING * NOTE_FIELDS :]

    def pack(self) -> Array:
        """Return the state as a vector."""
        return np.concatenate([np.atleast_1d(getattr(self, each.name)) for each in fields(self)]).astype(float)

    @staticmethod
    def passing(vector: Array, n: int) -> tuple[float, float, Array, Array]:
        """Return mode, time of the last look, what was asked for then and its rate, of a packed vector; views."""
        return float(vector[0]), float(vector[1]), vector[2 + 2 * n : 2 + 3 * n], vector[2 + 3 * n : 2 + 4 * n]

    @staticmethod
    def unpack(vector: Array, n: int) -> BrakeState:
        """Return the inverse of `pack` for n joints; copies."""
        copy = np.array(vector)
        values: list[Any] = [float(copy[at]) if isinstance(at, int) else copy[at] for at in _parts(n)]
        return BrakeState(*values)


@cache
def _parts(n: int) -> tuple[int | slice, ...]:
    """Return where each field of a `BrakeState` stands in a packed one for n joints."""
    parts: list[int | slice] = []
    at = 0
    for each in fields(BrakeState):
        own = {"notes": RING * NOTE_FIELDS, "stamps": STAMPS, "came": STAMPS}
        size = 1 if each.type == "float" else own.get(each.name, n)
        parts.append(at if each.type == "float" else slice(at, at + size))
        at += size
    return tuple(parts)


def told(notes: Array, links: dict[int, str], bodies: Sequence[str]) -> list[dict[str, Any]]:
    """Return what happened, oldest first: when it braked, why and by what; when it went on, and how long it stood [s].

    Args:
        notes: of a `BrakeState`.
        links: names of the arm's links by index.
        bodies: names of what the arm may meet.
    """
    found: list[dict[str, Any]] = []
    for time, brake, cause, link, body, distance, speed in notes.reshape(-1, NOTE_FIELDS).tolist():
        if time == NEVER:
            continue
        if not brake:
            found.append({"time": round(time, 4), "event": "resume", "after_s": round(distance, 4)})
            continue
        entry: dict[str, Any] = {
            "time": round(time, 4),
            "event": "brake",
            "cause": Cause(int(cause)).name.lower(),
            "why": SENTENCES[Cause(int(cause))],
            "speed": round(speed, 4),
        }
        if cause == Cause.CLEARANCE:
            near = {
                "link": links.get(int(link), ""),
                "object": bodies[int(body)],
                "distance_mm": round(1e3 * distance, 1),
            }
            entry |= near
        found.append(entry)
    return found
