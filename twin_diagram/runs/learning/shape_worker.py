"""The process that makes a shape of an object's frames: `python -m twin_diagram.runs.learning.shape_worker FOLDER`.

FOLDER holds `frames/`; `shape.npz` appears beside it once it is whole. It lives no longer than the one that started it:
when its standard input ends, so does it, whichever way the other ended.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np

from twin_diagram.assets.building.backends import ColouredSurface, ShapeBackend, TsdfBackend
from twin_diagram.errors import TwinError
from twin_diagram.logs.frames.transforms_folder import TransformsFolder
from twin_diagram.runtime import atomic_file
from twin_diagram.runtime.child_process import BAD_INPUT, end_with_starter
from twin_diagram.runtime.threads import one_thread

FRAMES: Final = "frames"
"""Folder of the posed pictures, as Nerfstudio has them."""
SHAPE: Final = "shape.npz"
"""What comes out."""


def make_shape(folder: Path, backend: ShapeBackend | None = None) -> ColouredSurface:
    """Make the shape of the frames in a folder and write it beside them.

    Raises:
        FramesError: frames that cannot be used.
    """
    backend = TsdfBackend() if backend is None else backend
    shape = backend.shape(TransformsFolder(folder / FRAMES), folder.name, lambda text: print(text, flush=True))
    data = io.BytesIO()
    told = np.array([shape.unseen, shape.noise])
    arrays: dict[str, Any] = {"corners": shape.corners, "uv": shape.uv, "texture": shape.texture, "told": told}
    if shape.blank is not None:
        arrays["blank"] = shape.blank
    np.savez(data, **arrays)
    atomic_file.write(folder / SHAPE, data.getvalue())
    return shape


def read_shape(folder: Path) -> ColouredSurface:
    """Return the shape that was made in a folder."""
    with np.load(folder / SHAPE, allow_pickle=False) as data:
        told = data["told"]
        blank = data["blank"] if "blank" in data else None
        return ColouredSurface(data["corners"], data["uv"], data["texture"], float(told[0]), float(told[1]), blank)


def main(folder: Path) -> int:
    """Run as a process of its own."""
    end_with_starter()
    try:
        with one_thread():
            make_shape(folder)
    except TwinError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return BAD_INPUT
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
