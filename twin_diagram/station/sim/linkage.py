"""A simulated hand whose fingers a linkage carries: how far it is open, and which of its parts do not meet.

The bars of a linkage overlap at their hinges, and few descriptions by others say that they pass through each other
there: a simulated hand would jam.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, SceneGraph
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import DiagramBuilder

from twin_diagram import scenario
from twin_diagram.model.description.add_arm import Arm, add_arm
from twin_diagram.model.description.finger_travel import FingerTravel, at_share, moving_bodies, travel_of, turns
from twin_diagram.signals.arrays import Array

APART = (1.0, 0.5)
"""Shares of its travel at which a hand's two sides do not touch: what overlaps there is hinged."""


@dataclass(frozen=True)
class Linkage:
    """What a simulated hand must be told of its linkage.

    Attributes:
        travel: of its joints; None: its pads are not carried straight.
        hinged: pairs of bodies that overlap when the hand is open, by their places among the arm's bodies.
    """

    travel: FingerTravel | None
    hinged: tuple[tuple[int, int], ...]


def linkage_of(spec: scenario.ArmModel, packages: Mapping[str, str | Path]) -> Linkage | None:
    """Return the linkage of a described arm's hand, from a plant of its own; None where all of its joints slide.

    Raises:
        ModelError, ScenarioError: the description cannot be read.
    """
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.0)
    arm = add_arm(plant, spec, packages)
    if not turns(plant, arm):
        return None
    plant.Finalize()
    travel = travel_of(plant, arm)
    if travel is None:
        return Linkage(None, ())
    diagram = builder.Build()
    root = diagram.CreateDefaultContext()
    own, shapes = plant.GetMyMutableContextFromRoot(root), scene_graph.GetMyContextFromRoot(root)
    places = {int(body): k for k, body in enumerate(_bodies(plant, arm))}
    hand = {int(body.index()) for body in moving_bodies(plant, arm)}
    hinged: set[tuple[int, int]] = set()
    for share in APART:
        plant.SetPositions(own, plant.GetPositions(at_share(plant, arm, share, travel)))
        query: Any = scene_graph.get_query_output_port().Eval(shapes)
        for pair in query.ComputePointPairPenetration():
            a, b = (_body(plant, scene_graph, shape) for shape in (pair.id_A, pair.id_B))
            if {a, b} & hand and a in places and b in places:
                hinged.add((min(places[a], places[b]), max(places[a], places[b])))
    return Linkage(travel, tuple(sorted(hinged)))


def let_hinges_turn(plant: MultibodyPlant, scene_graph: SceneGraph, arm: Arm, linkage: Linkage) -> None:
    """Let a hand's hinged bodies pass through each other; after the plant is finalized."""
    bodies = _bodies(plant, arm)
    for pair in linkage.hinged:
        one, other = (GeometrySet(plant.GetCollisionGeometriesForBody(plant.get_body(bodies[k]))) for k in pair)
        scene_graph.collision_filter_manager().Apply(CollisionFilterDeclaration().ExcludeBetween(one, other))


def levers(linkage: Linkage | None, fingers: Array, driven: list[int]) -> Array | float:
    """Return what torque of each driven finger is one newton between the pads (k,) [m]; 1 of those that slide."""
    travel = None if linkage is None else linkage.travel
    return 1.0 if travel is None else travel.lever(fingers)[driven]


def _bodies(plant: MultibodyPlant, arm: Arm) -> list[BodyIndex]:
    return [body for instance in arm.instances for body in plant.GetBodyIndices(instance)]


def _body(plant: MultibodyPlant, scene_graph: SceneGraph, shape: Any) -> int:
    frame = scene_graph.model_inspector().GetFrameId(shape)
    return int(cast(Any, plant.GetBodyFromFrameId(frame)).index())
