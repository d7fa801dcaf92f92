"""System libraries that the wheels need and do not bring along: found, loaded or named before anything heavy starts.

Only the standard library is imported here, so that `main`, the check that comes first in the Makefile, runs before
anything is installed.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Final

from twin_diagram.errors import TwinError

PACKAGES: Final = MappingProxyType(
    {
        "libEGL.so.1": "libegl1",  # RenderEngineVtk without a display; Open3D links it
        "libGL.so.1": "libgl1",  # Open3D links it; also brings Mesa's software driver
        "libX11.so.6": "libx11-6",  # Open3D links it
        "libglib-2.0.so.0": "libglib2.0-0",  # Drake's LCM links it
        "libgomp.so.1": "libgomp1",  # proxsuite links it
        "libusb-1.0.so.0": "libusb-1.0-0",  # Open3D links it; see `load_libusb`
    }
)
"""Debian's and Ubuntu's package by library; without those that every installation has (libc, libstdc++, libudev …)."""

_LIBUSB: Final = "libusb-1.0.so.0"
"""The one library of `PACKAGES` that a wheel can bring."""
_loaded: dict[str, ctypes.CDLL] = {}


class NativeLibraryError(TwinError):
    """A system library is missing.

    Attributes:
        libraries: the missing ones, e.g. ``libEGL.so.1``.
    """

    def __init__(self, libraries: tuple[str, ...]) -> None:
        packages = " ".join(dict.fromkeys(PACKAGES.get(library, library) for library in libraries))
        many = len(libraries) > 1
        super().__init__(
            f"{', '.join(libraries)} {'are' if many else 'is'} missing: install the "
            f"package{'s' if many else ''} {packages} (sudo apt-get install {packages})"
        )
        self.libraries = libraries


def _load(name: str) -> bool:
    """Load a library for good; true where it is (or already was) there."""
    if name not in _loaded:
        try:
            _loaded[name] = ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)
        except OSError:
            return False
    return True


def require_libraries(*libraries: str) -> None:
    """Check that the dynamic loader finds libraries; may be called again.

    Args:
        *libraries: their names, e.g. ``libEGL.so.1``; none: all of `PACKAGES` that no wheel brings.

    Raises:
        NativeLibraryError: at least one is missing; its message names the packages to install.
    """
    wanted = libraries or tuple(name for name in PACKAGES if name != _LIBUSB)
    missing = tuple(name for name in wanted if not _load(name))
    if missing:
        raise NativeLibraryError(missing)


def require_egl() -> None:
    """Check for EGL, without which a simulated camera cannot render; may be called again.

    Drake's RenderEngineVtk ends the process where EGL is absent, so this comes before the camera is built.

    Raises:
        NativeLibraryError: ``libEGL.so.1`` is missing; the message names the package ``libegl1``.
    """
    require_libraries("libEGL.so.1")


def load_libusb() -> None:
    """Make libusb-1.0 available to ``import open3d``; may be called again.

    Open3D's wheel links ``libusb-1.0.so.0`` (for cameras this package does not use) and does not contain it. The
    loader takes a library that is already loaded under that name, so the copy in the wheel ``libusb-package`` serves
    where the system has none. The system's own is preferred.

    Raises:
        NativeLibraryError: neither the system nor the wheel has it.
    """
    if _load(_LIBUSB):
        return
    # The wheel's module imports helpers to find its own library; the path is all that is needed.
    spec = importlib.util.find_spec("libusb_package")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        path = Path(folder) / "libusb-1.0.so"
        if path.is_file():
            _loaded[_LIBUSB] = ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
            return
    raise NativeLibraryError((_LIBUSB,))


def offer_libusb() -> None:
    """Make libusb-1.0 available where it is found; who imports Open3D without it is told by `import_open3d`."""
    with suppress(NativeLibraryError):
        load_libusb()


def import_open3d() -> ModuleType:
    """Import ``open3d`` with what it links in place; the one way in which this package imports it.

    Raises:
        NativeLibraryError: one of the libraries that it links is missing.
    """
    require_libraries("libEGL.so.1", "libGL.so.1", "libX11.so.6")
    load_libusb()
    return importlib.import_module("open3d")


def main() -> int:
    """Print what is missing, if anything; the status to exit with."""
    try:
        require_libraries()
    except NativeLibraryError as error:
        print(f"twin-diagram: {error}", flush=True)
        return 1
    return 0
