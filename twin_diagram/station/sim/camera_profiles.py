"""The simulated cameras' profiles: how bad an ideal and three real RGB-D cameras are."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

from twin_diagram.errors import ScenarioError
from twin_diagram.scenario import CameraDefects
from twin_diagram.scenario.depth_sheets import SHEETS


@dataclass(frozen=True)
class CameraFaults:
    """What a camera's defects come to; each field as in `CameraDefects`, pixels at 640 a row, but none is open."""

    depth_noise: float
    depth_noise_floor: float
    depth_noise_start: float
    white_share: float = 1.0
    wave_share: float = 0.0
    correlation: float = 2.5
    waves: float = 15.0
    edge_dropout: float = 0.5
    edge_jitter: float = 0.0
    flying_pixels: float = 0.0
    steepest: float = math.pi / 2
    reflective_lost: float = 0.0
    reflective_deep: float = 0.0
    too_deep: tuple[float, ...] = (0.005, 0.03)
    colour_offset: float = 0.0
    depth_delay: float = 0.0
    exposure: float = 0.0
    light: float = 1.0
    shot_noise: float = 0.0
    X_WC_error: tuple[float, ...] = (0.0, 0.0)
    focal_error: float = 0.0
    centre_error: float = 0.0
    depth_scale_error: float = 0.0

    @property
    def plain(self) -> bool:
        """Whether there is no more to it than white noise and lost edges, and all is calibrated as told."""
        none = CameraFaults(self.depth_noise, self.depth_noise_floor, self.depth_noise_start)
        same = replace(none, edge_dropout=self.edge_dropout, correlation=self.correlation, waves=self.waves)
        return self == replace(same, too_deep=self.too_deep) and self.depth_noise_floor == 0 == self.depth_noise_start


_REAL = CameraFaults(
    0.0,
    0.0,
    0.0,
    white_share=0.1,
    wave_share=0.3,
    edge_dropout=0.0,
    edge_jitter=0.8,
    flying_pixels=0.2,
    steepest=math.radians(75.0),
    reflective_lost=0.3,
    reflective_deep=0.3,
    colour_offset=4.0,
    depth_delay=0.5,
    exposure=0.008,
    light=0.6,
    shot_noise=5.0,
    X_WC_error=(0.005, math.radians(0.5)),
    focal_error=0.003,
    centre_error=1.0,
    depth_scale_error=0.01,
)
"""What real cameras have in common; its light and exposure are those of a room in the evening."""

PROFILES: dict[str, CameraFaults] = {
    name: replace(
        CameraFaults(0.0, 0.0, 0.0) if name == "ideal" else _REAL,
        depth_noise=sheet.growth,
        depth_noise_floor=sheet.floor,
        depth_noise_start=sheet.start,
    )
    for name, sheet in SHEETS.items()
}
"""By name; the depth's RMS is that of the makers' sheets."""

_SHARES = (
    *("white_share", "wave_share", "edge_dropout", "flying_pixels"),
    *("reflective_lost", "reflective_deep", "depth_delay"),
)
"""Figures that are shares of a whole."""
_FIELD = "world.camera_defects"
"""Where a scenario says them."""


def faults(defects: CameraDefects) -> CameraFaults:
    """Return what a scenario's defects come to: the profile's figures, and what is said otherwise.

    Raises:
        ScenarioError: no such profile, or a figure that makes no sense; it names the field.
    """
    if defects.profile not in PROFILES:
        raise ScenarioError(f"{_FIELD}.profile", f"{defects.profile!r} is none of {', '.join(PROFILES)}")
    told = {field.name: getattr(defects, field.name) for field in fields(CameraFaults)}
    own: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in told.items() if v is not None}
    found = replace(PROFILES[defects.profile], **own)
    for name, value in vars(found).items():
        values = value if isinstance(value, tuple) else (value,)
        if isinstance(value, tuple) and len(value) != 2:
            raise ScenarioError(f"{_FIELD}.{name}", f"{list(value)} is not two numbers")
        if not min(values) >= 0:
            raise ScenarioError(f"{_FIELD}.{name}", f"{value} is negative")
    for name in _SHARES:
        if getattr(found, name) > 1:
            raise ScenarioError(f"{_FIELD}.{name}", f"{getattr(found, name)} is more than all")
    for first, second in (("white_share", "wave_share"), ("reflective_lost", "reflective_deep")):
        if getattr(found, first) + getattr(found, second) > 1:
            raise ScenarioError(f"{_FIELD}.{second}", f"with {first} it is more than all")
    for name in ("correlation", "waves", "light"):
        if not getattr(found, name) > 0:
            raise ScenarioError(f"{_FIELD}.{name}", f"{getattr(found, name)} is not positive")
    return found
