"""Lets a simulated gripper hold what it closes on: soft pads, fingers that move together, surfaces instead of points.

With point contact a finger touches a box at one point, about which it swings. Pads that are compliant hydroelastic
shapes meet objects that are rigid ones in a patch, whose pressure holds a box off its centre, too. What stands on
tables and floors keeps its point contact, which is cheaper: those have no hydroelastic shape, and Drake falls back.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddRigidHydroelasticProperties,
    Box,
    Capsule,
    Convex,
    Cylinder,
    Ellipsoid,
    GeometryId,
    HalfSpace,
    Mesh,
    ProximityProperties,
    RoleAssign,
    SceneGraph,
    Shape,
    Sphere,
)
from pydrake.multibody.plant import ContactModel, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import Joint, PrismaticJoint, RigidBody

from twin_diagram.station.sim.fine_pads import refine, reshape

COMPLIANCE = ("hydroelastic", "compliance_type")
"""Where Drake keeps whether a shape is rigid or compliant: a description that says so is heeded."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    modulus: float = 2e6
    """Of fingers whose description says nothing of pads [Pa]: that of the pads that the project's own grippers have,
    silicone of some 2 MPa."""

    creep: float = 1e-5
    """Speed below which what touches is at rest for the solver [m/s]: Drake's own 1e-4 lets a held object slide by as
    much as a millimetre in 10 s."""

    facets: float = 0.35
    """Edge of a round rigid shape's facets, as a share of its least radius: a pad sees a cylinder as one."""

    finest: float = 0.0025
    """No such facet is asked to be finer [m], a fifth of what pads are made of: the 2 mm balls on which things stand
    had 320 of half a millimetre, and with one in a pad a bottle's contact was of 450 points instead of 110."""


TUNING = Tuning()


def make_gripping(plant: MultibodyPlant, fingers: Sequence[Joint]) -> None:
    """Have surfaces meet in patches, what is held stay, and fingers move together; before the plant is finalized."""
    plant.set_contact_model(ContactModel.kHydroelasticWithFallback)
    plant.set_stiction_tolerance(TUNING.creep)
    couple_fingers(plant, fingers)


def couple_fingers(plant: MultibodyPlant, fingers: Sequence[Joint]) -> None:
    """Make two sliding fingers move together, as one motor and a rack do; before the plant is finalized.

    Without it a held object drifts along the closing axis: the fingers' forces balance anywhere. Grippers of another
    kind, and those whose description couples them itself (``<mimic>``), stay as they are.
    """
    if len(fingers) != 2 or not all(isinstance(finger, PrismaticJoint) for finger in fingers):
        return
    if plant.num_constraints() > 0:
        return
    first, second = fingers
    lower = np.array([finger.position_lower_limits()[0] for finger in fingers])
    upper = np.array([finger.position_upper_limits()[0] for finger in fingers])
    if not np.all(np.isfinite([lower, upper])):
        return
    same = bool(np.allclose(lower, lower[0]) and np.allclose(upper, upper[0]))
    opposite = bool(np.isclose(lower[0], -upper[1]) and np.isclose(upper[0], -lower[1]))
    if same or opposite:
        plant.AddCouplerConstraint(first, second, 1.0 if same else -1.0)


def touch_by_surfaces(
    plant: MultibodyPlant, scene_graph: SceneGraph, fingers: Iterable[RigidBody], objects: Iterable[RigidBody]
) -> None:
    """Let the fingers' pads and objects meet in patches; after the plant is finalized.

    Args:
        plant: of the world.
        scene_graph: its geometry; proximity properties of the shapes concerned are replaced.
        fingers: bodies that move with the gripper's joints.
        objects: bodies that can be held.
    """
    for finger in fingers:
        shapes = plant.GetCollisionGeometriesForBody(finger)
        if not any(_told(scene_graph, shape) for shape in shapes):
            for shape in shapes:
                _make_compliant(plant, scene_graph, shape)
        for shape in shapes:
            if _told(scene_graph, shape):
                refine(plant, scene_graph, shape)
    for body in objects:
        for shape in plant.GetCollisionGeometriesForBody(body):
            if not _told(scene_graph, shape):
                _make_rigid(plant, scene_graph, shape)


def rub(plant: MultibodyPlant, scene_graph: SceneGraph, body: RigidBody, friction: float) -> None:
    """Give all shapes of a body a coefficient of friction; after the plant is finalized."""
    for shape in plant.GetCollisionGeometriesForBody(body):
        properties = ProximityProperties(scene_graph.model_inspector().GetProximityProperties(shape))
        properties.UpdateProperty("material", "coulomb_friction", CoulombFriction(friction, friction))
        _replace(plant, scene_graph, shape, properties)


def _told(scene_graph: SceneGraph, geometry: GeometryId) -> bool:
    return bool(scene_graph.model_inspector().GetProximityProperties(geometry).HasProperty(*COMPLIANCE))


def _make_compliant(plant: MultibodyPlant, scene_graph: SceneGraph, geometry: GeometryId) -> None:
    shape = scene_graph.model_inspector().GetShape(geometry)
    if isinstance(shape, HalfSpace):
        return
    if isinstance(shape, Mesh):  # a surface alone cannot be soft; its hull is what Drake takes a mesh for elsewhere
        shape = Convex(shape.source(), shape.scale3())
        reshape(plant, scene_graph, geometry, shape)
    properties = ProximityProperties(scene_graph.model_inspector().GetProximityProperties(geometry))
    AddCompliantHydroelasticProperties(_facet(shape), TUNING.modulus, properties)
    _replace(plant, scene_graph, geometry, properties)


def _make_rigid(plant: MultibodyPlant, scene_graph: SceneGraph, geometry: GeometryId) -> None:
    shape = scene_graph.model_inspector().GetShape(geometry)
    properties = ProximityProperties(scene_graph.model_inspector().GetProximityProperties(geometry))
    if isinstance(shape, HalfSpace):
        AddRigidHydroelasticProperties(properties)
    else:
        AddRigidHydroelasticProperties(_facet(shape), properties)
    _replace(plant, scene_graph, geometry, properties)


def _replace(
    plant: MultibodyPlant, scene_graph: SceneGraph, geometry: GeometryId, properties: ProximityProperties
) -> None:
    scene_graph.AssignRole(plant.get_source_id(), geometry, properties, RoleAssign.kReplace)


def _facet(shape: Shape) -> float:
    """Return the edge of a shape's facets [m]; shapes with flat faces have those, whatever is asked for."""
    if isinstance(shape, (Cylinder, Sphere, Capsule)):
        return max(TUNING.facets * float(shape.radius()), TUNING.finest)
    if isinstance(shape, Ellipsoid):
        return max(TUNING.facets * float(min(shape.a(), shape.b(), shape.c())), TUNING.finest)
    if isinstance(shape, Box):
        return float(np.max(shape.size()))
    return 1.0 if isinstance(shape, (Convex, Mesh)) else 0.01
