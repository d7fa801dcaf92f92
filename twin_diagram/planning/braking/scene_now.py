"""The twin's scene as the stop monitor takes it: what is there, where it goes, and what is to be left to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from twin_diagram import scenario
from twin_diagram.planning.braking.drake_distances import ARM, Booleans, DrakeDistances, Shapes
from twin_diagram.planning.braking.stop_check import Allowances
from twin_diagram.planning.collision.collision_scene import TUNING as COLLISION_SCENE
from twin_diagram.planning.collision.collision_scene import Forecast
from twin_diagram.planning.collision.held_shape import obstacles_beside
from twin_diagram.planning.collision.unsure_pose import Unsure
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.hand import NOTHING, Hand
from twin_diagram.signals.layouts import TRACK_SIZE
from twin_diagram.signals.things import FURTHER_TRACK_SIZE, OWNER_SIZE, Thing, things_of


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    doubt: float = 0.015
    """A covariance adds no more than this [m]: what the arm hides for a while must not hold it for ever."""


TUNING = Tuning()


@dataclass(frozen=True)
class SceneNow:
    """The scene at the time of a look.

    Attributes:
        shapes: what the slots hold.
        forecast: of library objects and further instances.
        unknown: of unknown things.
        radii: (K + F,) of balls about those [m].
        fixtures: how many bodies come before the slots.
        fingers: (g,) where they are [m]; None: as described.
        age: of what was seen last [s].
    """

    shapes: Shapes
    forecast: Forecast
    unknown: Forecast
    radii: Array
    fixtures: int
    fingers: Array | None
    age: float

    def at(self, after: float) -> tuple[Booleans, Array]:
        """Return which slots are filled (S,), and where their frames are (S, 4, 4), some time from now [s]."""
        X_WO = np.tile(np.eye(4), (len(self.shapes.present), 1, 1))
        poses, _ = self.forecast.at(np.array([after]))
        X_WO[: len(poses)] = poses[:, 0]
        X_WO[len(poses) :] = self.unknown.at(np.array([after]))[0][:, 0]
        return self.shapes.present, X_WO

    def others(self, params: scenario.Braking, spare: float) -> Allowances:
        """Return what is to be left to each body, `spare` [m] beyond the clearance; what never moves needs no more."""
        f, slots = self.fixtures, len(self.shapes.present)
        margin = np.full(f + slots, params.clearance + spare)
        growth, speed = np.zeros(f + slots), np.zeros(f + slots)
        count = len(self.radii)
        margin[f : f + count] += np.minimum(self.forecast.grown, TUNING.doubt)
        margin[f + count :] += COLLISION_SCENE.thing_growth
        margin[f:] += params.unforeseen * self.age
        growth[f:] = params.unforeseen
        for k, how in self.unknown.unsure.items():
            growth[f + count + k] += float(np.sqrt(how.speed or 0.0))
        turning = np.linalg.norm(self.forecast.spin, axis=1) * self.radii
        speed[f : f + count] = np.linalg.norm(self.forecast.velocity, axis=1) + turning
        speed[f + count :] = np.linalg.norm(self.unknown.velocity, axis=1)
        guessed = np.arange(f + slots) >= f + count
        return Allowances(margin, growth, speed, guessed)


def read_scene(
    near: DrakeDistances,
    sizes: Array,
    q: Array,
    fingers: Array | None,
    age: float,
    *,
    tracks: Array | None,
    further_tracks: Array | None,
    things: Array | None,
    hand: Array | None,
) -> SceneNow:
    """Return the scene that the twin's ports tell.

    Args:
        near: whose slots are filled.
        sizes: (K + A, 3) edges of boxes about the library's objects, and about those that were added later [m].
        q: (n,) the arm's joints [rad].
        fingers: (2g,) their state; None where it is not told.
        age: of what was seen last [s].
        tracks: as the port of `Mpc`; None where there are none.
        further_tracks: the same.
        things: the same.
        hand: the same.
    """
    count, further, unknown = near.object_count, near.further_count, near.thing_count
    tracks = np.zeros(TRACK_SIZE * count) if tracks is None else tracks
    held = Hand() if hand is None else Hand.unpack(hand)
    if held.held != NOTHING or held.touched != NOTHING:
        tracks, further_tracks, things = obstacles_beside(held, near.tool(q), sizes, tracks, further_tracks, things)
    rows = np.zeros((further, FURTHER_TRACK_SIZE))
    if further_tracks is not None and further:
        rows = further_tracks.reshape(further, FURTHER_TRACK_SIZE)
    whose = np.isfinite(rows[:, :OWNER_SIZE]).all(axis=1) & (rows[:, 0] > 0)
    kinds = np.where(whose, rows[:, 1], 0.0).astype(int)
    forecast = Forecast.of_tracks(np.concatenate([tracks, rows[:, OWNER_SIZE:].ravel()]))
    told = things is not None and np.isfinite(things).all()
    seen = things_of(cast(Array, things)) if told else [Thing()] * unknown
    goes = Forecast.of_things(seen)
    present = np.concatenate([forecast.present, goes.present])
    present[count : count + further] &= whose
    whole = tuple(thing.pieces for thing in seen)
    shapes = Shapes(
        present, tuple(kinds.tolist()), whole, ARM if held.held == NOTHING else held.held, held.X_TO,
        held.on_support, held.support, min(Unsure.of(held.covariance, np.eye(3), None, moving=False).now, TUNING.doubt),
    )  # fmt: skip
    own = None if fingers is None or not np.isfinite(fingers).all() else fingers[: len(fingers) // 2]
    radii = 0.5 * np.linalg.norm(sizes, axis=1)
    others = radii[kinds] if len(radii) else np.zeros(further)
    return SceneNow(shapes, forecast, goes, np.concatenate([radii[:count], others]), near.fixture_count, own, age)
