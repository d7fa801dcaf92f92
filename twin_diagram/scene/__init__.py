"""The twin's scene: the life of its objects, and the plant and SceneGraph that follow the estimates."""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.scene.twin_scene import TwinScene, add_twin_scene
    from twin_diagram.scene.updater_system import SceneGraphUpdater

__all__ = [
    "SceneGraphUpdater",
    "TwinScene",
    "add_twin_scene",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
