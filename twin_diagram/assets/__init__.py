"""The library: known objects, their shape, look, mass and convex pieces."""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin_diagram.runtime import faces

if TYPE_CHECKING:
    from twin_diagram.assets.asset import Asset

__all__ = [
    "Asset",
]

__getattr__, __dir__ = faces.lazy_face(__name__)
