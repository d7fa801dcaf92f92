"""A digital twin of a robot arm as one Drake Diagram, from camera to command.

Importing the package loads nothing heavy; its modules import Drake and Open3D where they need them. It does load libusb
where only a wheel brings it along, so that ``import open3d`` works; an installed package does so when Python starts.
"""

from __future__ import annotations

from contextlib import suppress

from twin_diagram.runtime.native import NativeLibraryError, load_libusb

__version__ = "0.1.0"

with suppress(NativeLibraryError):  # whoever imports Open3D is told by `runtime.native.import_open3d`
    load_libusb()
