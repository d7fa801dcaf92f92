"""What a task's steps are truly worth: where things were put, and what was touched that no step asks for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final, cast

import numpy as np
from pydrake.systems.framework import Context

from twin_diagram.model.description.finger_travel import moving_bodies
from twin_diagram.planning.tasks.bearing import upon_middle
from twin_diagram.planning.tasks.step_state import Phase, Step, TaskState, steps_of
from twin_diagram.runs.score import rotation_angle
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING
from twin_diagram.signals.pose_vectors import compose, errors
from twin_diagram.station import ports
from twin_diagram.station.sim.world_plant import WorldPlant
from twin_diagram.twin.closed_loop import ClosedLoop

KINDS: Final = ("point", "surface")
"""Kinds of contact, as Drake's results hold them: at points, and in hydroelastic patches."""
GRIPPING: Final = (Phase.CLOSE, Phase.LIFT, Phase.CARRY, Phase.LOWER, Phase.OPEN, Phase.RETREAT)
"""Phases in which the fingers touch what the step is about."""


@dataclass(frozen=True)
class Parts:
    """Which bodies of the world are what, by index.

    Attributes:
        arm: links, gripper included.
        fingers: those of them that close.
        objects: body by object's name.
        still: of fixtures, and the world's own.
    """

    arm: frozenset[int]
    fingers: frozenset[int]
    objects: dict[str, int]
    still: frozenset[int]


def asked_for(a: int, b: int, parts: Parts, target: str, state: TaskState, support: int = NOTHING) -> bool:
    """Tell whether a contact of two bodies is no collision: the step asks for it, or it is nothing of the arm's.

    Args:
        a: one body.
        b: the other.
        parts: of the world.
        target: object that the step is about; empty where there is none.
        state: of the task.
        support: body of the object that bears what is held, or is to bear it.
    """
    mine, other = (a, b) if a in parts.arm else (b, a)
    held = state.hand.held != NOTHING
    body = parts.objects.get(target, -1)
    if mine in parts.arm:
        gripping = state.phase in GRIPPING or held
        return other in parts.arm or (mine in parts.fingers and other == body and gripping)
    if body in (a, b) and held:
        return (b if a == body else a) in {*parts.still, support} and state.hand.on_support
    return True


class TaskScore:
    """Watches a simulated loop's contacts while a task runs."""

    def __init__(self, loop: ClosedLoop) -> None:
        """`loop` with a `sim` station and a task of steps."""
        assert loop.twin.runner is not None
        self._loop, self._runner = loop, loop.twin.runner
        world: WorldPlant = cast(Any, loop.station).world
        plant, arm = world.plant, world.arm.arm
        bodies = [int(body) for instance in arm.instances for body in plant.GetBodyIndices(instance)]
        self._parts: Final = Parts(
            frozenset(bodies),
            frozenset(int(body.index()) for body in moving_bodies(plant, arm)),
            {name: int(index) for name, index in world.objects.items()},
            frozenset([0, *(int(index) for index in world.fixtures)]),
        )
        self._names = {int(index): plant.get_body(index).name() for instance in arm.instances
                       for index in plant.GetBodyIndices(instance)}  # fmt: skip
        self._names |= {index: name for name, index in self._parts.objects.items()}
        self._body_of = {
            geometry: index
            for index in [*bodies, *self._parts.objects.values(), *self._parts.still]
            for geometry in plant.GetCollisionGeometriesForBody(plant.get_body(_index(index)))
        }
        self._library = list(loop.scenario.twin.library)
        self._steps = steps_of(loop.scenario.twin.task, self._library)
        self._stood: dict[int, Array] = {}
        self._touching: set[tuple[str, int, int]] = set()
        self.counts: dict[str, int] = dict.fromkeys(KINDS, 0)
        self._told: list[dict[str, Any]] = []

    def poll(self, context: Context) -> None:
        """Count contacts that have begun since the last look and that nobody asked for; `context` is the whole's."""
        state = self._state(context)
        number = min(state.step, len(self._steps) - 1)
        target = self._steps[number].target
        held = state.hand.held
        if held != NOTHING:
            self._stood[held] = state.stood
        name = self._library[held if held != NOTHING else target] if max(held, target) >= 0 else ""
        below = state.hand.support
        support = self._parts.objects.get(self._library[below], NOTHING) if below != NOTHING else NOTHING
        station = self._loop.station
        results: Any = station.GetOutputPort(ports.CONTACT_RESULTS).Eval(station.GetMyContextFromRoot(context))
        now = {
            (kind, min(a, b), max(a, b))
            for kind, a, b in self._pairs(results)
            if not asked_for(a, b, self._parts, name, state, support)
        }
        for kind, a, b in sorted(now - self._touching):
            self.counts[kind] += 1
            names = [self._names.get(body, "fixture") for body in (a, b)]
            time = round(context.get_time(), 3)
            self._told.append({"time": time, "kind": kind, "between": names, "phase": state.phase.name.lower()})
        self._touching = now

    def told(self, context: Context) -> dict[str, Any]:
        """Return the score, for ``summary.json``; `context` is the whole Diagram's.

        Where each object of a `place` truly is off its goal [mm, °], beside what bears it as that truly stands, and
        collisions by kind of contact.
        """
        station = self._loop.station
        truth = np.array(station.GetOutputPort(ports.OBJECT_POSES).Eval(station.GetMyContextFromRoot(context)))
        poses = dict(zip(self._loop.scenario.world.objects, truth.reshape(-1, 7), strict=True))
        placed = {}
        for step in self._steps:
            name = self._library[step.target] if step.kind == "place" else ""
            below = self._library[step.support] if step.support != NOTHING else ""
            if name in poses and (not below or below in poses):
                goal = step.goal.copy()
                if below:
                    goal = self._upon(step, poses[below])
                asset, (off, _) = self._loop.twin.library[name], errors(goal, poses[name])
                angle = rotation_angle(goal[:4], poses[name][:4], asset.symmetric_axis, asset.symmetries)
                placed[name] = {"off_mm": round(1e3 * off, 2), "off_deg": round(float(np.degrees(angle)), 2)}
        return {"placed": placed, "collisions": dict(self.counts), "touched": self._told}

    def _upon(self, step: Step, X_WU: Array) -> Array:
        """Return where an object is to stand upon one that is truly at X_WU (7)."""
        if step.goal.any():
            return compose(X_WU, step.goal)
        above, below = (self._loop.twin.library[self._library[k]].convex_pieces for k in (step.target, step.support))
        return upon_middle(above, self._stood.get(step.target, TaskState().stood), below, X_WU)

    def _state(self, context: Context) -> TaskState:
        twin = self._loop.twin.diagram
        return self._runner.remembered(twin.GetSubsystemContext(self._runner, twin.GetMyContextFromRoot(context)))

    def _pairs(self, results: Any) -> Iterator[tuple[str, int, int]]:
        """Yield kind and bodies of each contact."""
        for i in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(i)
            yield KINDS[0], int(info.bodyA_index()), int(info.bodyB_index())
        for i in range(results.num_hydroelastic_contacts()):
            surface = results.hydroelastic_contact_info(i).contact_surface()
            yield KINDS[1], *_both(self._body_of.get(g, -1) for g in (surface.id_M(), surface.id_N()))


def _both(bodies: Iterable[int]) -> tuple[int, int]:
    a, b = bodies
    return a, b


def _index(body: int) -> Any:
    from pydrake.multibody.tree import BodyIndex

    return BodyIndex(body)
