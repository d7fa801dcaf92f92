"""The RGB-D camera as its calibration and its data sheet tell of it."""

# No `from __future__ import annotations`: Drake's YAML loader reads the fields' types themselves, not strings.
from dataclasses import dataclass, field

from twin_diagram.scenario.field_table import document
from twin_diagram.scenario.models import Pose


@document
@dataclass
class DepthCamera:
    """A depth camera beside the colour camera, with a grid of its own; optical frame D."""

    X_DC: Pose = field(default_factory=Pose)
    """X_DepthColour: where the colour camera's optical frame C stands in D [m]."""
    width: int = 640
    """Of its images [px]."""
    height: int = 480
    """Of its images [px]."""
    fx: float = 600.0
    """Focal length in x [px]."""
    fy: float | None = None
    """Focal length in y [px]; null: `fx`."""
    cx: float | None = None
    """Principal point in x [px]; null: (width - 1) / 2."""
    cy: float | None = None
    """Principal point in y [px]; null: (height - 1) / 2."""
    distortion: list[float] = field(default_factory=list)
    """As of the camera."""
    scale: float = 1.0
    """What its depth is multiplied by to become metres."""


@document
@dataclass
class DepthNoise:
    """The expected error of depth z, RMS: floor + growth · (z - start)² metres."""

    sheet: str = "ideal"
    """Whose figures hold where no others are given: `ideal` (0.8 z² mm), `d415` (1.5 z²), `d435` (3.8 z²), `kinect1`
    (1.2 + 1.9 (z - 0.4)²)."""
    floor: float | None = None
    """[m]; null: the sheet's."""
    growth: float | None = None
    """[1/m]; null: the sheet's."""
    start: float | None = None
    """[m]; null: the sheet's."""
    correlated: float | None = None
    """Share of the variance that neighbouring pixels have in common (Gaussian, σ 2.5 px at 640 a row); null: none for
    `ideal`, 0.6 for the others."""
    lasting: float | None = None
    """Share of it that lasts from frame to frame and spreads wider (σ 15 px); null: none for `ideal`, else 0.3."""


@document
@dataclass
class Camera:
    """A pinhole RGB-D camera; optical frame C: X right, Y down, Z forward. Pixel (u, v) has its centre at (u, v)."""

    name: str = "camera"
    """Its ports are called after it; those of ``twin.cameras`` have the name under which they stand there."""
    role: str = "pictures"
    """What one of ``twin.cameras`` is for: `perception`, the running twin looks through it all the time; `pictures`,
    where somebody asks for one. ``twin.camera`` is always looked through."""
    X_WC: Pose = field(default_factory=Pose)
    """Where its optical frame C stands in the world, X right, Y down, Z forward [m]."""
    width: int = 640
    """Of its images [px]."""
    height: int = 480
    """Of its images [px]."""
    focal: float = 600.0
    """Focal length [pixel], the same in x and y where `fx` and `fy` say no other."""
    fx: float | None = None
    """Focal length in x [px]; null: `focal`."""
    fy: float | None = None
    """Focal length in y [px]; null: `focal`."""
    cx: float | None = None
    """Principal point in x [px]; null: the image's centre, (width - 1) / 2."""
    cy: float | None = None
    """Principal point in y [px]; null: (height - 1) / 2."""
    distortion: list[float] = field(default_factory=list)
    """k1, k2, p1, p2, k3 of Brown and Conrady, as OpenCV has them; four or five of them; empty: none."""
    depth: DepthCamera | None = None
    """A depth camera of its own; null: depth comes on the colours' grid, in metres."""
    depth_noise: DepthNoise = field(default_factory=DepthNoise)
    """What its data sheet says about depth."""
    X_WC_std: list[float] = field(default_factory=lambda: [0.0, 0.0])
    """How far off X_WC may be, RMS [m], [rad]; what is told here is in the covariance of all poses in W."""
    focal_std: float = 0.0
    """How far off the focal lengths may be, as a share of them."""
    centre_std: float = 0.0
    """How far off the principal point may be, RMS [px]."""
    depth_scale_std: float = 0.0
    """How far off the scale of depth may be, as a share of it."""
    colour_std: float = 0.0
    """How far off depth its colours may lie, RMS [px]; learnt while objects are followed. 0: they lie on it."""
    rate: float = 15.0
    """Frames per second."""
    latency: float = 0.035
    """From capture to delivery [s]."""
    depth_range: list[float] = field(default_factory=lambda: [0.2, 3.0])
    """Nearest and farthest depth that is measured [m]."""

    @property
    def depth_size(self) -> tuple[int, int]:
        """Width and height of the depth images [px]."""
        return (self.width, self.height) if self.depth is None else (self.depth.width, self.depth.height)
