"""What stands upon what: whether solids bear an object, which object bears another, and where one is put upon it.

Pure functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from twin_diagram.planning.collision.convex_solids import Solid, solid_of
from twin_diagram.planning.collision.geometry_to_solids import moved
from twin_diagram.planning.tasks.step_state import Step, TaskState
from twin_diagram.planning.tasks.step_view import StepView, Takeable
from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING
from twin_diagram.signals.layouts import ObjectStatus
from twin_diagram.signals.pose_vectors import as_matrix, compose


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


def place_now(state: TaskState, seen: StepView, step: Step, library: Sequence[Takeable]) -> Array | None:
    """Return where a `place` puts its object (7): as told, or upon another as that stands; None: that is not known."""
    if step.support == NOTHING:
        return step.goal.copy()
    track = seen.tracks[step.support]
    if track.status in (ObjectStatus.UNSEEN, ObjectStatus.LOST, ObjectStatus.GONE):
        return None
    if step.goal.any():
        return compose(track.pose, step.goal)
    return upon_middle(library[step.target].pieces, state.stood, library[step.support].pieces, track.pose)


def upon_middle(pieces_O: Sequence[Array], stood: Array, below_U: Sequence[Array], X_WU: Array) -> Array:
    """Return where an object stands upon the middle of another's top (7), turned as it stood where it was taken.

    Args:
        pieces_O: corners (V, 3) of its convex pieces, in O [m].
        stood: (4) quaternion of O in W.
        below_U: the same of the other's pieces, in U.
        X_WU: (7) the other.
    """
    highest = max((moved(as_matrix(X_WU), np.asarray(piece)) for piece in below_U), key=lambda p: float(p[:, 2].max()))
    middle = 0.5 * (highest[:, :2].min(axis=0) + highest[:, :2].max(axis=0))
    faces = ConvexHull(highest).equations
    up = faces[faces[:, 2] > 1e-9]
    top = float((-(up[:, :2] @ middle + up[:, 3]) / up[:, 2]).min())
    low = float((np.concatenate(list(pieces_O)) @ rotations.matrix(stood)[2]).min())
    return np.array([*stood, *middle, top - low])


def bearer(seen: StepView, step: Step, library: Sequence[Takeable]) -> int:
    """Return the number of the object that bears the one that a step is about, or `NOTHING`."""
    X_WO, pieces = seen.tracks[step.target].pose, library[step.target].pieces
    for k, track in enumerate(seen.tracks):
        if k == step.target or track.status in (ObjectStatus.UNSEEN, ObjectStatus.LOST, ObjectStatus.GONE):
            continue
        if bears(pieces, X_WO, library[k].pieces, track.pose, step.position_tolerance):
            return k
    return NOTHING


def bears(pieces_O: Sequence[Array], X_WO: Array, below_U: Sequence[Array], X_WU: Array, tolerance: float) -> bool:
    """Tell whether an object U bears another, O.

    Args:
        pieces_O: corners (V, 3) of the other's convex pieces, in O [m].
        X_WO: (7)
        below_U: the same of the one below, in U.
        X_WU: (7)
        tolerance: of a step [m]; see `Tuning.fall`.
    """
    pieces = [moved(as_matrix(X_WO), np.asarray(piece, dtype=float)) for piece in pieces_O]
    solids = [solid_of(moved(as_matrix(X_WU), np.asarray(piece, dtype=float))) for piece in below_U]
    return borne(pieces, X_WO[4:], solids, within_of(tolerance))


def within_of(tolerance: float) -> float:
    """Return how far below an object's lowest points what bears it may be [m], for a step's tolerance [m]."""
    return float(np.clip(tolerance, *TUNING.fall))


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


def depth_inside(pieces: Sequence[Array], solids: Sequence[Solid]) -> float:
    """Return how deep convex pieces (V, 3 each) are inside solids [m]; negative: how far apart, to their samples."""
    shares = np.linspace(0.0, 1.0, TUNING.shells)[:, None, None]
    points = [piece.mean(axis=0) + shares * (piece - piece.mean(axis=0)) for piece in pieces]
    samples = np.concatenate([each.reshape(-1, 3) for each in points])
    return max((-float(solid.distance(samples)[0].min()) for solid in solids), default=-np.inf)
