"""A digital twin of a robot arm as one Drake Diagram, from camera to command.

Importing the package loads nothing heavy; its modules import Drake and Open3D where they need them.
"""

from __future__ import annotations

__version__ = "0.1.0"
