"""The plant that holds the truth: arm with its hidden effects, fixtures, free objects and objects that are moved."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path as FilePath

import numpy as np
from pydrake.geometry import CollisionFilterDeclaration, GeometrySet, SceneGraph
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import BodyIndex, ModelInstanceIndex, RigidBody, SpatialInertia, UnitInertia
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from twin_diagram.errors import AssetError, ModelError, ScenarioError
from twin_diagram.model.description.finger_travel import moving_bodies
from twin_diagram.model.description.fixtures import weld_roots
from twin_diagram.scenario import Scenario, WorldObject
from twin_diagram.scenario.resources import resolve
from twin_diagram.station.add_models import add_model, transform
from twin_diagram.station.sim.arm_plant import ArmPlant, add_arm
from twin_diagram.station.sim.floors import bound_floors
from twin_diagram.station.sim.grip_contact import make_gripping, rub, touch_by_surfaces
from twin_diagram.station.sim.linkage import let_hinges_turn
from twin_diagram.station.sim.merged_shapes import merge_shapes
from twin_diagram.station.sim.movers import Path, add_carriage


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    least_step: float = 1e-6
    """Of the simulation [s]: below it a second takes hours, and nothing gets better."""

    load: float = 0.01
    """Radius of a load that is hidden in an object [m]: a lump of lead of 50 g."""


TUNING = Tuning()


@dataclass(frozen=True)
class WorldPlant:
    """The truth, finalized.

    Attributes:
        plant: discrete, at the scenario's ``world.time_step``.
        scene_graph: its geometry.
        arm: the arm's part of it.
        objects: body of each object, in the scenario's order.
        fixtures: bodies that stand still.
        paths: of the objects that are moved, by name.
        carriages: model instance of their carriages; None where nothing moves.
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph
    arm: ArmPlant
    objects: dict[str, BodyIndex]
    fixtures: list[BodyIndex]
    paths: dict[str, Path] = field(default_factory=dict)
    carriages: ModelInstanceIndex | None = None


@dataclass(frozen=True)
class Appearance:
    """A second SceneGraph that shows the world at any positions of its plant, whatever the plant itself does.

    Attributes:
        plant: a copy of the world's, finalized; it is in no Diagram.
        poses: takes positions (nq, as the world's plant orders them).
        scene_graph: what is shown.
        objects: body of each object, in the scenario's order, as in `WorldPlant`.
    """

    plant: MultibodyPlant
    poses: MultibodyPositionToGeometryPose
    scene_graph: SceneGraph
    objects: dict[str, BodyIndex]


def build_world(builder: DiagramBuilder, scenario: Scenario) -> WorldPlant:
    """Add plant and SceneGraph of a scenario's ``world`` to `builder`.

    Raises:
        ScenarioError, ModelError, AssetError: something in it cannot be built; the message names it.
    """
    if not scenario.world.time_step > 0:
        raise ScenarioError("world.time_step", f"{scenario.world.time_step} is not positive")
    if not scenario.world.time_step >= TUNING.least_step:
        raise ScenarioError("world.time_step", f"{scenario.world.time_step} s is less than {TUNING.least_step:g} s")
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, scenario.world.time_step)
    world = _populate(plant, scene_graph, scenario)
    objects = [plant.get_body(index) for index in world.objects.values()]
    for (name, spec), body in zip(scenario.world.objects.items(), objects, strict=True):
        if spec.friction is not None:
            if not (np.isfinite(spec.friction) and spec.friction >= 0.0):
                raise ScenarioError(f"world.objects.{name}.friction", f"{spec.friction} is no coefficient of friction")
            rub(plant, scene_graph, body, spec.friction)
    touch_by_surfaces(plant, scene_graph, moving_bodies(plant, world.arm.arm), objects)
    if world.arm.linkage is not None:
        let_hinges_turn(plant, scene_graph, world.arm.arm, world.arm.linkage)
    return world


def build_appearance(
    builder: DiagramBuilder, scenario: Scenario, name: str = "appearance", *, merged: bool = True
) -> Appearance:
    """Add a second SceneGraph that shows the world.

    Args:
        builder: of the station.
        scenario: the one whose world was built.
        name: of the SceneGraph, in the builder.
        merged: whether each body's plain shapes become one mesh; a renderer draws that faster.
    """
    scene_graph = builder.AddNamedSystem(name, SceneGraph())
    plant = MultibodyPlant(scenario.world.time_step)
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    objects = _populate(plant, scene_graph, scenario).objects
    source = plant.get_source_id()
    if merged:
        merge_shapes(scene_graph, source)
    poses = builder.AddNamedSystem(f"{name}_poses", MultibodyPositionToGeometryPose(plant))
    builder.Connect(poses.get_output_port(), scene_graph.get_source_pose_port(source))
    return Appearance(plant, poses, scene_graph, objects)


def _populate(plant: MultibodyPlant, scene_graph: SceneGraph, scenario: Scenario) -> WorldPlant:
    world = scenario.world
    plant.set_name("world")
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kLagged)
    # Without sampling the plant's update is a discrete one, which copies no image that another system keeps.
    plant.SetUseSampledOutputPorts(False)
    arm = add_arm(plant, scenario)
    fixtures = _add_fixtures(plant, scenario)
    bodies: dict[str, RigidBody] = {}
    paths: dict[str, Path] = {}
    for name, spec in world.objects.items():
        _check_told(name, spec)
        body = _add_object(plant, name, spec, scenario)
        bodies[name] = body
        if spec.path:
            paths[name] = Path(spec.path, f"world.objects.{name}.path")
        else:
            plant.SetDefaultFloatingBaseBodyPose(body, transform(spec.X_WO, f"world.objects.{name}.X_WO"))
    carriages = plant.AddModelInstance("carriages") if paths else None
    for name, path in paths.items():
        assert carriages is not None
        add_carriage(plant, carriages, name, path, bodies[name], world.objects[name].push)
    make_gripping(plant, arm.fingers)
    bound_floors(plant, scene_graph)
    plant.Finalize()
    # What is moved on a carriage needs no table to stand on, and the arm's base stands in it.
    standing = [plant.get_body(arm.arm.base), *(bodies[name] for name in paths)]
    unmet = GeometrySet([g for body in standing for g in plant.GetCollisionGeometriesForBody(body)])
    still = GeometrySet([g for body in fixtures for g in plant.GetCollisionGeometriesForBody(body)])
    scene_graph.collision_filter_manager().Apply(CollisionFilterDeclaration().ExcludeBetween(unmet, still))
    return WorldPlant(
        plant,
        scene_graph,
        arm,
        {name: body.index() for name, body in bodies.items()},
        [body.index() for body in fixtures],
        paths,
        carriages,
    )


def _add_fixtures(plant: MultibodyPlant, scenario: Scenario) -> list[RigidBody]:
    bodies: list[RigidBody] = []
    for i, fixture in enumerate(scenario.world.fixtures):
        field_name = f"world.fixtures[{i}]"
        try:
            instances = add_model(plant, f"fixture{i}", scenario.packages, fixture.model, still=True)
        except ModelError as error:
            raise ScenarioError(f"{field_name}.model", str(error)) from error
        weld_roots(plant, instances, transform(fixture.X_WB, f"{field_name}.X_WB"))
        bodies += [plant.get_body(b) for instance in instances for b in plant.GetBodyIndices(instance)]
    return bodies


def _check_told(name: str, spec: WorldObject) -> None:
    """Raise ScenarioError for what cannot be, or would have no effect."""
    push, at = spec.push, spec.load_at
    if push is not None and not (np.isfinite(push) and push > 0.0):
        raise ScenarioError(f"world.objects.{name}.push", f"{push} N is not positive")
    if push is not None and not spec.path:
        raise ScenarioError(f"world.objects.{name}.push", f"{push} N push nothing without a path")
    if at is not None and not (len(at) == 3 and np.isfinite(at).all()):
        raise ScenarioError(f"world.objects.{name}.load_at", f"{at} is not three numbers")
    if at is not None and spec.mass is None:
        raise ScenarioError(f"world.objects.{name}.load_at", f"{at}: nothing sits there without a mass")


def _add_object(plant: MultibodyPlant, name: str, spec: WorldObject, scenario: Scenario) -> RigidBody:
    file = object_model(name, spec, scenario)
    try:
        instances = add_model(plant, name, scenario.packages, str(file))
    except ModelError as error:
        raise AssetError(f"world.objects.{name}.asset: {error}") from error
    if len(instances) != 1 or not plant.HasBodyNamed("object", instances[0]):
        raise AssetError(f"world.objects.{name}.asset: {file} is not one model with one link called `object`")
    body = plant.GetBodyByName("object", instances[0])
    if spec.mass is not None:
        _make_heavier(plant, body, spec, f"world.objects.{name}")
    return body


def _make_heavier(plant: MultibodyPlant, body: RigidBody, spec: WorldObject, field: str) -> None:
    """Weld to a body what it lacks of a mass [kg], with the same middle and gyration, or as a ball."""
    own = body.default_spatial_inertia()
    assert spec.mass is not None
    more = spec.mass - own.get_mass()
    if not (np.isfinite(spec.mass) and more >= 0.0):
        raise ScenarioError(f"{field}.mass", f"{spec.mass} kg is less than the asset's own, {own.get_mass():g} kg")
    if more > 0.0:
        inertia = SpatialInertia(more, own.get_com(), own.get_unit_inertia())
        if spec.load_at is not None:
            at = np.array(spec.load_at)
            ball = UnitInertia.SolidSphere(TUNING.load).ShiftFromCenterOfMass(-at)
            inertia = SpatialInertia(more, at, ball)
        load = plant.AddRigidBody("load", body.model_instance(), inertia)
        plant.WeldFrames(body.body_frame(), load.body_frame())


def object_model(name: str, spec: WorldObject, scenario: Scenario) -> FilePath:
    """Return the description of an object's asset.

    Raises:
        AssetError: no such asset; the message names the field.
    """
    try:
        folder = resolve(spec.asset, scenario.packages) if spec.asset else None
    except ModelError as error:
        raise AssetError(f"world.objects.{name}.asset: {error}") from error
    if folder is None or not (folder / "model.sdf").is_file():
        raise AssetError(f"world.objects.{name}.asset: {spec.asset!r} is no asset: no model.sdf in {folder}")
    return folder / "model.sdf"
