"""Lays down what would fall over however it is set down, as a bottle held at its bottom: its low end touches first.

The hand comes down straight and goes aside, so that what it holds rolls about its low end, without sliding, and turns
between the pads until it lies. How high the hand is leaves it no other turn, whatever friction does.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from twin_diagram.runs.learning.cell import Cell
from twin_diagram.runs.learning.easing import release
from twin_diagram.runs.learning.held_turns import about_pads
from twin_diagram.runs.learning.motion import Mover, NoWay, pointing, pose
from twin_diagram.runs.learning.picking import go
from twin_diagram.runs.learning.setting_down import TUNING as SETTING
from twin_diagram.runs.learning.setting_down import (
    PutDown,
    places_in,
    pose_over,
    resting,
    set_down,
    turned,
    way_back,
)
from twin_diagram.runs.learning.shown_object import ShownObject
from twin_diagram.runs.learning.steadiness import FINE, STEADY, steadiness
from twin_diagram.signals.arrays import Array

DOWN: Final = pointing(np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]))
"""Axes of a tool that points straight down."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    most: float = 1.9
    """That it is turned at the most [rad]: what leans away from where it is to lie comes over the vertical first."""

    step: float = 0.05
    """Between turns that are tried [rad], and of the way."""

    surely: float = 2.0
    """How many times as steady as what just stands it is to lie, where anything is."""

    above: float = 0.1
    """Height from which the hand comes down [m]."""

    clear: float = 0.004
    """Between the low end and what it is laid upon, where the way aside begins [m]: as far as arm and poses are off."""


TUNING = Tuning()


@dataclass(frozen=True)
class Laying:
    """How what is held is laid down by a tool that points straight down.

    Attributes:
        turn: (4, 4) of the object in the tool's frame, from how it is held to how it lies then.
        aside: (K,) along the tool's x axis where the tool is, against where the way begins [m].
        height: (K,) of the tool over what it is laid upon [m].
    """

    turn: Array
    aside: Array
    height: Array

    def swept(self, points_T: Array) -> Array:
        """Return points (M, 3) of all that is held (N, 3) goes through on the way, in the tool's frame at its end."""
        turns = np.linspace(0.0, np.arctan2(self.turn[0, 2], self.turn[0, 0]), len(self.aside))
        off = np.column_stack([self.aside - self.aside[-1], 0.0 * self.aside, self.height[-1] - self.height])
        return np.concatenate([_placed(points_T, float(turn)) + at for turn, at in zip(turns, off, strict=True)])


def laying_of(points_T: Array) -> Laying | None:
    """Return how what is held is laid down by the least turn between the pads; None: nothing lies more surely.

    Args:
        points_T: (N, 3) of it in the tool's frame [m].
    """
    count = int(TUNING.most / TUNING.step)
    turns = TUNING.step * np.array([sign * k for k in range(count + 1) for sign in (1.0, -1.0)][1:])
    down = np.array([0.0, 0.0, 1.0])
    sure = np.array([steadiness(points_T, about_pads(turn)[:3, :3].T @ down) for turn in turns])
    enough = min(TUNING.surely * STEADY, float(sure.max()))
    if enough < STEADY:
        return None
    turn = float(turns[int(np.flatnonzero(sure >= enough)[0])])
    steps = np.linspace(0.0, turn, 2 + int(abs(turn) / TUNING.step))
    at, height, aside = _placed(points_T, float(steps[0])), [0.0], [0.0]
    height[0] = float(at[:, 2].max())
    for step in steps[1:]:
        low, at = int(at[:, 2].argmax()), _placed(points_T, float(step))
        before = _placed(points_T[low : low + 1], float(step) - float(steps[1] - steps[0]))
        aside.append(aside[-1] - float(at[low, 0] - before[0, 0]))
        height.append(float(at[:, 2].max()))
    return Laying(about_pads(turn), np.array(aside), np.array(height))


def _placed(points: Array, turn: float) -> Array:
    X = about_pads(turn)
    return np.asarray(points @ X[:3, :3].T + X[:3, 3])


def lay_down(
    mover: Mover, cell: Cell, points_T: Array, laying: Laying, places: Sequence[Array], over: Array | None = None
) -> Array:
    """Lay down what is held at the first of some places that the arm reaches, and go back.

    Args:
        mover: knows what is held.
        cell: whose arm holds it.
        points_T: (N, 3) of it in the tool's frame [m].
        laying: of it.
        places: (3,) each: x, y and the support's height [m]; (4,): and the one turn about the vertical that may be.
        over: (M, 3) points in the tool's frame at the end whose middle comes over the place [m]; None: what lies there.

    Returns:
        The tool's pose (4, 4) when the fingers opened.

    Raises:
        NoWay: none is reached.
    """
    last = NoWay("no place to lay it down is reached")
    lying = points_T @ laying.turn[:3, :3].T + laying.turn[:3, 3]
    for place in places:
        for yaw in np.arange(SETTING.turns) * (2.0 * np.pi / SETTING.turns) if len(place) == 3 else place[3:]:
            R_WT = turned(DOWN, float(yaw))
            end = pose_over(lying, R_WT, place[:2], float(place[2]))[:3, 3]
            if over is not None:
                end[:2] = pose_over(over, R_WT, place[:2], float(place[2]))[:2, 3]
            way = [pose(R_WT, end + (one - laying.aside[-1]) * R_WT[:, 0]) for one in laying.aside]
            for X, height in zip(way, laying.height, strict=True):
                X[2, 3] = place[2] + height
            above = way[0].copy()
            above[2, 3] += TUNING.above
            for q in mover.goals(above, cell.commanded)[:2]:
                try:
                    touching = way[0].copy()
                    touching[2, 3] += TUNING.clear
                    line = mover.line(q, touching)
                    line = np.vstack([line, mover.through(line[-1], way)[1:]])
                    beside = mover.bare_free(line[:-1], SETTING.beside, standing=True)
                    if not (beside and mover.bare_free(line[-1:], SETTING.grazing, standing=True)):
                        raise NoWay("something is in the way of laying it down")
                    with mover.as_if(lying @ R_WT.T + end, float(place[2])):
                        back = way_back(mover, line[-1])
                    path = mover.path(cell.commanded, line[:1])
                except NoWay as why:
                    last = why
                    continue
                go(cell, mover.timed(path))
                return release(mover, cell, line, back)
    raise last


def stand_or_lie(mover: Mover, cell: Cell, shown: ShownObject, places: Sequence[Array]) -> Array:
    """Set what is held down at one of some places (3,), lay it down where it would fall over; return X_WS (4, 4) then.

    Raises:
        NoWay: it cannot be set down.
    """
    points_T, fine, X_TS = shown.in_tool(), shown.in_tool(FINE), np.linalg.inv(shown.X_ST[-1])
    ways = resting(fine, shown.R_WT)
    if (laying := laid_where_it_falls(fine, ways[0])) is not None:
        with contextlib.suppress(NoWay):
            return np.asarray(lay_down(mover, cell, points_T, laying, places) @ laying.turn @ X_TS)
    for R_WT in ways:
        with contextlib.suppress(NoWay):
            return np.asarray(set_down(mover, cell, points_T, R_WT, places)[0] @ X_TS)
    raise NoWay("no place to set it down is reached")


def lay_into(
    mover: Mover, cell: Cell, shown: ShownObject, low: Array, high: Array, standing: Sequence[PutDown]
) -> PutDown | None:
    """Lay down what is held in a bin where it would fall over there; None: it would not, or cannot be laid down.

    Args:
        mover: knows what is held.
        cell: whose arm holds it.
        shown: what is held.
        low: (3,) lowest corner of the bin's inside [m].
        high: (3,) its highest.
        standing: what was set down there.
    """
    points_T, fine = shown.in_tool(), shown.in_tool(FINE)
    if (laying := laid_where_it_falls(fine, resting(fine, shown.R_WT)[0])) is None:
        return None
    swept = laying.swept(points_T)
    try:
        X_WT = lay_down(mover, cell, points_T, laying, places_in(low, high, standing, swept, DOWN), swept)
    except NoWay:
        return None
    lying = points_T @ laying.turn[:3, :3].T + laying.turn[:3, 3]
    at = lying @ X_WT[:3, :3].T + X_WT[:3, 3]
    middle = 0.5 * (at.min(axis=0) + at.max(axis=0))
    return PutDown.standing(lying, X_WT[:3, :3], np.array([*middle[:2], at[:, 2].min(), 0.0]))


def laid_where_it_falls(points_T: Array, R_WT: Array) -> Laying | None:
    """Return how what would fall over as it is set down is laid down; None: it would not, or nothing lies more surely.

    Args:
        points_T: (N, 3) of it in the tool's frame [m].
        R_WT: (3, 3) the tool's axes in which it would be set down.
    """
    return laying_of(points_T) if steadiness(points_T, R_WT.T @ [0.0, 0.0, -1.0]) < STEADY else None
