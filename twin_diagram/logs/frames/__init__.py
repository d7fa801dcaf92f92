"""Recorded images: folders of posed RGB-D frames, read one at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.logs.frames.scene_folder import FrameFolder, RgbdFrame
    from twin_diagram.logs.frames.view_camera import ViewCamera

__all__ = [
    "FrameFolder",
    "RgbdFrame",
    "ViewCamera",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
