"""What a simulated station needs, and nobody else may know."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.defects import ArmDefects, CameraDefects, LidarDefects, SensorDefects
from twin_diagram.scenario.models import ArmModel, Fixture, Pose


@dataclass
class WayPoint:
    """Where a moving object is at a time; between way points it moves on a smooth curve."""

    time: float = 0.0
    X_WO: Pose = field(default_factory=Pose)


@dataclass
class WorldObject:
    """A real object of a simulated world."""

    asset: str = ""
    """Folder of the asset."""
    X_WO: Pose = field(default_factory=Pose)
    path: list[WayPoint] = field(default_factory=list)
    """Empty: it lies free on the table. Otherwise it is pushed along (x, y and yaw only)."""


@dataclass
class World:
    """What a simulated station needs, and nobody else may know."""

    arm: ArmModel = field(default_factory=ArmModel)
    q0: list[float] = field(default_factory=list)
    """Joint angles at the start [rad]; empty: the twin's `home`."""
    time_step: float = 0.0025
    objects: dict[str, WorldObject] = field(default_factory=dict)
    fixtures: list[Fixture] = field(default_factory=list)
    X_WC: Pose | None = None
    """The camera's true pose, where it differs from the twin's calibration."""
    camera_defects: CameraDefects = field(default_factory=CameraDefects)
    arm_defects: ArmDefects = field(default_factory=ArmDefects)
    lidar_defects: LidarDefects = field(default_factory=LidarDefects)
    sensor_defects: dict[str, SensorDefects] = field(default_factory=dict)
    """By the port of a sensor of ``twin.sensors``; those that are not listed have their kind's usual noise alone."""
