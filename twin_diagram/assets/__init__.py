"""The library: known objects, their shape, look, mass and convex pieces."""

from __future__ import annotations

from twin_diagram.assets.asset import Asset

__all__ = ["Asset"]
