"""Scenarios: one typed YAML file in two parts, the world and what the twin is told about it.

``world:`` holds what a simulated station needs (true poses, hidden effects, sensor defects); ``twin:`` holds all
that the twin knows. The twin is built from ``twin:`` alone. All units SI, angles in radians, X_AB as in Drake.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.scenario.braking import Braking
    from twin_diagram.scenario.camera import Camera, DepthCamera, DepthNoise
    from twin_diagram.scenario.defects import ArmDefects, CameraDefects, LidarDefects, SensorDefects
    from twin_diagram.scenario.estimation import Drift, Filter, Healing, SensorSpec
    from twin_diagram.scenario.file import load_scenario, override_scenario, save_scenario
    from twin_diagram.scenario.growing import Growing
    from twin_diagram.scenario.learning import Learning
    from twin_diagram.scenario.models import ArmModel, EffectSpec, Fixture, Pose
    from twin_diagram.scenario.perception import Perception, Registration, SceneUpdater, Slots
    from twin_diagram.scenario.planning import Planner, Task, TaskStep
    from twin_diagram.scenario.resources import models_dir, resolve
    from twin_diagram.scenario.scenario import Scenario
    from twin_diagram.scenario.sensors import Driver, Lidar, LinkSensor
    from twin_diagram.scenario.station import LcmStation, ReplayStation
    from twin_diagram.scenario.twin import Twin
    from twin_diagram.scenario.world import WayPoint, World, WorldCamera, WorldObject

__all__ = [
    "ArmDefects",
    "ArmModel",
    "Braking",
    "Camera",
    "CameraDefects",
    "DepthCamera",
    "DepthNoise",
    "Drift",
    "Driver",
    "EffectSpec",
    "Filter",
    "Fixture",
    "Growing",
    "Healing",
    "LcmStation",
    "Learning",
    "Lidar",
    "LidarDefects",
    "LinkSensor",
    "Perception",
    "Planner",
    "Pose",
    "Registration",
    "ReplayStation",
    "Scenario",
    "SceneUpdater",
    "SensorDefects",
    "SensorSpec",
    "Slots",
    "Task",
    "TaskStep",
    "Twin",
    "WayPoint",
    "World",
    "WorldCamera",
    "WorldObject",
    "load_scenario",
    "models_dir",
    "override_scenario",
    "resolve",
    "save_scenario",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
