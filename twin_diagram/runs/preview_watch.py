"""Holds what was foreseen against what came a second later, as the twin saw it: the arm's tool, and what it held."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from twin_diagram.planning.preview import AHEAD
from twin_diagram.signals import chi_square, pose_vectors, rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING, Hand
from twin_diagram.signals.layouts import TRACK_SIZE, Track
from twin_diagram.twin.twin import TwinDiagram


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    told: float = 0.95
    """Share of previews whose error is to lie within what was told of it: the usual interval."""


TUNING = Tuning()


@dataclass(frozen=True)
class Foreseen:
    """What was foreseen once.

    Attributes:
        due: when [s].
        now: (3,) where the tool was then, p_WT [m].
        tool: (3,) where it was foreseen to be [m].
        covariance: (3, 3) of that [m²].
        held: which object was held, or `NOTHING`.
        place: (3,) where that was foreseen to be, p_WO [m].
    """

    due: float
    now: Array
    tool: Array
    covariance: Array
    held: int
    place: Array


class PreviewWatch:
    """Looks at a twin's preview between steps."""

    def __init__(self, twin: TwinDiagram) -> None:
        """Begin with nothing foreseen."""
        self._twin = twin
        self._waiting: list[Foreseen] = []
        self._before: tuple[float, Array] | None = None
        self._tool: list[tuple[float, float, bool]] = []
        self._held: list[float] = []

    def poll(self, context: Context) -> None:
        """Note what is foreseen, and how far off what is due now was; `context` is the whole Diagram's."""
        own = self._twin.diagram.GetMyContextFromRoot(context)
        if not self._twin.ekf.belief(self._twin.diagram.GetSubsystemContext(self._twin.ekf, own)).valid:
            return
        n, time = len(self._twin.model.joints), context.get_time()
        hand = Hand.unpack(self._value(own, "task.hand")) if self._twin.runner is not None else Hand()
        now = self._twin.model.tool_pose(self._value(own, "arm_state")[:n]).translation()
        self._compare(own, time, now, hand.held)
        q = self._value(own, "position_previewed")
        X_WT, J = self._twin.model.tool_pose(q), self._twin.model.tool_jacobian(q)[3:]
        covariance = J @ self._value(own, "preview_covariance").reshape(n, n) @ J.T
        place = pose_vectors.compose(
            np.concatenate([rotations.from_matrix(X_WT.rotation().matrix()), X_WT.translation()]), hand.X_TO
        )[4:]
        self._waiting.append(Foreseen(time + AHEAD, now, X_WT.translation(), covariance, hand.held, place))
        self._before = time, now

    def _value(self, own: Context, port: str) -> Array:
        return np.array(self._twin.diagram.GetOutputPort(port).Eval(own))

    def _compare(self, own: Context, time: float, now: Array, held: int) -> None:
        """Take what has come due since the last look: between two looks the tool moves straight on."""
        due = [each for each in self._waiting if each.due <= time + 1e-9]
        self._waiting = self._waiting[len(due) :]
        limit = chi_square.quantile(TUNING.told, 3)
        for each in due:
            before, there = self._before or (time, now)
            part = 1.0 if time <= before else min((each.due - before) / (time - before), 1.0)
            came = there + part * (now - there)
            error = each.tool - came
            inside = bool(error @ np.linalg.pinv(each.covariance) @ error <= limit)
            self._tool.append((float(np.linalg.norm(error)), float(np.linalg.norm(came - each.now)), inside))
            if each.held == held != NOTHING:
                track = Track.unpack(self._value(own, "tracks").reshape(-1, TRACK_SIZE)[held])
                self._held.append(float(np.linalg.norm(each.place - track.pose[4:])))

    def told(self) -> dict[str, Any]:
        """Return how far off previews were, for ``summary.json``; empty where none came due."""
        if not self._tool:
            return {}
        errors, ways, inside = (np.array(column, dtype=float) for column in zip(*self._tool, strict=True))
        found: dict[str, Any] = {"ahead_s": AHEAD, "tool_error_mm": _told(errors), "tool_moved_mm": _told(ways)}
        if self._held:
            found["held_error_mm"] = _told(np.array(self._held))
        return {"preview": found | {"inside_95": round(float(inside.mean()), 3)}}


def _told(errors: Array) -> dict[str, float]:
    """Return median and 95th percentile in mm of errors [m]."""
    median, p95 = np.percentile(1e3 * errors, [50, 95])
    return {"median": round(float(median), 2), "p95": round(float(p95), 2)}
