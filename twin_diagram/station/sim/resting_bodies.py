"""Holds still what lies still: bodies at rest that nothing is near to are locked, and cost a step's solver nothing.

What lies in a bin keeps some 20 constraints a body in the solver of each step, half of what a step costs, to stay where
it is. As other engines' islands sleep, a body is locked once it, and all that is near to it, has been at rest for a
while, and is free again before anything that moves comes near: to what is awake it is as solid as ever.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydrake.geometry import SceneGraphInspector
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex, RigidBody
from pydrake.systems.framework import Context

from twin_diagram.signals.arrays import Array
from twin_diagram.station.sim.world_plant import WorldPlant

Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    moved: float = 3e-3
    """No point of a body at rest has gone farther in `still` [m]: of a heap of five what leans creeps by 1.2 to 2.4, by
    how the solver smooths friction. Speeds tell less: what rests trembles at 1 to 3 mm/s, by micrometres. Other engines
    hold what is slower than 10 mm/s."""

    still: float = 0.5
    """As long it has been at rest before it is locked [s]: what stands on an edge goes a hundred times farther from it
    meanwhile, so that it falls or has stood."""

    near: float = 0.05
    """Balls about two bodies that are nearer than this are near each other [m]: at 2 m/s one comes 4 cm nearer from one
    look to the next."""

    look: float = 0.02
    """Between two looks [s]."""


TUNING = Tuning()


@dataclass(frozen=True)
class BodyBall:
    """A ball that holds all of a body that others may touch: its centre (3,) in B, its radius [m]."""

    centre: Array
    radius: float


class RestingBodies:
    """The free bodies of one world; what of them is locked is known here alone, and is in no snapshot.

    Attributes:
        asleep: numbers of those that are locked by this.
    """

    def __init__(
        self,
        plant: MultibodyPlant,
        inspector: SceneGraphInspector,
        bodies: Mapping[str, BodyIndex],
        moving: Sequence[BodyIndex],
    ) -> None:
        """Name them.

        Args:
            plant: of the world, finalized.
            inspector: of its shapes.
            bodies: that lie about, by name; those that do not float freely count as what moves.
            moving: all bodies of what moves by itself.
        """
        free = [plant.get_body(index) for index in bodies.values()]
        # A locked body that touches shapes of the world's own body, and not of one welded to it, ends the process:
        # Drake 1.51 solves for a contact of which neither side can move.
        lockable = not plant.GetCollisionGeometriesForBody(plant.world_body())
        self._free = [body for body in free if lockable and body.is_floating_base_body()]
        driven = [plant.get_body(index) for index in moving] + [one for one in free if one not in self._free]
        self._balls = [ball_about(plant, inspector, body) or BodyBall(np.zeros(3), np.inf) for body in self._free]
        kept = [(body, ball) for body in driven if (ball := ball_about(plant, inspector, body)) is not None]
        self._driven, self._driven_balls = [body for body, _ in kept], [ball for _, ball in kept]
        self._at_rest_since = np.zeros(len(self._free))
        self._rest_at = np.full((len(self._free), 3, 4), np.inf)
        self._rest_places = np.full((len(self._free), 3), np.inf)
        self._looked = -np.inf
        self.asleep: set[int] = set()

    @staticmethod
    def of(world: WorldPlant) -> RestingBodies:
        """Return those of a world, in which its arm moves."""
        plant = world.plant
        moving = [body for instance in world.arm.arm.instances for body in plant.GetBodyIndices(instance)]
        return RestingBodies(plant, world.scene_graph.model_inspector(), world.objects, moving)

    def looked_at(self, context: Context) -> None:
        """Lock and free what is to be, before time goes on in the plant's context."""
        now = context.get_time()
        if not self._free or 0.0 <= now - self._looked < TUNING.look - 1e-6:
            return
        self._looked = now
        poses = _poses(self._free, context)
        places, radii = _balls_in(poses, self._balls)
        others, their_radii = _balls_in(_poses(self._driven, context), self._driven_balls)
        gap = np.linalg.norm(places[:, None] - others, axis=2) - radii[:, None] - their_radii
        turned = np.linalg.norm(poses[:, :, :3] - self._rest_at[:, :, :3], axis=(1, 2)) / np.sqrt(2.0)
        went = np.linalg.norm(places - self._rest_places, axis=1) + radii * turned
        moves = ~(went <= TUNING.moved)
        self._rest_at[moves], self._rest_places[moves] = poses[moves], places[moves]
        disturbed = (gap < TUNING.near).any(axis=1) | moves
        between = np.linalg.norm(places[:, None] - places, axis=2) - radii[:, None] - radii
        awake = spread(disturbed, between < TUNING.near)
        self._at_rest_since[awake] = now
        resting = now - self._at_rest_since >= TUNING.still
        for number, body in enumerate(self._free):
            if awake[number] and number in self.asleep:
                body.Unlock(context)
                self.asleep.discard(number)
            elif resting[number] and not body.is_locked(context):
                body.Lock(context)
                self.asleep.add(number)

    def wake(self, context: Context) -> None:
        """Free all that is locked by this: somebody puts things elsewhere."""
        for number in self.asleep:
            self._free[number].Unlock(context)
        self.asleep.clear()
        self._at_rest_since[:], self._looked = context.get_time(), -np.inf


def ball_about(plant: MultibodyPlant, inspector: SceneGraphInspector, body: RigidBody) -> BodyBall | None:
    """Return a ball about a body's collision shapes; None: it has none, or one without an end."""
    corners = []
    for geometry in plant.GetCollisionGeometriesForBody(body):
        box = inspector.GetObbInGeometryFrame(geometry)
        if box is None:
            return None
        signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1)
        in_frame = box.pose().multiply(np.asarray(box.half_width())[:, None] * signs)
        X_FG = inspector.GetPoseInFrame(geometry)
        corners.append(X_FG.multiply(in_frame).T)
    if not corners:
        return None
    points = np.concatenate(corners)
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return BodyBall(centre, float(np.linalg.norm(points - centre, axis=1).max()))


def spread(some: Flags, near: Flags) -> Flags:
    """Return which (N,) are some, or near (N, N) to any that is, and so on."""
    while ((wider := some | near[:, some].any(axis=1)) != some).any():
        some = wider
    return some


def _poses(bodies: Sequence[RigidBody], context: Context) -> Array:
    """Return poses (N, 3, 4) of bodies in W."""
    return np.array([body.EvalPoseInWorld(context).GetAsMatrix34() for body in bodies]).reshape(-1, 3, 4)


def _balls_in(poses: Array, balls: Sequence[BodyBall]) -> tuple[Array, Array]:
    """Return centres (N, 3) in W and radii (N,) of balls whose bodies are at poses (N, 3, 4) [m]."""
    centres = np.array([ball.centre for ball in balls]).reshape(-1, 3)
    places = np.einsum("nij,nj->ni", poses[:, :, :3], centres) + poses[:, :, 3]
    return places, np.array([ball.radius for ball in balls])
