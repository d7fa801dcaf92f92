"""A world for steps alone: the tool is where it is told to be a tick later, and one object lies about."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from twin_diagram.planning.tasks.standing_beside import StandingBeside
from twin_diagram.planning.tasks.step_state import Phase, Step, TaskOutcome, TaskState
from twin_diagram.planning.tasks.step_view import StepView, Takeable
from twin_diagram.planning.tasks.transitions import advance
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, ObjectStatus, PoseMeasurement, Track
from twin_diagram.signals.pose_vectors import compose, inverse
from twin_diagram.signals.things import Thing

TICK = 1 / 30
BOX = np.array([[x, y, z] for x in (-0.02, 0.02) for y in (-0.03, 0.03) for z in (-0.05, 0.05)])
"""Corners of a box that the fingers can take either way."""
DOWN = np.array([0.0, 1.0, 0.0, 0.0])
COVARIANCE = np.diag([1e-4, 2e-4, 3e-4, 1e-6, 4e-6, 9e-6])


def pose(x: float, y: float, z: float, q: Array | None = None) -> Array:
    return np.array([*(np.array([1.0, 0, 0, 0]) if q is None else q), x, y, z])


def post(x: float, y: float, radius: float, top: float) -> Array:
    """Return corners of a round post on the ground."""
    turns = 2 * np.pi * np.arange(24) / 24
    ring = np.stack([x + radius * np.cos(turns), y + radius * np.sin(turns)], axis=1)
    return np.concatenate([np.column_stack([ring, np.full(24, z)]) for z in (0.0, top)])


def step(kind: str, goal: Array | None = None, target: int = -1, **fields: float) -> Step:
    at = np.zeros(7) if goal is None else goal
    plain = Step(kind, 0 if kind in ("pick", "place", "follow") else target, at, 0.01, 0.1, 20.0, 1.0, 2, 30.0)
    return replace(plain, **fields)  # type: ignore[arg-type]


@dataclass
class SmallWorld:
    """Holds what is true; `tick` shows it to the steps and moves the tool and the fingers as they say."""

    steps: tuple[Step, ...]
    X_WO: Array = field(default_factory=lambda: pose(0.5, 0.1, 0.05))
    library: tuple[Takeable, ...] = (Takeable((BOX,), False),)
    status: ObjectStatus = ObjectStatus.TRACKED
    sticks: bool = True  # whether the fingers get hold of it
    reach: float = 3.0
    X_WT: Array = field(default_factory=lambda: pose(0.3, 0.0, 0.4, DOWN))
    opening: float = 0.02
    speed: float = 0.0
    now: float = 0.0
    seen_at: Array | None = None  # where images show it, if not where it is
    frozen: bool = False  # the tool does not move
    late: float = 0.0  # age of images [s]
    stuck: float = 1.0  # the fingers open no wider [m]
    state: TaskState = field(default_factory=TaskState)
    phases: list[Phase] = field(default_factory=list)
    in_hand: Array | None = None
    others: tuple[Array, ...] = ()  # where the library's other objects stand
    beside: ObjectStatus = ObjectStatus.TRACKED  # how those are seen
    unknown: tuple[Array, ...] = ()  # corners in W of what no library knows

    def tick(self) -> TaskState:
        widest = 0.08
        shown = self.X_WO if self.seen_at is None else self.seen_at
        measured = PoseMeasurement(1.0, self.now - self.late, shown, 1e-6 * np.eye(6))
        track = Track(self.status, self.now, self.X_WO, np.zeros(6), COVARIANCE)
        beside = [Track(self.beside, self.now, X, np.zeros(6), COVARIANCE) for X in self.others]
        before = self.opening
        self.opening = self._squeezed(widest)
        seen = StepView(
            self.now, self.X_WT, self.speed, [track, *beside], [measured] * len(self.library),
            self.opening, abs(self.opening - before) / TICK, widest, self.reach if self.state.goal.any() else NEVER,
            beside=StandingBeside(further=np.zeros(0), things=self._things(), pieces=()),
        )  # fmt: skip
        self.state = advance(self.state, seen, self.steps, self.library)
        if not self.phases or self.phases[-1] is not self.state.phase:
            self.phases.append(self.state.phase)
        self.now += TICK
        if self.state.goal.any() and not self.frozen:
            self.X_WT = self.state.goal.copy()
        if self.in_hand is not None:
            self.X_WO = compose(self.X_WT, self.in_hand)
        return self.state

    def _things(self) -> Array:
        rows = [
            Thing(k + 1, ObjectStatus.TRACKED, 0.0, self.now, corners.mean(axis=0), (corners,)).pack()
            for k, corners in enumerate(self.unknown)
        ]
        return np.concatenate([*rows, np.zeros(0)])

    def _squeezed(self, widest: float) -> float:
        wanted = min(self.stuck, widest * self.state.opened if self.state.opened >= 0 else self.opening)
        there = np.linalg.norm(self.X_WO[4:] - self.X_WT[4:]) < 0.06
        if self.sticks and there and wanted < 0.04:
            self.in_hand = compose(inverse(self.X_WT), self.X_WO)
            return 0.04
        self.in_hand = None
        return wanted

    def until(self, phase: Phase, most: float = 60.0) -> TaskState:
        while self.now < most:
            if self.tick().phase is phase:
                return self.state
        raise AssertionError(f"never came to {phase.name}: {[p.name for p in self.phases]}")

    def run(self, most: float = 60.0) -> TaskState:
        while self.state.outcome is TaskOutcome.RUNNING and self.now < most:
            self.tick()
        return self.state
