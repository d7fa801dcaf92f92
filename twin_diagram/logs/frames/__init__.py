"""Recorded images: folders of posed RGB-D frames, read one at a time."""

from __future__ import annotations

from twin_diagram.logs.frames.scene_folder import FrameFolder as FrameFolder
from twin_diagram.logs.frames.scene_folder import RgbdFrame as RgbdFrame
from twin_diagram.logs.frames.view_camera import ViewCamera as ViewCamera

__all__ = [
    "FrameFolder",
    "RgbdFrame",
    "ViewCamera",
]
