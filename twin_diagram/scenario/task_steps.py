"""Which steps a task may have, what each needs, and in which order: checked before anything starts."""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario.planning import Task, TaskStep

KINDS: Final = ("reach", "follow", "hold", "pick", "place")
"""Of a step, in the order of their numbers."""
_GOAL: Final = {
    "reach": "X_WG of the tool frame",
    "follow": "X_OG of the tool frame",
    "place": "X_WO of the object, or `upon` what it is put",
}
"""Kinds that need a goal, and what that is."""


def check_steps(task: Task, library: Collection[str]) -> None:
    """Check a task's steps.

    Args:
        task: of a twin.
        library: names of the objects that the twin knows.

    Raises:
        ScenarioError: a kind that nobody knows, an object that the twin does not know, a goal that is missing or has no
            meaning, a step that cannot follow the one before it; it names the field.
    """
    if task.steps and task.X_WG is not None:
        raise ScenarioError("twin.task.X_WG", "stands beside steps; make it the goal of a step of kind reach")
    held, upon = "", dict[str, str]()
    for index, step in enumerate(task.steps):
        name = f"twin.task.steps.{index}"
        if step.kind == "place" and step.upon:
            _check_support(step, name, library, held)
            upon[held] = step.upon
        held = _check_step(step, name, library, held)
        upon.pop(held, None)
        laden = [above for above, below in upon.items() if below == held]
        if laden:
            raise ScenarioError(f"{name}.object", f"{held} bears {laden[0]} by then; pick that first")


def _check_step(step: TaskStep, name: str, library: Collection[str], held: str) -> str:
    """Check a step that begins with an object held, or with none; return what is held after it."""
    if step.kind not in KINDS:
        raise ScenarioError(f"{name}.kind", f"{step.kind!r} is none of {', '.join(KINDS)}")
    _check_object(step, name, library)
    if step.goal is None and step.kind in _GOAL and not step.upon:
        raise ScenarioError(f"{name}.goal", f"{step.kind} needs one: {_GOAL[step.kind]}")
    if step.goal is not None and step.kind == "hold":
        raise ScenarioError(f"{name}.goal", "hold stays where it is and has none")
    if step.upon and step.kind != "place":
        raise ScenarioError(f"{name}.upon", f"{step.kind} puts nothing down; only a place has it")
    if step.kind in ("hold", "follow") and step.seconds >= step.time_limit:
        raise ScenarioError(f"{name}.seconds", f"{step.seconds} s are not below the time limit, {step.time_limit} s")
    if step.kind == "pick" and held:
        raise ScenarioError(f"{name}.kind", f"pick while {held} is held; place it first")
    if step.kind == "place" and not held:
        raise ScenarioError(f"{name}.kind", "place where no step before it picks anything")
    if step.kind == "place" and step.object not in ("", held):
        raise ScenarioError(f"{name}.object", f"{step.object!r} is not what is held, {held}")
    if held and step.kind == "follow" and step.object == held:
        raise ScenarioError(f"{name}.object", f"{held} is held and cannot be followed")
    return {"pick": step.object, "place": ""}.get(step.kind, held)


def _check_support(step: TaskStep, name: str, library: Collection[str], held: str) -> None:
    """Check that the twin knows what is to bear what a `place` puts down."""
    if step.upon not in library:
        raise ScenarioError(f"{name}.upon", f"{step.upon!r} is not in the library: {', '.join(library) or 'empty'}")
    if step.upon == held:
        raise ScenarioError(f"{name}.upon", f"{held} is what is held and cannot bear itself")


def _check_object(step: TaskStep, name: str, library: Collection[str]) -> None:
    """Check that an object is named where a step is about one, and that the twin knows it."""
    if step.kind in ("reach", "hold"):
        if step.object:
            raise ScenarioError(f"{name}.object", f"{step.kind} is about no object")
        return
    if step.kind == "place" and not step.object:
        return
    if step.object not in library:
        known = ", ".join(library) or "empty"
        raise ScenarioError(f"{name}.object", f"{step.object!r} is not in the library: {known}")
