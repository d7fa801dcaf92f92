"""Pictures of how an object was displayed: a few of each grasp, cut out about it, small enough for a page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.errors import FramesError
from twin_diagram.logs.frames.scene_folder import RgbdFrame
from twin_diagram.logs.frames.transforms_folder import TransformsFolder


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    pictures: int = 6
    """Of a grasp: of its two or three turns one picture each third or half of a turn."""

    edge: int = 120
    """Of a picture on the page [pixel]."""

    around: float = 1.5
    """Edge of what is cut out, as a multiple of the object's longer side in the picture: with the hand beside it."""

    quality: int = 80
    """Of JPEG: 3 to 5 kB a picture."""


TUNING = Tuning()


def strips_of(folder: Path, by_grasp: Sequence[int]) -> list[list[str]]:
    """Return a few pictures of each grasp as base64 of JPEG, of one that has none []; [] where they cannot be read.

    Args:
        folder: of the posed pictures, in the order in which they were taken.
        by_grasp: how many of them are of each grasp.
    """
    try:
        kept = TransformsFolder(folder)
        begins = np.concatenate([[0], np.cumsum(by_grasp)]).astype(int)
        ends = [(a, min(b, len(kept)) - 1) for a, b in pairwise(begins)]
        chosen = [np.linspace(a, b, TUNING.pictures) if a <= b else np.zeros(0) for a, b in ends]
        return [[_small(kept.read(int(k))) for k in np.unique(np.rint(rows).astype(int))] for rows in chosen]
    except (FramesError, OSError):  # what is gone or torn is missing on the page alone
        return []


def _small(frame: RgbdFrame) -> str:
    """Return what a picture shows about its object, square."""
    assert frame.rgb is not None
    return base64.b64encode(_jpeg(cut_out(frame.rgb, frame.mask))).decode()


def cut_out(rgb: npt.NDArray[np.uint8], mask: npt.NDArray[np.bool_] | None) -> npt.NDArray[np.uint8]:
    """Return the square (E, E, 3) about a mask (H, W) of a picture (H, W, 3); its middle where that is empty."""
    height, width = rgb.shape[:2]
    rows, columns = np.nonzero(mask) if mask is not None else (np.zeros(0, int), np.zeros(0, int))
    if len(rows):
        middle = 0.5 * (np.array([rows.min(), columns.min()]) + np.array([rows.max(), columns.max()]))
        edge = TUNING.around * float(max(np.ptp(rows), np.ptp(columns), 1))
    else:
        middle, edge = 0.5 * np.array([height, width]), float(min(height, width))
    half = int(np.ceil(0.5 * min(edge, height, width)))
    row, column = (int(np.clip(at, half, size - half)) for at, size in zip(middle, (height, width), strict=True))
    cut = rgb[max(row - half, 0) : row + half, max(column - half, 0) : column + half]
    return np.asarray(cv2.resize(cut, (TUNING.edge, TUNING.edge), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _jpeg(rgb: npt.NDArray[np.uint8]) -> bytes:
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    good, data = cv2.imencode(".jpg", bgr, [int(cv2.IMWRITE_JPEG_QUALITY), TUNING.quality])
    assert good
    return bytes(data.tobytes())
