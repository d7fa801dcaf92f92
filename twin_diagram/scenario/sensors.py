"""The arm's driver and its sensors but for the camera, as their data sheets tell."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.field_table import document
from twin_diagram.scenario.models import Pose


@document
@dataclass
class Lidar:
    """A lidar that stands in the room; its frame S: X forward, Z up. The simulated station has a port for it."""

    name: str = "room"
    """Its ports are `<name>.lidar` and `<name>.lidar_time`."""
    X_WS: Pose = field(default_factory=Pose)
    """Where it stands in the world [m]."""
    columns: int = 180
    """Beams from left to right."""
    rows: int = 32
    """Beams from top to bottom."""
    width: float = 0.9
    """Angle between the first and the last column [rad]."""
    height: float = 0.5
    """The same of the rows [rad]."""
    range: list[float] = field(default_factory=lambda: [0.3, 20.0])
    """Nearest and farthest echo [m]."""
    rate: float = 10.0
    """Scans per second, each at one instant [1/s]."""
    latency: float = 0.02
    """From scan to delivery [s]."""


@document
@dataclass
class Driver:
    """The arm's own controller, as its data sheet tells: joint impedance about the commanded position."""

    stiffness: list[float] = field(default_factory=list)
    """[N·m/rad] per joint; empty: 600 for the first four joints, 250 for the rest, scaled to the effort limits."""
    damping: list[float] = field(default_factory=list)
    """[N·m·s/rad]; empty: two times the square root of stiffness."""
    rate: float = 400.0
    """Status messages per second [1/s]."""
    torque_side: str = "motor"
    """Of the gears, on which torques are measured: `motor`, or `link`, behind friction and rotors."""


@document
@dataclass
class LinkSensor:
    """A sensor on the arm besides its own, as its data sheet tells; the simulated station has a port for it."""

    kind: str = "imu"
    """`imu`: port `<body>.imu`; `wrench`: port `wrist.wrench_measured`."""
    body: str = ""
    """Link that it is fixed to; empty: the last one."""
    X_BS: Pose = field(default_factory=Pose)
    """Where the sensor S sits on that body B [m]."""
    rate: float = 200.0
    """Readings per second [1/s]."""
    latency: float = 0.0
    """From reading to delivery, rounded up to whole periods [s]."""
