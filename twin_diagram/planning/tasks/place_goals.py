"""Refuses places where no object can stand, or can be grasped, before anything starts.

Inside what never moves or above none of it, inside what is to bear the object or beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from twin_diagram.assets import Asset
from twin_diagram.errors import ScenarioError
from twin_diagram.planning.collision.convex_solids import Solid, solid_of
from twin_diagram.planning.collision.geometry_to_solids import moved
from twin_diagram.planning.tasks.bearing import borne, depth_inside, within_of
from twin_diagram.scenario import poses
from twin_diagram.scenario.planning import Task, TaskStep
from twin_diagram.signals.arrays import Array

REACH: Final = 0.25
"""No gripper's tool frame is farther from what is between its fingers [m]: that of a flange is 0.1 to 0.2 m behind."""


def check_places(task: Task, library: Mapping[str, Asset], fixtures: Sequence[tuple[str, Sequence[Solid]]]) -> None:
    """Check where a task's objects are to be put: on a fixture, and no deeper in one than a step's tolerance.

    A grasp that is told is to be at its object. Where no fixture is told, nobody knows what there is to stand on, and
    nothing is refused. How an object lies that is to bear another is seen when it is: here they only must touch.

    Args:
        task: checked by `task_steps.check_steps`.
        library: the known objects by name.
        fixtures: what never moves, as solids in W, by name.

    Raises:
        ScenarioError: an object would stand inside a fixture, or would fall, or is not where it is to be grasped; it
            names the field.
    """
    held = ""
    for index, step in enumerate(task.steps):
        held = step.object if step.kind == "pick" else held
        if step.kind == "pick" and step.goal is not None:
            _check_grasp(step, library[held], f"twin.task.steps.{index}.goal")
        if step.kind != "place" or step.goal is None:
            continue
        X_WO = np.asarray(poses.pose(step.goal).GetAsMatrix4())
        pieces = [moved(X_WO, np.asarray(piece, dtype=float)) for piece in library[held].convex_pieces]
        if step.upon:
            _check_upon(pieces, library[step.upon], held, step, f"twin.task.steps.{index}.goal")
            continue
        low = min(float(piece[:, 2].min()) for piece in pieces)
        where = f"its lowest point at z = {low:.3f} m"
        own = f"the goal is where its own frame goes, which is {X_WO[2, 3] - low:.3f} m above that"
        for name, solids in fixtures:
            if depth_inside(pieces, solids) > step.position_tolerance:
                why = f"{held} would stand inside {name}, {where}; {own}"
                raise ScenarioError(f"twin.task.steps.{index}.goal", why)
        every = [solid for _, solids in fixtures for solid in solids]
        within = within_of(step.position_tolerance)
        if every and not borne(pieces, X_WO[:3, 3], every, within):
            why = f"{held} would fall or tip: no fixture bears its middle within {1e3 * within:.3g} mm (other objects"
            why += f" count where `upon` names one), {where}; {own}"
            raise ScenarioError(f"twin.task.steps.{index}.goal", why)


def _check_grasp(step: TaskStep, taken: Asset, field: str) -> None:
    """Check that a grasp is at the object: one that is told in the world's frame is mostly half a metre off."""
    assert step.goal is not None
    place = np.array([poses.pose(step.goal).GetAsMatrix4()[:3, 3]])
    solids = [solid_of(np.asarray(piece, dtype=float)) for piece in taken.convex_pieces]
    off = min(float(solid.distance(place)[0][0]) for solid in solids)
    if off > REACH:
        why = f"the tool frame would be {off:.2f} m off {step.object} when the fingers close"
        raise ScenarioError(field, f"{why}; it is X_OG, in the object's own frame; without it the grasp is found")


def _check_upon(pieces_U: Sequence[Array], below: Asset, held: str, step: TaskStep, field: str) -> None:
    """Check that an object, as convex pieces in the frame of one that is to bear it, touches that."""
    other = [np.asarray(piece, dtype=float) for piece in below.convex_pieces]
    depth = max(
        depth_inside(pieces_U, [solid_of(piece) for piece in other]),
        depth_inside(other, [solid_of(piece) for piece in pieces_U]),
    )
    frame = f"the goal is where its own frame goes in that of {step.upon}"
    if depth > step.position_tolerance:
        raise ScenarioError(field, f"{held} would stand {1e3 * depth:.3g} mm inside {step.upon}; {frame}")
    within = within_of(step.position_tolerance)
    if depth < -within:
        why = f"{held} would be {-1e3 * depth:.3g} mm off {step.upon}, more than {1e3 * within:.3g} mm"
        raise ScenarioError(field, f"{why}, whichever way that lies; {frame}")
