"""Whether what is held is still in the hand, and where there, and whether it stays where it was put. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin_diagram.planning.tasks.bearing import place_now
from twin_diagram.planning.tasks.in_hand import HeldImage, InHand, after_image, closed_on
from twin_diagram.planning.tasks.slips import slipped
from twin_diagram.planning.tasks.step_ends import TUNING
from twin_diagram.planning.tasks.step_state import Note, Step, TaskState, Why
from twin_diagram.planning.tasks.step_view import StepView, Takeable
from twin_diagram.planning.tasks.tool_past import remembering, tool_at
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import PoseMeasurement
from twin_diagram.signals.pose_vectors import compose, errors


def closing_on(X_TO: Array, covariance: Array, seen: StepView) -> InHand:
    """Return what is known of a thing that the fingers have closed on.

    Args:
        X_TO: (7) with the thing in their middle.
        covariance: (6, 6) of X_TO as it was seen, before they put it there.
        seen: now.
    """
    return closed_on(X_TO, covariance, seen.X_WT, seen.eye, seen.now)


def watched(state: TaskState, seen: StepView, held: Takeable) -> tuple[TaskState, Why]:
    """Return the state with the newest image taken in, and why what is held is lost; `NONE` where it is not.

    Args:
        state: with something in the hand.
        seen: now.
        held: what is held.
    """
    state = replace(state, past=remembering(state.past, seen.now, seen.X_WT))
    if seen.opening < TUNING.empty:
        return state, Why.DROPPED
    measurement = seen.measured[state.hand.held]
    if not (measurement.quality > 0.0 and measurement.time > state.image):
        return state, Why.NONE
    state = _followed(replace(state, image=measurement.time), seen, measurement, held)
    off = float(np.linalg.norm(measurement.pose[4:] - compose(seen.X_WT, state.hand.X_TO)[4:]))
    # The image is of a little while ago, when the hand was not yet where it is.
    late = seen.speed * (seen.now - measurement.time)
    count = state.elsewhere + 1 if off > TUNING.elsewhere + _doubt(measurement) + late else 0
    return replace(state, elsewhere=count), Why.SEEN_ELSEWHERE if count >= TUNING.images else Why.NONE


def put_down(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> TaskState:
    """Return the state with the newest image taken in of what was let go: how many in a row show it off its place."""
    measurement = seen.measured[step.target]
    if not (measurement.quality >= TUNING.fits and measurement.time > state.image):
        return state
    place = place_now(state, seen, step, library)
    if place is None:
        return state
    off = float(np.linalg.norm(measurement.pose[4:] - place[4:]))
    away = off > TUNING.misplaced + _doubt(measurement)
    return replace(state, image=measurement.time, elsewhere=state.elsewhere + 1 if away else 0)


def _doubt(measurement: PoseMeasurement) -> float:
    """Return three standard deviations of where an image shows a thing, along the axis where they are greatest [m]."""
    return 3.0 * float(np.sqrt(max(0.0, np.linalg.eigvalsh(measurement.covariance[3:, 3:])[-1])))


def _followed(state: TaskState, seen: StepView, measurement: PoseMeasurement, held: Takeable) -> TaskState:
    """Return the state with where the thing lies in the hand as an image shows it; a slip is told."""
    tool = tool_at(state.past, measurement.time)
    if tool is None or measurement.quality < TUNING.fits:
        return state
    X_WT, V_WT = tool
    R_TW, p = rotations.matrix(X_WT[:4]).T, measurement.pose[4:] - X_WT[4:]
    q = rotations.multiply(rotations.conjugate(X_WT[:4]), measurement.pose[:4])
    if not between(held.pieces, np.concatenate([q, R_TW @ p])):
        return state  # what is seen there is not in the hand, or not seen for what it is
    shown = HeldImage(measurement.time, measurement.pose, measurement.covariance, X_WT, V_WT)
    lies, told = slipped(after_image(state.lies, shown, seen.eye, held.symmetric))
    state = replace(state, lies=lies)
    if told is not None:
        state = state.noting(Note.SLIPPED, seen.now, by=told)
    off, angle = errors(state.hand.X_TO, lies.X_TO)
    if off < TUNING.told_step and angle < TUNING.told_turn and told is None:
        return state
    return replace(state, hand=replace(state.hand, X_TO=lies.X_TO, covariance=lies.pose_covariance))


def between(pieces_O: tuple[Array, ...], X_TO: Array) -> bool:
    """Tell whether an object at X_TO (7) is between the fingers: whether the tool's origin is about inside it.

    Args:
        pieces_O: corners (m, 3) of its convex pieces, in O [m].
        X_TO: its pose in the tool's frame.
    """
    p_OT = -rotations.matrix(X_TO[:4]).T @ X_TO[4:]
    return any(
        bool(np.all(p_OT > piece.min(axis=0) - TUNING.grip) and np.all(p_OT < piece.max(axis=0) + TUNING.grip))
        for piece in pieces_O
    )
