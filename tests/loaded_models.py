"""Loads the models that come along, alone and with their roots welded, for the tests of models."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from pydrake.geometry import SceneGraph
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, MultibodyPlant
from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from twin_diagram.scenario.resources import models_dir

Array = NDArray[np.float64]

PANDA_JOINTS = tuple(f"panda_joint{k}" for k in range(1, 8))
IIWA_JOINTS = tuple(f"iiwa_joint_{k}" for k in range(1, 8))
UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
UR_JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", *(f"wrist_{k}_joint" for k in (1, 2, 3)))
PANDA_FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
WSG_FINGERS = ("left_finger_sliding_joint", "right_finger_sliding_joint")

HOMES: dict[str, dict[str, list[float]]] = {
    "panda.urdf": {
        "ready": [0, -0.785, 0, -2.356, 0, 1.571, 0.785],
        "over the table": [0, -0.3, 0, -2.2, 0, 2.0, 0.785],
    },
    "iiwa7.urdf": {"upright": [0] * 7, "ready": [0, 0.6, 0, -1.75, 0, 1.0, 0], "bent": [0, 0.3, 0, -1.8, 0, 1.4, 1.57]},
    "ur5e.urdf": {"ready": [0, -1.57, 1.57, -1.57, -1.57, 0], "up": [0, -1.57, 0, -1.57, 0, 0], "zero": [0] * 6},
}
HOMES["panda_hand.urdf"] = {
    f"{name}, {grip}": [*q, *finger]
    for name, q in HOMES["panda.urdf"].items()
    for grip, finger in {"open": [0.04, 0.04], "closed": [0.0, 0.0]}.items()
}
HOMES["iiwa7_wsg.urdf"] = {
    f"{name}, {grip}": [*q, *finger]
    for name, q in HOMES["iiwa7.urdf"].items()
    for grip, finger in {"open": [-0.05, 0.05], "closed": [0.0, 0.0]}.items()
}
ARMS = tuple(sorted(HOMES))
every_arm = pytest.mark.parametrize("arm", ARMS)


class Loaded(NamedTuple):
    """A model with its root welded to the world, alone in a diagram with its scene graph."""

    plant: MultibodyPlant
    scene_graph: SceneGraph
    diagram: Diagram
    root: Context
    context: Context

    def joints(self) -> list[Any]:
        joints = [self.plant.get_joint(index) for index in self.plant.GetJointIndices()]
        return [joint for joint in joints if joint.num_positions() == 1]

    def draw(self, rng: np.random.Generator) -> Array:
        return rng.uniform(self.plant.GetPositionLowerLimits(), self.plant.GetPositionUpperLimits())

    def pose(self, frame: str, base: str | None = None) -> Array:
        frames = [self.plant.world_frame() if base is None else self.plant.GetFrameByName(base)]
        X = self.plant.CalcRelativeTransform(self.context, *frames, self.plant.GetFrameByName(frame))
        return np.asarray(X.GetAsMatrix4())

    def rotors(self) -> Array:
        """Diagonal of what the rotors add to the mass matrix."""
        reflected = np.zeros(self.plant.num_velocities())
        for index in self.plant.GetJointActuatorIndices():
            actuator = self.plant.get_joint_actuator(index)
            inertia = actuator.default_gear_ratio() ** 2 * actuator.default_rotor_inertia()
            reflected[actuator.joint().velocity_start()] = inertia
        return reflected

    def gravity_torque(self) -> Array:
        return -np.asarray(self.plant.CalcGravityGeneralizedForces(self.context))


def load(*paths: Path, root: str | None = None, time_step: float = 0.0, packages: Path | None = None) -> Loaded:
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step)
    parser = Parser(plant)
    parser.SetAutoRenaming(True)
    if packages is not None:
        parser.package_map().Remove("drake_models")
        parser.package_map().Add("drake_models", str(packages))
    for path in paths:
        (instance,) = parser.AddModels(str(path))
        first = plant.get_body(plant.GetBodyIndices(instance)[0])
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(root) if root else first.body_frame())
    plant.Finalize()
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    return Loaded(plant, scene_graph, diagram, context, plant.GetMyMutableContextFromRoot(context))


_cache: dict[str, Loaded] = {}


def load_arm(arm: str) -> Loaded:
    if arm not in _cache:
        _cache[arm] = load(models_dir() / "arms" / arm)
    return _cache[arm]
