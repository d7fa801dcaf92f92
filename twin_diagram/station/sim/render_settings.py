"""Light, background and range of every simulated camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydrake.geometry import ClippingRange, LightParameter, RenderEngineVtkParams, Rgba

from twin_diagram.scenario import Camera
from twin_diagram.station.sim.merged_shapes import TUNING as MERGED_SHAPES


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    background: tuple[float, ...] = (0.72, 0.76, 0.80)
    """Where nothing stands (r, g, b): an overcast sky."""

    clip: tuple[float, ...] = (0.05, 20.0)
    """Drawn is at least what lies between these distances [m]: colours are seen farther than depth is measured."""


TUNING = Tuning()


def clipping(camera: Camera) -> ClippingRange:
    """Return what is drawn: from half the nearest depth or 5 cm, whichever is nearer, to twice the farthest or 20 m."""
    (near, far), (nearest, farthest) = camera.depth_range, TUNING.clip
    return ClippingRange(min(nearest, near / 2), max(farthest, 2 * far))


def lights() -> list[LightParameter]:
    """Return daylight from above, softer from two sides: every face that a camera sees is lit and keeps its colour."""

    def sun(direction: list[float], intensity: float) -> LightParameter:
        return LightParameter(
            type="directional", frame="world", direction=np.array(direction), color=Rgba(1, 1, 1), intensity=intensity
        )

    return [sun([-0.3, 0.2, -1.0], 0.75), sun([-1.0, 0.9, -0.5], 0.45), sun([-0.8, -1.0, -0.4], 0.35)]


def render_params() -> RenderEngineVtkParams:
    """Return light and background of every simulated camera."""
    return RenderEngineVtkParams(
        default_clear_color=np.array(TUNING.background),
        lights=lights(),
        default_diffuse=np.array(MERGED_SHAPES.grey),
    )
