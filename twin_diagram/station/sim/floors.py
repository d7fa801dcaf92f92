"""Floors without an end (`plane` in MJCF and SDF) as boxes: from half spaces Drake tells no distance."""

from __future__ import annotations

from dataclasses import dataclass

from pydrake.geometry import Box, HalfSpace, SceneGraph
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import BodyIndex


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    reach: float = 10.0
    """From a floor's origin to the sides of its box, and its depth [m]; no arm gets there."""


TUNING = Tuning()


def bound_floors(plant: MultibodyPlant, scene_graph: SceneGraph) -> None:
    """Put a box in the place of each half space that things may touch.

    Args:
        plant: not yet finalized: finalizing it filters collisions, which a shape that is changed forgets.
        scene_graph: its geometry.
    """
    inspector = scene_graph.model_inspector()
    bodies = [plant.get_body(BodyIndex(index)) for index in range(plant.num_bodies())]
    for shape in [shape for body in bodies for shape in plant.GetCollisionGeometriesForBody(body)]:
        if isinstance(inspector.GetShape(shape), HalfSpace):
            X_FG = inspector.GetPoseInFrame(shape) @ RigidTransform([0.0, 0.0, -TUNING.reach])
            box = Box(2 * TUNING.reach, 2 * TUNING.reach, 2 * TUNING.reach)
            scene_graph.ChangeShape(plant.get_source_id(), shape, box, X_FG)
