"""What simulated sensors do to their signals; nobody but the world knows."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.field_table import document


@document
@dataclass
class CameraDefects:
    """What the simulated camera does to its images. Where a field is null, the profile says its value.

    Figures in pixels are those of images 640 pixels wide, and scale with the width.
    """

    profile: str = "ideal"
    """`ideal`: little white noise, calibrated as told. `d415`, `d435`, `kinect1`: as bad as those, in all below."""
    depth_noise: float | None = None
    """RMS of depth [m] 1 m beyond `depth_noise_start`, above `depth_noise_floor`; grows with distance squared."""
    depth_noise_floor: float | None = None
    """RMS of depth where it is least [m]."""
    depth_noise_start: float | None = None
    """Depth at which it is least [m]."""
    white_share: float | None = None
    """Share of the variance that is white."""
    wave_share: float | None = None
    """Share of the variance that is in waves fixed for the run; the rest is correlated over pixels, anew each frame."""
    correlation: float | None = None
    """σ of the Gaussian that correlates it [px]."""
    waves: float | None = None
    """σ of the waves [px]."""
    depth_unit: float = 0.00025
    """Depth is a whole number of these [m]."""
    colour_noise: float = 2.0
    """Standard deviation per channel, of 255."""
    edge_dropout: float | None = None
    """Probability that a pixel at a depth discontinuity has no depth."""
    edge_jitter: float | None = None
    """RMS by which depth's edges are off, anew each frame [px]."""
    flying_pixels: float | None = None
    """Probability that a pixel at a depth discontinuity has a depth between its two sides."""
    steepest: float | None = None
    """Surfaces seen at a larger angle to their normal have no depth [rad]."""
    reflective_lost: float | None = None
    """Share of a reflective object's surface without depth, in patches."""
    reflective_deep: float | None = None
    """Share of it that seems too deep, in patches."""
    too_deep: list[float] | None = None
    """By how much, from and to [m]."""
    colour_offset: float | None = None
    """Colours are off depth by up to this, drawn for the run [px]."""
    depth_delay: float | None = None
    """Depth shows the world this share of a frame's period before the colours of the same frame."""
    exposure: float | None = None
    """The colours' shutter is open so long [s]: the mean of two pictures, of its opening and of its closing."""
    light: float | None = None
    """Brightness, beside full light."""
    shot_noise: float | None = None
    """Standard deviation at white, of 255; with the square root of brightness."""
    X_WC_error: list[float] | None = None
    """How far X_WC is off what the twin is told [m], [rad]; directions are drawn; not where `world.X_WC` is given."""
    focal_error: float | None = None
    """The same of the focal lengths, as a share of them."""
    centre_error: float | None = None
    """The same of the principal point [px]."""
    depth_scale_error: float | None = None
    """The same of the scale of depth, as a share of it."""
    covered: list[list[float]] = field(default_factory=list)
    """Intervals [start, end] in which the lens is covered [s]."""
    stops: float | None = None
    """From then on no image comes any more [s]; null: it goes on."""


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
    torque_gain: list[float] = field(default_factory=list)
    """Measured over true torque per joint, whatever else the arm's effects make of it; empty: 1."""


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
