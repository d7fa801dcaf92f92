"""What simulated sensors do to their signals; nobody but the world knows."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.field_table import document


@document
@dataclass
class CameraDefects:
    """What the simulated camera does to its images."""

    depth_noise: float = 0.0008
    """Standard deviation of depth at 1 m [m]; grows with depth squared."""
    depth_unit: float = 0.00025
    """Depth is a whole number of these [m]."""
    colour_noise: float = 2.0
    """Standard deviation per channel, of 255."""
    edge_dropout: float = 0.5
    """Probability that a pixel at a depth discontinuity has no depth."""
    covered: list[list[float]] = field(default_factory=list)
    """Intervals [start, end] in which the lens is covered [s]."""


@document
@dataclass
class ArmDefects:
    """What the simulated arm's sensors do to their signals."""

    encoder_bits: int = 19
    """Encoder counts per revolution, as a power of two."""
    velocity_noise: float = 1e-3
    """[rad/s]"""
    torque_noise: float = 0.05
    """White noise of the measured torque [N·m]."""
    torque_bias: list[float] = field(default_factory=list)
    """Constant error of the measured torque per joint [N·m]; empty: none."""


@document
@dataclass
class LidarDefects:
    """What the simulated lidar does to its ranges."""

    noise: float = 0.01
    """Standard deviation along the beam, near by [m]."""
    growth: float = 0.005
    """What is added to it, in squares, at 1 m; grows with distance squared [m]."""
    dropout: float = 0.02
    """Probability that an echo is lost."""
    missing: list[list[float]] = field(default_factory=list)
    """Intervals [start, end] without scans [s]."""


@document
@dataclass
class SensorDefects:
    """What a further sensor of the simulated arm does to its readings."""

    noise: list[float] = field(default_factory=list)
    """White noise of the reading's first and second half: `imu` [rad/s], [m/s²]; `wrench` [N·m], [N]. Empty: the kind's
    own."""
    bias: list[float] = field(default_factory=list)
    """Constant error of all six; empty: none."""
    missing: list[list[float]] = field(default_factory=list)
    """Intervals [start, end] without readings [s]."""
