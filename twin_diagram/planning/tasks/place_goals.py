"""Refuses places where no object can stand, before anything starts: inside what never moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.assets import Asset
from twin_diagram.errors import ScenarioError
from twin_diagram.planning.collision.convex_solids import Solid
from twin_diagram.planning.collision.geometry_to_solids import moved
from twin_diagram.scenario import poses
from twin_diagram.scenario.planning import Task
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    shells: int = 24
    """A piece is looked at in so many shells between its middle and its corners: 3 mm apart in a can."""


TUNING = Tuning()


def check_places(task: Task, library: Mapping[str, Asset], fixtures: Sequence[tuple[str, Sequence[Solid]]]) -> None:
    """Check where a task's objects are to be put; deeper than a step's tolerance inside a fixture nothing can stand.

    Args:
        task: checked by `task_steps.check_steps`.
        library: the known objects by name.
        fixtures: what never moves, as solids in W, by name.

    Raises:
        ScenarioError: an object would stand inside a fixture; it names the field.
    """
    held = ""
    for index, step in enumerate(task.steps):
        held = step.object if step.kind == "pick" else held
        if step.kind != "place" or step.goal is None:
            continue
        X_WO = np.asarray(poses.pose(step.goal).GetAsMatrix4())
        pieces = [moved(X_WO, np.asarray(piece, dtype=float)) for piece in library[held].convex_pieces]
        for name, solids in fixtures:
            if depth_inside(pieces, solids) > step.position_tolerance:
                low = min(float(piece[:, 2].min()) for piece in pieces)
                raise ScenarioError(
                    f"twin.task.steps.{index}.goal",
                    f"{held} would stand inside {name}, its lowest point at z = {low:.3f} m; "
                    f"the goal is where its own frame goes, which is {X_WO[2, 3] - low:.3f} m above that",
                )


def depth_inside(pieces: Sequence[Array], solids: Sequence[Solid]) -> float:
    """Return how deep convex pieces (V, 3 each) are inside solids [m]; negative: how far apart, to their samples."""
    shares = np.linspace(0.0, 1.0, TUNING.shells)[:, None, None]
    points = [piece.mean(axis=0) + shares * (piece - piece.mean(axis=0)) for piece in pieces]
    samples = np.concatenate([each.reshape(-1, 3) for each in points])
    return max((-float(solid.distance(samples)[0].min()) for solid in solids), default=-np.inf)
