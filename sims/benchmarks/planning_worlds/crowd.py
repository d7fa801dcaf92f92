"""An arm among eight objects of eight convex pieces each, three of which go to and fro."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from twin_diagram import scenario
from twin_diagram.planning.collision.collision_scene import Scene, load_scene
from twin_diagram.planning.collision.convex_solids import Solid, solid_of
from twin_diagram.planning.collision.solid_batch import Body
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import TRACK_SIZE, ObjectStatus

OBJECTS, MOVING = 8, 3
SIZE = (0.06, 0.20)
"""Least and largest edge of an object [m]."""
HOME = np.array([0.55, 0.1, 0.0, -2.0, 0.0, 2.1, 1.33])
"""Of the Panda [rad]."""
SWITCH = 4.0
"""The goal changes so often [s]."""
NOISE = 0.002
"""Of tracked positions [m]."""


def pieces(rng: np.random.Generator) -> list[Solid]:
    """Return eight convex pieces, one in each octant of a box, as a decomposition of a mesh leaves them."""
    half = rng.uniform(*SIZE, 3) / 2
    corners = np.array(list(product((0.0, 1.0), repeat=3)))
    octants = (np.array(signs) for signs in product((-1.0, 1.0), repeat=3))
    # Inner corners stay, outer ones are rounded off by further points.
    return [
        solid_of(sign * half * np.vstack([0.9 * corners, rng.uniform(0.5, 1.0, (12, 3))])) for sign in octants
    ]  # fmt: skip


def crowded_scene(seed: int = 0) -> Scene:
    """Return a Panda, its table and eight objects of eight pieces."""
    rng = np.random.default_rng([12, seed])
    plain = load_scene(scenario.ArmModel(), [scenario.Fixture()], {})
    bodies = [*plain.clearance.bodies, *(Body.of(f"object {k}", pieces(rng)) for k in range(OBJECTS))]
    return replace(plain, clearance=plain.clearance.among(bodies))


class Crowd:
    """Where the objects are, and where the arm is to go.

    Args:
        scene: of `crowded_scene`.
        seed: draws places and ways.
    """

    home = HOME

    def __init__(self, scene: Scene, seed: int) -> None:
        rng = np.random.default_rng([13, seed])
        self.place = np.zeros((OBJECTS, 3))
        self.turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi, OBJECTS)[:, None])
        taken = [scene.chain.tool(scene.chain.place(HOME[None]))[0, :2, 3]]
        for k in range(OBJECTS):
            p = taken[0]
            while min(np.linalg.norm(p - other) for other in taken) < 0.2:
                p = rng.uniform([0.3, -0.6], [0.85, 0.6])
            taken.append(p)
            self.place[k] = [*p, 0.1]
        self.way = np.zeros((OBJECTS, 3))
        self.way[-MOVING:, :2] = rng.uniform(-0.15, 0.15, (MOVING, 2))
        self.phase = rng.uniform(0.0, 2 * np.pi, OBJECTS)
        self.goals = [np.array([0.0, 1.0, 0.0, 0.0, rng.uniform(0.4, 0.6), y, 0.3]) for y in (-0.35, 0.35)]

    def tracks(self, now: float, rng: np.random.Generator) -> Array:
        """Return packed tracks at a time [s], with noise."""
        rows = np.zeros((OBJECTS, TRACK_SIZE))
        moving = np.any(self.way != 0.0, axis=1)
        rows[:, 0] = np.where(moving, float(ObjectStatus.MOVING), float(ObjectStatus.TRACKED))
        rows[:, 2:6] = self.turn.as_quat()[:, [3, 0, 1, 2]]
        angle = (now + self.phase)[:, None]
        rows[:, 6:9] = self.place + np.sin(angle) * self.way + NOISE * rng.standard_normal((OBJECTS, 3))
        rows[:, 12:15] = np.cos(angle) * self.way
        rows[:, 15:] = np.diag([0.02**2] * 3 + [NOISE**2] * 3).ravel()
        return rows.ravel()

    def goal(self, now: float) -> Array:
        """Return X_WG of the tool at a time [s]."""
        return self.goals[int(now / SWITCH) % 2]
