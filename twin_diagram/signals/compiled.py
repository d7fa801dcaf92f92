"""Compiles loops over arrays to machine code (Numba), kept on disk between runs.

Registration looks hundreds of points up some ten times a frame and object, planning measures thousands of distances a
tick: as NumPy calls, each of which costs microseconds whatever it sums, that is ten times slower than as one loop.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Final, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

from twin_diagram.signals import compile_notice

Scalar = TypeVar("Scalar", bound=np.generic)
F = TypeVar("F", bound=Callable[..., object])

PACKAGE = Path(__file__).resolve().parents[1]
"""The folder of `twin_diagram`."""

FORGOTTEN: Final = 30 * 24 * 3600.0
"""Kernels that no run used for so long are removed [s]: each version of the package leaves some 15 MB."""

compile_notice.install()


def compiled(function: F) -> F:
    """Compile a function of arrays and numbers when it is first called; later runs load it.

    It may call compiled functions of other modules whose names end in `_kernels`. Sums are in the order of the source,
    so that results are the same on each run.
    """
    return _compiled(function)


def compiled_in_place(function: F) -> F:
    """Compile a function as `compiled` does that makes no array and returns none: its rows of arrays cost nothing.

    Elsewhere each row that is taken of an array is counted, atomically, when it is made and when it is left: in loops
    over points that is a third of the time. Where it makes an array after all, it does not compile.
    """
    return _compiled(function, _nrt=False)


def _compiled(function: F, **more: bool) -> F:
    options = {"nogil": True, "error_model": "numpy", **more}
    before = numba.config.CACHE_DIR
    try:
        # Numba notices that a function's own file has changed, not that one has which it calls.
        numba.config.CACHE_DIR = before or str(kept_in())
        return cast(F, numba.njit(cache=True, **options)(function))
    except (RuntimeError, OSError):
        return cast(F, numba.njit(**options)(function))  # nothing can be written: compiled in each run
    finally:
        numba.config.CACHE_DIR = before


def one_layout(array: npt.NDArray[Scalar]) -> npt.NDArray[Scalar]:
    """Return an array as compiled functions take it: contiguous and writable; of others they are compiled anew."""
    flags = array.flags
    if type(array) is np.ndarray and flags.c_contiguous and flags.writeable:
        return array  # as nearly all are: `np.require` takes 3 µs to find that out, some 300 times a picture
    return np.require(array, requirements=("C", "W"))


@cache
def kept_in() -> Path:
    """Return the folder for what was compiled from the package's kernels as they are: in the package, or the user's."""
    digest = hashlib.sha256()
    # Numba's own key says nothing of the options, which stand here.
    for file in [*sorted(PACKAGE.rglob("*_kernels.py")), Path(__file__)]:
        digest.update(file.read_bytes())
    name = f"kernels-{digest.hexdigest()[:16]}"
    place = PACKAGE / "__pycache__"
    if not os.access(place if place.is_dir() else PACKAGE, os.W_OK):
        place = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "twin_diagram"
    _tidy(place, name)
    return place / name


def _tidy(place: Path, name: str) -> None:
    """Mark a folder of compiled kernels as used, and remove those beside it that nobody used for long."""
    try:
        (place / name).mkdir(parents=True, exist_ok=True)
        os.utime(place / name)
        for other in place.glob("kernels-*"):
            if time.time() - other.stat().st_mtime > FORGOTTEN:
                shutil.rmtree(other, ignore_errors=True)
    except OSError:  # nothing can be written, or another run tidies: nothing is lost
        pass
