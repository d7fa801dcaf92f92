"""Clouds of dots as an image within a drawing: where many dots lie upon each other, they are darker."""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array

FINER = 2
"""Pixels of the image per unit of the drawing: sharp on a screen that shows two of its points in each."""

WIDE = 2.8
"""Diameter of a dot [pixels of the image]."""

SHARE = 0.28
"""Of the ground that one dot covers."""

LEVELS = 32
"""Steps from none to all of the ground: finer ones nobody sees, and they take more room."""


def cloud(x: Array, y: Array, width: float, height: float, colour: str) -> str:
    """Return dots at (M,), (M,) of a drawing of some width and height as an SVG image; y runs downwards."""
    shape = (round(FINER * height), round(FINER * width))
    covered = 1.0 - np.exp(splashed(FINER * x, FINER * y, shape))
    data = base64.b64encode(png(np.rint(LEVELS * covered).astype(np.uint8), colour)).decode()
    return f'<image width="{width:g}" height="{height:g}" href="data:image/png;base64,{data}"/>'


def splashed(x: Array, y: Array, shape: tuple[int, int]) -> Array:
    """Return (rows, columns) the log of the share of each pixel that no dot covers.

    Args:
        x: (M,) of the dots [pixels].
        y: (M,) likewise, downwards.
        shape: rows and columns.
    """
    reach = int(np.ceil(0.5 * WIDE))
    step = np.arange(-reach, reach + 1)
    down, along = (part.ravel() for part in np.meshgrid(step, step, indexing="ij"))
    column, row = np.floor(x)[:, None] + along, np.floor(y)[:, None] + down
    far = np.hypot(column + 0.5 - x[:, None], row + 0.5 - y[:, None])
    inside = np.clip(0.5 * WIDE + 0.5 - far, 0.0, 1.0)  # of a pixel on the rim a part
    seen = (inside > 0.0) & (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
    place = (row[seen] * shape[1] + column[seen]).astype(int)
    dots: Array = np.bincount(place, np.log1p(-SHARE * inside[seen]), shape[0] * shape[1]).astype(float)
    return dots.reshape(shape)


def png(levels: npt.NDArray[np.uint8], colour: str) -> bytes:
    """Return an image of one colour, `#rrggbb`, that covers each pixel (rows, columns) by a level of 0 to `LEVELS`."""
    rows, columns = levels.shape
    lines = np.hstack([np.zeros((rows, 1), dtype=np.uint8), levels])
    alpha = bytes(round(255 * k / LEVELS) for k in range(LEVELS + 1))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        (
            _chunk(b"IHDR", struct.pack(">IIBBBBB", columns, rows, 8, 3, 0, 0, 0)),
            _chunk(b"PLTE", bytes.fromhex(colour[1:]) * len(alpha)),
            _chunk(b"tRNS", alpha),
            _chunk(b"IDAT", zlib.compress(lines.tobytes(), 6)),
            _chunk(b"IEND", b""),
        )
    )


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
