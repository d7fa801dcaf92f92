"""From what somebody has of an object to an asset of a library: read, measured, taken apart and written."""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.assets.building.from_frames import build_from_frames, build_from_predictions, posed_frames
    from twin_diagram.assets.building.from_mesh import build_from_mesh
    from twin_diagram.assets.building.growth import Growth, PartialThing, in_thing

__all__ = [
    "Growth",
    "PartialThing",
    "build_from_frames",
    "build_from_mesh",
    "build_from_predictions",
    "in_thing",
    "posed_frames",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
