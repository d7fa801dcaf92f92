"""What running a task remembers from tick to tick, and how that is a vector."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from itertools import accumulate, pairwise
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from twin_diagram import scenario
from twin_diagram.planning.tasks.in_hand import IN_HAND_SIZE, InHand
from twin_diagram.planning.tasks.tool_past import PAST_SIZE, no_past
from twin_diagram.scenario import poses
from twin_diagram.scenario.task_steps import KINDS
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import HAND_SIZE, NOTHING, Hand
from twin_diagram.signals.layouts import NEVER, POSE_SIZE


class Phase(IntEnum):
    """What a step is at."""

    START = 0
    """Not begun."""
    MOVE = 1
    """`reach`: on the way."""
    FOLLOW = 2
    WAIT = 3
    """`follow`: at rest, for what it follows is not seen."""
    HOLD = 4
    LOOK = 5
    """`pick`: at rest with open fingers, until the object is seen …"""
    APPROACH = 6
    DESCEND = 7
    CLOSE = 8
    LIFT = 9
    CARRY = 10
    """`place`: to above its place …"""
    LOWER = 11
    OPEN = 12
    RETREAT = 13
    REST = 14
    """The task is over."""


class TaskOutcome(IntEnum):
    """How the task stands."""

    RUNNING = 0
    DONE = 1
    FAILED = 2


class Why(IntEnum):
    """Why a step was tried again, waits or has failed."""

    NONE = 0
    TIME_LIMIT = 1
    OUT_OF_REACH = 2
    NOT_SEEN = 3
    TARGET_LOST = 4
    TOO_WIDE = 5
    MISSED = 6
    DROPPED = 7
    SEEN_ELSEWHERE = 8
    NO_WAY_DOWN = 9
    NO_WAY = 10
    NOT_WHERE_PUT = 11
    NO_SUPPORT = 12
    NO_STAND = 13


SENTENCES: Final = {
    Why.NONE: "",
    Why.TIME_LIMIT: "not done within its time limit",
    Why.OUT_OF_REACH: "no joint positions found that reach it",
    Why.NOT_SEEN: "the object has not been seen",
    Why.TARGET_LOST: "the object is not seen any more",
    Why.TOO_WIDE: "no grasp: too wide for the fingers from above, and no rim, neck or handle that they can come at",
    Why.MISSED: "the fingers closed on nothing",
    Why.DROPPED: "the fingers closed fully on what they held: it is lost",
    Why.SEEN_ELSEWHERE: "what was held is seen elsewhere: it is lost",
    Why.NO_WAY: "the hand found no way to this grasp",
    Why.NOT_WHERE_PUT: "once let go it is seen elsewhere than where it was put: it fell, or rolled away",
    Why.NO_SUPPORT: "what it is to stand upon is not seen, or not seen at rest",
    Why.NO_STAND: "it would not stand there: what it is to stand upon lies otherwise, and does not bear its middle",
    Why.NO_WAY_DOWN: "something is in the way from above it down to the grasp",
}
"""Each of `Why`, for people."""

FOR_WANT_OF_A_WAY: Final = frozenset(SENTENCES[why] for why in (Why.TIME_LIMIT, Why.NO_WAY))
"""Those behind which there may be that no way led to a step's goal: what was in the way is told behind them."""


class Note(IntEnum):
    """What is told of a step."""

    STARTED = 1
    TRIED_AGAIN = 2
    GRASPED = 3
    RELEASED = 4
    WAITS = 5
    RESUMED = 6
    DONE = 7
    FAILED = 8
    SLIPPED = 9
    """What is held has moved in the hand; told once a slip, with by how much."""
    OTHER_GRASP = 10
    """No way led to a grasp, and the next is gone for."""


RING: Final = 32
"""So many of the newest notes are kept."""
NOTE_FIELDS: Final = 6
"""Of a note: time [s] (`NEVER` where empty), number of the step, `Note`, `Why`, and by how much what is held
slipped [rad], [m]."""


@dataclass(frozen=True)
class Step:
    """A step as it is run; fields as in `scenario.TaskStep`.

    Attributes:
        kind: see `task_steps.KINDS`.
        target: number of its object in the library, or `NOTHING`.
        goal: (7) pose, zeros where there is none.
        support: number of the object that a `place` puts its own upon, or `NOTHING`.
    """

    kind: str
    target: int
    goal: Array
    position_tolerance: float
    rotation_tolerance: float
    time_limit: float
    seconds: float
    tries: int
    force: float
    support: int = NOTHING


def steps_of(task: scenario.Task, names: Sequence[str]) -> tuple[Step, ...]:
    """Return the steps of a task that was checked; `names` of the library's objects, in order."""
    result: list[Step] = []
    target = NOTHING
    for each in task.steps:
        if each.kind in ("pick", "follow"):
            number = names.index(each.object)
            target = number if each.kind == "pick" else target
        else:
            number = target if each.kind == "place" else NOTHING
        goal = np.zeros(POSE_SIZE)
        if each.goal is not None:
            X = poses.pose(each.goal)
            goal = np.concatenate([X.rotation().ToQuaternion().wxyz(), X.translation()])
        assert each.kind in KINDS
        result.append(
            Step(
                each.kind,
                number,
                goal,
                each.position_tolerance,
                each.rotation_tolerance,
                each.time_limit,
                each.seconds,
                each.tries,
                each.force,
                names.index(each.upon) if each.upon else NOTHING,
            )
        )
    return tuple(result)


NUMBERS: Final = 13
"""Of a packed `TaskState`, before its poses."""


@dataclass(frozen=True)
class After:
    """Where the arm goes after the goal that it has.

    Attributes:
        goal: (7) X_WG of the tool; zeros: it is not known.
        hand: what is held on the way there.
        pause: the arm stays so long before it goes there, once it is where it is to be now [s].
    """

    goal: Array = field(default_factory=lambda: np.zeros(POSE_SIZE))
    hand: Hand = field(default_factory=Hand)
    pause: float = 0.0

    def pack(self) -> Array:
        """Return it as a vector of `AFTER_SIZE`."""
        return np.concatenate([self.goal, self.hand.pack(), [self.pause]])

    @staticmethod
    def unpack(vector: Array) -> After:
        """Return the inverse of `pack`; copies."""
        return After(vector[:POSE_SIZE].copy(), Hand.unpack(vector[POSE_SIZE:-1]), float(vector[-1]))


AFTER_SIZE: Final = POSE_SIZE + HAND_SIZE + 1
"""Numbers of a packed `After`."""


@dataclass(frozen=True)
class TaskState:
    """All that is remembered.

    Attributes:
        step: number of the step; as many as there are once all are done.
        phase, outcome, why: see there; `why` of the newest failure or retry.
        begun: when the step began [s].
        since: when the phase began [s].
        steady: since when the phase has been as it should be at its end [s]; `NEVER`: it is not.
        attempt: how often a pick was tried before.
        others: how many grasps of this try were left for the next, because no way led to them.
        elsewhere: images running that showed what is held elsewhere.
        image: time of the newest image that was counted [s].
        opened: share of the fingers' travel that they are to be opened by; negative: as described.
        force: greatest force of the fingers [N]; NaN: as described.
        goal: (7) X_WG of the tool, zeros: stay.
        grasp: (7) X_WG of a pick, or the last pose of a place.
        hand: what is held or may be touched.
        lies: where what is held lies in the hand, or what was held last.
        past: (PAST_SIZE) where the tool was of late, while something is held; see `tool_past`.
        notes: (RING · NOTE_FIELDS) newest last.
        after: where the arm goes after `goal`, see `goal_after`.
        stood: (4) quaternion in W of what is held, or was held last, where it was taken.
    """

    step: int = 0
    phase: Phase = Phase.START
    outcome: TaskOutcome = TaskOutcome.RUNNING
    why: Why = Why.NONE
    begun: float = NEVER
    since: float = NEVER
    steady: float = NEVER
    attempt: int = 0
    elsewhere: int = 0
    image: float = NEVER
    opened: float = -1.0
    force: float = float("nan")
    others: int = 0
    goal: Array = field(default_factory=lambda: np.zeros(POSE_SIZE))
    grasp: Array = field(default_factory=lambda: np.zeros(POSE_SIZE))
    hand: Hand = field(default_factory=Hand)
    lies: InHand = field(default_factory=InHand)
    past: Array = field(default_factory=no_past)
    notes: Array = field(default_factory=lambda: np.tile([NEVER, *[0.0] * (NOTE_FIELDS - 1)], RING))
    after: After = field(default_factory=After)
    stood: Array = field(default_factory=lambda: np.array([1.0, 0, 0, 0]))

    def entering(self, phase: Phase, now: float, goal: Array | None = None) -> TaskState:
        """Return the state at the begin of a phase; `goal` (7), None: stay."""
        at = np.zeros(POSE_SIZE) if goal is None else goal
        return replace(self, phase=phase, since=now, steady=NEVER, goal=at)

    def noting(self, note: Note, now: float, why: Why = Why.NONE, by: tuple[float, float] = (0.0, 0.0)) -> TaskState:
        """Return the state with something told of the present step; `by` how much [rad], [m]."""
        rows = np.concatenate([self.notes, [now, float(self.step), float(note), float(why), *by]])
        return replace(self, notes=rows[-RING * NOTE_FIELDS :])

    def pack(self) -> Array:
        """Return it as a vector of `STATE_SIZE`."""
        numbers = [
            self.step, self.phase, self.outcome, self.why, self.begun, self.since, self.steady, self.attempt,
            self.elsewhere, self.image, self.opened, self.force, self.others,
        ]  # fmt: skip
        first = [np.array(numbers, dtype=float), self.goal, self.grasp, self.hand.pack()]
        return np.concatenate([*first, self.lies.pack(), self.past, self.notes, self.after.pack(), self.stood])

    @staticmethod
    def unpack(vector: Array) -> TaskState:
        """Return the inverse of `pack`; copies."""
        copy = np.array(vector)
        numbers, goal, grasp, hand, lies, past, notes, after, stood = (copy[part] for part in _PARTS)
        step, phase, outcome, why, begun, since, steady, attempt, elsewhere, *rest = numbers.tolist()
        image, opened, force, others = rest
        return TaskState(
            int(step), Phase(int(phase)), TaskOutcome(int(outcome)), Why(int(why)), begun, since, steady, int(attempt),
            int(elsewhere), image, opened, force, int(others), goal, grasp, Hand.unpack(hand), InHand.unpack(lies),
            past, notes, After.unpack(after), stood,
        )  # fmt: skip


_PARTS: Final = tuple(
    slice(*ends)
    for ends in pairwise(
        accumulate(
            (0, NUMBERS, POSE_SIZE, POSE_SIZE, HAND_SIZE, IN_HAND_SIZE, PAST_SIZE, RING * NOTE_FIELDS, AFTER_SIZE, 4)
        )
    )
)
"""Of a packed `TaskState`: numbers, goal, grasp, hand, lies, past, notes, after, stood."""
TOLD: Final = MappingProxyType(
    {
        "goal": _PARTS[1],
        "gripper_force_limit": slice(11, 12),
        "step": slice(0, 1),
        "hand": _PARTS[3],
        "notes": _PARTS[6],
        "next_goal": slice(_PARTS[7].start, _PARTS[7].start + POSE_SIZE),
        "next_hand": slice(_PARTS[7].start + POSE_SIZE, _PARTS[7].stop - 1),
        "next_pause": slice(_PARTS[7].stop - 1, _PARTS[7].stop),
    }
)
"""Where in a packed `TaskState` stands what goes out as it is, by the port's name."""
OPENED: Final = 10
"""Where `TaskState.opened` stands in a packed one."""
OUTCOME: Final = (2, 3, 1)
"""Where `outcome`, `why` and `phase` stand."""
STATE_SIZE: Final = _PARTS[-1].stop
"""Numbers of a packed `TaskState`."""


def told(notes: Array, steps: Sequence[scenario.TaskStep]) -> list[dict[str, Any]]:
    """Return what is told of steps, oldest first: time [s], event, step, kind, object, what, by how much, and why."""
    result = []
    for time, number, note, why, turned, moved in notes.reshape(-1, NOTE_FIELDS).tolist():
        if time < 0.0:
            continue
        step = steps[int(number)]
        entry: dict[str, Any] = {"time": round(time, 4), "event": "step", "step": int(number), "kind": step.kind}
        if step.object:
            entry["object"] = step.object
        entry["what"] = Note(int(note)).name.lower()
        if Note(int(note)) is Note.SLIPPED:
            entry |= {"by_mm": round(1e3 * moved, 1), "by_deg": round(float(np.degrees(turned)), 1)}
        if int(why):
            entry["why"] = SENTENCES[Why(int(why))]
        result.append(entry)
    return result
