"""Files of a folder of frames: none leads out of it, images are numbered, JSON is finite."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.errors import FramesError

UNTOLD: Final = 65535
"""In depth of 16 bits this is none either: cameras and simulators write it for what they do not see, and what lies
beyond 65534 steps ends there, too."""
_IMAGES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".ppm", ".pgm"})
"""Suffixes of the images that OpenCV reads and folders of frames hold."""


def in_folder(folder: Path, name: str) -> Path:
    """Return `folder / name`.

    Raises:
        FramesError: there is no such file, or it is a link that leads out of the folder.
    """
    path = folder / name
    if not path.is_file():
        raise FramesError(f"{path}: no such file")
    if not path.resolve().is_relative_to(folder.resolve()):
        raise FramesError(f"{path}: a link that leads out of {folder}")
    return path


def below(folder: Path, name: str) -> Path:
    """Return the folder `folder / name`, there or not.

    Raises:
        FramesError: it is a link that leads out of the folder.
    """
    path = folder / name
    if not path.resolve().is_relative_to(folder.resolve()):
        raise FramesError(f"{path}: a link that leads out of {folder}")
    return path


def numbered(folder: Path, of_objects: bool = False) -> dict[int, Path]:
    """Return images by frame number, from names such as `000012.png`.

    Args:
        folder: it is not searched below its top.
        of_objects: names may go on with an object's number, `000012_000000.png`; all must then be of one object.

    Raises:
        FramesError: no folder, another name than a number, a frame twice, several objects, a link that leads out.
    """
    if not folder.is_dir():
        raise FramesError(f"{folder}: no such folder")
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in _IMAGES or path.name.startswith("."):
            continue
        frame, _, item = path.stem.partition("_")
        if not frame.isdecimal() or not (item == "" or (of_objects and item.isdecimal())):
            raise FramesError(f"{path}: images are named by their frame's number, e.g. 000012{path.suffix}")
        if int(frame) in found:
            several = "two things are masked; copy the masks of one into a folder of its own, for --masks"
            what = several if of_objects else "the frame is there twice"
            raise FramesError(f"{path}: beside {found[int(frame)].name}: {what}")
        found[int(frame)] = in_folder(folder, path.name)
    return found


def read_json(path: Path) -> Any:
    """Return what a JSON file holds, with or without the mark that some editors begin files with.

    Raises:
        FramesError: it cannot be parsed.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise FramesError(f"{path}: not readable as JSON ({error})") from None


def read_image(path: Path, flags: int) -> npt.NDArray[Any]:
    """Return an image as OpenCV reads it.

    Raises:
        FramesError: not a readable image.
    """
    image = image_of(path.read_bytes(), flags)
    if image is None:
        raise FramesError(f"{path}: not a readable image")
    return image


def depth_in_metres(image: npt.NDArray[Any], unit: float) -> npt.NDArray[np.float32]:
    """Return depth [m], 0 where there is none, of what an image (h, w) of 16 bits or of floating point tells.

    Args:
        image: as read.
        unit: of its numbers [m].
    """
    metres = np.asarray(image * np.float32(unit), dtype=np.float32)
    told = np.isfinite(metres) & (metres > 0.0)
    if image.dtype == np.uint16:
        told &= image != UNTOLD
    return np.where(told, metres, np.float32(0.0))


def image_of(data: bytes, flags: int) -> npt.NDArray[Any] | None:
    """Return a file's image, None where it is none; of one that is cut off, OpenCV's own complaints are not printed.

    Pixels stay where they are, whichever way a telephone notes that it was held: K, depth and uv tell of them so.
    """
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        as_it_is = flags | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(np.frombuffer(data, np.uint8), as_it_is) if data else None
    except cv2.error:  # one of 2³⁰ pixels and more
        image = None
    finally:
        cv2.utils.logging.setLogLevel(level)
    return None if image is None else np.asarray(image)
