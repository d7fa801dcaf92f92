"""Refuses places where no object can stand, before anything starts: inside what never moves, or above none of it."""

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

    fall: tuple[float, float] = (0.005, 0.01)
    """What is let go higher than a step's tolerance above what is to bear it is dropped, not placed; of the tolerance
    no less counts than this, from where all is let go, and no more than the usual one [m]."""

    steps: int = 8
    """What bears is looked for in so many steps of height below the lowest points: 1.25 mm apart."""

    edge: float = 0.005
    """The middle of what stands may be so far beside what bears it [m]: as far as its own is usually told, and a thing
    that lies on its round side touches along a line."""

    directions: int = 32
    """In so many directions what bears must reach beyond the middle: every 11°."""


TUNING = Tuning()


def check_places(task: Task, library: Mapping[str, Asset], fixtures: Sequence[tuple[str, Sequence[Solid]]]) -> None:
    """Check where a task's objects are to be put: on a fixture, and no deeper in one than a step's tolerance.

    Where no fixture is told, nobody knows what there is to stand on, and nothing is refused.

    Args:
        task: checked by `task_steps.check_steps`.
        library: the known objects by name.
        fixtures: what never moves, as solids in W, by name.

    Raises:
        ScenarioError: an object would stand inside a fixture, or would fall; it names the field.
    """
    held = ""
    for index, step in enumerate(task.steps):
        held = step.object if step.kind == "pick" else held
        if step.kind != "place" or step.goal is None:
            continue
        X_WO = np.asarray(poses.pose(step.goal).GetAsMatrix4())
        pieces = [moved(X_WO, np.asarray(piece, dtype=float)) for piece in library[held].convex_pieces]
        low = min(float(piece[:, 2].min()) for piece in pieces)
        where = f"its lowest point at z = {low:.3f} m"
        own = f"the goal is where its own frame goes, which is {X_WO[2, 3] - low:.3f} m above that"
        for name, solids in fixtures:
            if depth_inside(pieces, solids) > step.position_tolerance:
                why = f"{held} would stand inside {name}, {where}; {own}"
                raise ScenarioError(f"twin.task.steps.{index}.goal", why)
        every = [solid for _, solids in fixtures for solid in solids]
        within = float(np.clip(step.position_tolerance, *TUNING.fall))
        if every and not borne(pieces, X_WO[:3, 3], every, within):
            why = f"{held} would fall or tip: no fixture bears its middle within {1e3 * within:.3g} mm (other objects"
            why += f" do not count), {where}; {own}"
            raise ScenarioError(f"twin.task.steps.{index}.goal", why)


def depth_inside(pieces: Sequence[Array], solids: Sequence[Solid]) -> float:
    """Return how deep convex pieces (V, 3 each) are inside solids [m]; negative: how far apart, to their samples."""
    shares = np.linspace(0.0, 1.0, TUNING.shells)[:, None, None]
    points = [piece.mean(axis=0) + shares * (piece - piece.mean(axis=0)) for piece in pieces]
    samples = np.concatenate([each.reshape(-1, 3) for each in points])
    return max((-float(solid.distance(samples)[0].min()) for solid in solids), default=-np.inf)


def borne(pieces: Sequence[Array], middle: Array, solids: Sequence[Solid], within: float) -> bool:
    """Tell whether an object stands on solids, and does not tip over.

    Args:
        pieces: corners (V, 3) of its convex pieces in W [m].
        middle: (3) its centre of mass in W [m].
        solids: what may bear it, in W.
        within: so far below its lowest points at most [m].
    """
    low = min(float(piece[:, 2].min()) for piece in pieces)
    shares = np.linspace(0.0, 1.0, TUNING.shells)[:, None, None]
    feet = [piece[piece[:, 2] <= low + within] for piece in pieces]
    points = np.concatenate(
        [(foot.mean(axis=0) + shares * (foot - foot.mean(axis=0))).reshape(-1, 3) for foot in feet if len(foot)]
    )
    down = np.linspace(0.0, within, TUNING.steps + 1)[:, None, None] * np.array([0.0, 0.0, 1.0])
    below = (points - down).reshape(-1, 3)
    met = np.zeros(len(below), dtype=bool)
    for solid in solids:
        met |= solid.distance(below)[0] <= 0.0
    bearing = points[met.reshape(-1, len(points)).any(axis=0), :2] - middle[:2]
    turns = np.arange(TUNING.directions) * 2 * np.pi / TUNING.directions
    reach = bearing @ np.stack([np.cos(turns), np.sin(turns)])
    return bool(len(bearing) and (reach.max(axis=0) >= -TUNING.edge).all())
