"""The twin's own scene: arm, fixtures and library objects in a plant that nothing but estimates moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from pydrake.geometry import SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.framework import DiagramBuilder, InputPort, OutputPort
from pydrake.systems.rendering import MultibodyPositionToGeometryPose

from twin_diagram import scenario
from twin_diagram.assets.description import AssetSpec, read_spec
from twin_diagram.errors import AssetError, ModelError
from twin_diagram.model.description import add_arm as description
from twin_diagram.model.description.fixtures import add_fixture
from twin_diagram.model.description.followers import Followers
from twin_diagram.model.description.foreign import add_models
from twin_diagram.scenario import resources
from twin_diagram.scene.slot_geometry import Shapes, SlotFrames, SlotPoses, add_slot_frames, library_shapes
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Where unseen objects wait, chosen by hand: out of every camera's sight and of the arm's reach."""

    parked_height: float = -5.0
    """Where objects wait that nobody has seen yet: z in W [m]; they stand a metre apart along x."""


TUNING = Tuning()


@dataclass(frozen=True)
class Kind:
    """What counts of an object besides where it is.

    Attributes:
        name: of the object.
        axis: (3,) of symmetry in O, zeros where there is none.
        radius: of a ball about O's origin that holds it [m].
        shapes: that stand for it in the scene; None: those of the plant's body.
    """

    name: str
    axis: Array
    radius: float
    shapes: Shapes | None = None

    @staticmethod
    def of(name: str, spec: AssetSpec, shapes: Shapes | None = None) -> Kind:
        """Return it as an asset's description has it."""
        axis = np.array([0.0, 0.0, float(spec.symmetric_axis == "z")])
        return Kind(name, axis, 0.5 * float(np.linalg.norm(spec.size)), shapes)


@dataclass(frozen=True)
class TwinScene:
    """The twin's plant and where each estimate goes in its positions.

    Attributes:
        plant: finalized; arm, fixtures and one free body `object` per library object, whose model instance has the
            library's name. It is no part of the Diagram: it only says which position moves which frame.
        scene_graph: the twin's own, part of the Diagram.
        object_names: the library's names, in order; K of them.
        arm: the arm in `plant`.
        arm_position_index: (n,) of the arm's joints in the plant's positions.
        gripper_position_index: (g,) of the finger joints.
        followers: joints that follow these.
        object_position_index: (K, 7) of the objects' (qw, qx, qy, qz, px, py, pz).
        slots: frames for further instances and unknown things.
        kinds: of the library's objects, in order, then of those that were added later.
        default_positions: (nq,) fingers as described, arm at home, objects parked out of sight.
        positions_input: (nq) positions of `plant`; connect `SceneGraphUpdater`'s `positions`.
        further_input: (F · FURTHER_TRACK_SIZE) further instances; connect `SceneGraphUpdater`'s `further_tracks`, or
            leave it open where there are none.
        query_output: the scene graph's `query` port.
    """

    plant: MultibodyPlant
    scene_graph: SceneGraph
    object_names: tuple[str, ...]
    arm: description.Arm
    arm_position_index: np.ndarray
    gripper_position_index: np.ndarray
    followers: Followers
    object_position_index: np.ndarray
    kinds: list[Kind]
    slots: SlotFrames
    default_positions: Array
    positions_input: InputPort
    further_input: InputPort
    query_output: OutputPort

    def add_kind(self, name: str, folder: Path, packages: Mapping[str, str | Path] | None = None) -> int:
        """Take in the shapes of an asset that came later; answer its number.

        Raises:
            AssetError: its model cannot be read.
        """
        scene_graph, plant = SceneGraph(), MultibodyPlant(time_step=0.0)
        plant.RegisterAsSourceForSceneGraph(scene_graph)
        spec = _add_object(plant, name, str(folder), packages)
        plant.Finalize()
        body = plant.GetBodyByName("object", plant.GetModelInstanceByName(name))
        shapes = library_shapes(scene_graph, plant.GetBodyFrameIdOrThrow(body.index()))
        self.kinds.append(Kind.of(name, spec, shapes))
        return len(self.kinds) - 1

    def shapes_of(self, asset: int) -> Shapes:
        """Return the shapes of one of the known objects, by its number, for another instance of it."""
        if (own := self.kinds[asset].shapes) is not None:
            return own
        body = self.plant.GetBodyByName("object", self.plant.GetModelInstanceByName(self.object_names[asset]))
        return library_shapes(self.scene_graph, self.plant.GetBodyFrameIdOrThrow(body.index()))


def add_twin_scene(
    builder: DiagramBuilder, twin: scenario.Twin, packages: Mapping[str, str | Path] | None = None
) -> TwinScene:
    """Add the twin's SceneGraph (`twin_scene_graph`) and what poses its frames (`twin_positions_to_poses`).

    Args:
        builder: of the Diagram that will hold the twin.
        twin: names the arm, the fixtures and the library.
        packages: local folders for `package://` names.

    Raises:
        ModelError, AssetError: a model or an asset that is missing or malformed.
    """
    scene_graph = cast(SceneGraph, builder.AddNamedSystem("twin_scene_graph", SceneGraph()))
    plant = MultibodyPlant(time_step=0.0)
    plant.set_name("twin_plant")
    source = plant.RegisterAsSourceForSceneGraph(scene_graph)
    arm = description.add_arm(plant, twin.arm, packages)
    for fixture in twin.fixtures:
        add_fixture(plant, fixture, packages)
    specs = [_add_object(plant, name, folder, packages) for name, folder in twin.library.items()]
    plant.Finalize()

    names = tuple(twin.library)
    objects = np.array([_free_positions(plant, name) for name in names], dtype=int).reshape(-1, 7)
    arm_index = np.array([plant.get_joint(index).position_start() for index in arm.joint_indices], dtype=int)
    gripper = np.array([plant.get_joint(index).position_start() for index in arm.gripper_joint_indices], dtype=int)
    default = np.array(plant.GetDefaultPositions())
    if twin.home:
        if len(twin.home) != len(arm_index):
            raise ModelError(f"twin.home: {len(twin.home)} angles for the {len(arm_index)} joints {arm.joints}")
        default[arm_index] = twin.home
    default[objects] = parked_poses(len(names))

    slots = add_slot_frames(scene_graph, twin.slots.further(len(names)), twin.slots.unknown)
    slot_poses = builder.AddNamedSystem("twin_slots_to_poses", SlotPoses(slots))
    builder.Connect(slot_poses.get_output_port(), scene_graph.get_source_pose_port(slots.source))
    to_poses = builder.AddNamedSystem("twin_positions_to_poses", MultibodyPositionToGeometryPose(plant))
    builder.Connect(to_poses.get_output_port(), scene_graph.get_source_pose_port(source))
    return TwinScene(
        plant=plant,
        scene_graph=scene_graph,
        object_names=names,
        arm=arm,
        arm_position_index=arm_index,
        gripper_position_index=gripper,
        followers=Followers.of(plant, arm),
        object_position_index=objects,
        kinds=[Kind.of(name, spec) for name, spec in zip(names, specs, strict=True)],
        slots=slots,
        default_positions=default,
        positions_input=to_poses.get_input_port(),
        further_input=slot_poses.get_input_port(),
        query_output=scene_graph.get_query_output_port(),
    )


def parked_poses(count: int) -> Array:
    """Return (count, 7) poses out of sight, below everything and clear of one another."""
    poses = np.zeros((count, 7))
    poses[:, 0] = 1.0
    poses[:, 4] = np.arange(count)
    poses[:, 6] = TUNING.parked_height
    return poses


def _add_object(plant: MultibodyPlant, name: str, folder: str, packages: Mapping[str, str | Path] | None) -> AssetSpec:
    """Parse an asset's model as a free body in a model instance of the object's name."""
    path = resources.resolve(folder, packages)
    spec = read_spec(path)
    try:
        instances = add_models(description.parser(plant, packages), path / "model.sdf")
    except (RuntimeError, ValueError, TypeError, KeyError) as error:
        raise AssetError(f"{path}: {str(error).strip().splitlines()[0]}") from error
    if len(instances) != 1 or not plant.HasBodyNamed("object", instances[0]):
        raise AssetError(f"{path / 'model.sdf'}: must hold one model with the link `object`")
    if plant.GetModelInstanceName(instances[0]) != name:
        if plant.HasModelInstanceNamed(name):
            raise AssetError(f"twin.library.{name}: something else in the scene has this name; choose another")
        plant.RenameModelInstance(instances[0], name)
    return spec


def _free_positions(plant: MultibodyPlant, name: str) -> list[int]:
    """Return the seven position indices of a free body."""
    instance = plant.GetModelInstanceByName(name)
    joints = [plant.get_joint(index) for index in plant.GetJointIndices(instance)]
    if len(joints) != 1 or joints[0].num_positions() != 7:
        raise AssetError(f"twin.library.{name}: the model must be one free body; it has {len(joints)} joints")
    start = joints[0].position_start()
    return list(range(start, start + 7))
