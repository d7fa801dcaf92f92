"""What a simulated station needs, and nobody else may know."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.defects import ArmDefects, CameraDefects, LidarDefects, SensorDefects
from twin_diagram.scenario.field_table import document
from twin_diagram.scenario.models import ArmModel, Fixture, Pose


@document
@dataclass
class WayPoint:
    """Where a moving object is at a time; between way points it moves on a smooth curve."""

    time: float = 0.0
    """When the object is there [s]."""
    X_WO: Pose = field(default_factory=Pose)
    """Its pose then [m]."""


@document
@dataclass
class WorldObject:
    """A real object of a simulated world."""

    asset: str = ""
    """Folder of the asset."""
    X_WO: Pose = field(default_factory=Pose)
    """Its true pose at the start [m]."""
    path: list[WayPoint] = field(default_factory=list)
    """Empty: it lies free on the table. Otherwise it is pushed along (x, y and yaw only)."""
    push: float | None = None
    """What pushes it along its path with at most [N], about z with a tenth of it in N·m, so that it gives way when hit;
    none: 200 N, which nothing stops."""
    mass: float | None = None
    """Its true mass [kg], not below that of its asset's model; none: that. What is added is spread as the rest is."""
    load_at: list[float] | None = None
    """Where what is added to its mass sits, hidden inside, as a small ball in O [m]; null: spread as the rest is."""
    friction: float | None = None
    """Coefficient of all its surface, static and sliding; none: as its asset's model says. Of two that touch, a and b,
    2ab/(a + b) counts."""
    reflective: bool = False
    """Whether a camera with `reflective_lost` and `reflective_deep` in its defects has trouble with its surface."""


@document
@dataclass
class WorldCamera:
    """What one of ``twin.cameras`` really is."""

    X_WC: Pose | None = None
    """Its true pose, where it differs from the twin's calibration other than by `X_WC_error`."""
    defects: CameraDefects | None = None
    """How it falls short; null: as ``world.camera_defects`` says of all, each drawn for itself."""


@document
@dataclass
class World:
    """What a simulated station needs, and nobody else may know."""

    arm: ArmModel = field(default_factory=ArmModel)
    """The true arm."""
    q0: list[float] = field(default_factory=list)
    """Joint angles at the start [rad]; empty: the twin's `home`."""
    time_step: float = 0.0025
    """Of the simulated plant [s]; beyond 2.5 ms a gripper's pads get more facets, so that what they hold stays."""
    objects: dict[str, WorldObject] = field(default_factory=dict)
    """What stands about, by name."""
    fixtures: list[Fixture] = field(default_factory=list)
    """What never moves."""
    X_WC: Pose | None = None
    """The true pose of ``twin.camera``, where it differs from the twin's calibration."""
    camera_defects: CameraDefects = field(default_factory=CameraDefects)
    """How the camera falls short, and those of `cameras` of which nothing else is said."""
    cameras: dict[str, WorldCamera] = field(default_factory=dict)
    """What those of ``twin.cameras`` really are, by name."""
    arm_defects: ArmDefects = field(default_factory=ArmDefects)
    """How the arm's sensors fall short."""
    lidar_defects: LidarDefects = field(default_factory=LidarDefects)
    """How the lidar falls short."""
    sensor_defects: dict[str, SensorDefects] = field(default_factory=dict)
    """By the port of a sensor of ``twin.sensors``; those that are not listed have their kind's usual noise alone."""
