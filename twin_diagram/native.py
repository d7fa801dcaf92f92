"""System libraries and Python packages that are missing: named with what to install, before anything heavy starts.

The wheels need libraries that they do not bring along. ``pip install twin-diagram`` brings all packages; who installs
less (`.make/slim.txt`) has the filter, `Monitor`, `gap` and `predict`, and is told here what the rest needs.

Only the standard library is imported here, so that `main`, the check that comes first in the Makefile, runs before
anything is installed.
"""

from __future__ import annotations

import ctypes
import importlib
import importlib.util
import locale
from collections.abc import Iterator
from contextlib import contextmanager
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
        "libgomp.so.1": "libgomp1",  # proxsuite links it, with which tests check the planner's solver
        "libusb-1.0.so.0": "libusb-1.0-0",  # Open3D links it; see `load_libusb`
    }
)
"""Debian's and Ubuntu's package by library; without those that every installation has (libc, libstdc++, libudev …)."""

DISTRIBUTIONS: Final = MappingProxyType(
    {
        "coacd": "coacd",
        "collada": "pycollada",
        "cv2": "opencv-python-headless",
        "fast_simplification": "fast-simplification",
        "libusb_package": "libusb-package",
        "matplotlib": "matplotlib",
        "numba": "numba",
        "numpy": "numpy",
        "open3d": "open3d",
        "pydrake": "drake",
        "scipy": "scipy",
        "threadpoolctl": "threadpoolctl",
        "trimesh": "trimesh",
        "vhacdx": "vhacdx",
        "yaml": "pyyaml",
    }
)
"""What to install by the name under which it is imported: the dependencies of pyproject.toml."""

RUN: Final = ("cv2", "trimesh")
"""What station, perception and planner import beyond the slim installation."""

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


class MissingPackageError(TwinError):
    """A Python package is not installed.

    Attributes:
        packages: the missing ones, as they are installed, e.g. ``opencv-python-headless``.
    """

    def __init__(self, modules: tuple[str, ...]) -> None:
        self.packages = tuple(DISTRIBUTIONS.get(module, module) for module in modules)
        names = " ".join(self.packages)
        super().__init__(
            f"{', '.join(self.packages)} {'are' if len(modules) > 1 else 'is'} not installed, and this needs "
            f"{'them' if len(modules) > 1 else 'it'}: pip install {names} (or twin-diagram with all its dependencies)"
        )


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


def import_open3d() -> ModuleType:
    """Import ``open3d`` with what it links in place; the one way in which this package imports it.

    Raises:
        ModuleNotFoundError: Open3D itself is not installed; the command line names what to install.
        NativeLibraryError: one of the libraries that it links is missing.
    """
    require_libraries("libEGL.so.1", "libGL.so.1", "libX11.so.6")
    load_libusb()
    return importlib.import_module("open3d")


def require_packages(*modules: str) -> None:
    """Check that packages are installed, without importing them.

    Args:
        *modules: the names under which they are imported, e.g. ``cv2``.

    Raises:
        MissingPackageError: at least one is missing; its message names all of them and how to install them.
    """
    missing = tuple(module for module in modules if importlib.util.find_spec(module) is None)
    if missing:
        raise MissingPackageError(missing)


def require_utf8() -> None:
    """Check that Python reads text as UTF-8: pydrake reads its own modules so, and ends in an import error elsewhere.

    Python sees to it under a locale of C or UTF-8; not with ``PYTHONUTF8=0`` or ``-X utf8=0``, or under a Latin locale.

    Raises:
        TwinError: it does not; its message says what to set.
    """
    encoding = locale.getpreferredencoding(False)
    if encoding.lower().replace("-", "") != "utf8":
        raise TwinError(
            f"Python reads text as {encoding} here, by the locale, and Drake's own as that, too, so that it cannot be "
            "loaded: set PYTHONUTF8=1, without -X utf8=0"
        )


@contextmanager
def missing_packages_named() -> Iterator[None]:
    """Say of an import that fails which package to install; other failures pass as they are.

    Raises:
        MissingPackageError: a dependency of this package is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if module not in DISTRIBUTIONS or error.name != module:  # something inside an installed one is its own matter
            raise
        raise MissingPackageError((module,)) from error


def main() -> int:
    """Print what is missing, if anything; the status to exit with."""
    try:
        require_libraries()
    except NativeLibraryError as error:
        print(f"twin-diagram: {error}", flush=True)
        return 1
    return 0
