"""Compiled loops that colour what `raster_kernels` has drawn: light and textures are linear between what is known."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array, Ints
from twin_diagram.signals.compiled import compiled, compiled_in_place
from twin_diagram.station.sim.raster_kernels import behind, planes

Ints32 = npt.NDArray[np.int32]
Bytes = npt.NDArray[np.uint8]


@compiled
def wrapped(place: int, size: int) -> int:
    """Return a place within 0 … size - 1, from where it goes on as it began."""
    return place if 0 <= place < size else place % size


@compiled_in_place
def texel(texels: Bytes, start: int, width: int, height: int, u: float, v: float, colour: Array) -> None:
    """Write a texture's colour (3,) between its texels, at u, v in 0 … 1, which go on beyond as they began."""
    x, y = u * width - 0.5, (1.0 - v) * height - 0.5
    x0, y0 = int(np.floor(x)), int(np.floor(y))
    fx, fy = x - x0, y - y0
    left, right = wrapped(x0, width), wrapped(x0 + 1, width)
    top, bottom = wrapped(y0, height), wrapped(y0 + 1, height)
    a, b = start + top * width + left, start + top * width + right
    c, d = start + bottom * width + left, start + bottom * width + right
    for i in range(3):
        above = texels[a, i] * (1.0 - fx) + texels[b, i] * fx
        below = texels[c, i] * (1.0 - fx) + texels[d, i] * fx
        colour[i] = above * (1.0 - fy) + below * fy


@compiled_in_place
def plane_of(f: int, points: Array, faces: Ints, light: Array, uv: Array, work: Array, plane: Array) -> bool:
    """Write a triangle's rows (4, 3) of 1 / z, light, u and v; return whether it is alike bright all over.

    Args:
        f: the triangle.
        points: (V, 3) in the camera's frame.
        faces: (F, 3).
        light: (V, 2) before and behind.
        uv: (V, 2).
        work: (6, 4) written.
        plane: (4, 3) written.
    """
    corners, values = work[:3, :3], work[3:]
    for i in range(3):
        corner = faces[f, i]
        values[i, 0], values[i, 2], values[i, 3] = 1.0, uv[corner, 0], uv[corner, 1]
        for j in range(3):
            corners[i, j] = points[corner, j]
    side = 1 if behind(corners) else 0
    for i in range(3):
        values[i, 1] = light[faces[f, i], side]
    planes(corners, values, plane)
    return bool(abs(values[0, 1] - values[1, 1]) + abs(values[0, 1] - values[2, 1]) < 1e-3)


@compiled_in_place
def colour_of(P: Array, x: float, y: float, base: Array, texture: Ints, texels: Bytes, colour: Array) -> None:
    """Write the colour (3,) of a triangle along (x, y, 1), whole numbers from 0 to 255.

    Args:
        P: (4, 3) its rows of `plane_of`.
        x: normalised coordinate.
        y: normalised coordinate.
        base: (3,) colour, 0 to 255.
        texture: (3,) where its texture begins, width and height; width 0 where it has none.
        texels: (T, 3).
        colour: (3,) written.
    """
    z = 1.0 / (P[0, 0] * x + P[0, 1] * y + P[0, 2])
    bright = (P[1, 0] * x + P[1, 1] * y + P[1, 2]) * z
    if texture[1] > 0:
        u = (P[2, 0] * x + P[2, 1] * y + P[2, 2]) * z
        v = (P[3, 0] * x + P[3, 1] * y + P[3, 2]) * z
        texel(texels, texture[0], texture[1], texture[2], u, v, colour)
    else:
        for i in range(3):
            colour[i] = base[i]
    for i in range(3):
        colour[i] = np.floor(min(max(colour[i] * bright, 0.0), 255.0) + 0.5)


@compiled
def shade(
    who: Ints32, points: Array, faces: Ints, light: Array, uv: Array, base: Array, texture: Ints, texels: Bytes,
    lens: Array, background: Array, image: Bytes,
) -> None:  # fmt: skip
    """Write the colours (H, W, 4) of what is seen, each pixel's the mean of its samples.

    Args:
        who: (S, H, W) triangles, -1 where there is none.
        points: (V, 3) in the camera's frame.
        faces: (F, 3).
        light: (V, 2) before and behind.
        uv: (V, 2).
        base: (F, 3) colour, 0 to 255.
        texture: (F, 3) where its texture begins, width and height; width 0 where it has none.
        texels: (T, 3).
        lens: fx, fy, cx, cy.
        background: (3,) 0 to 255.
        image: (H, W, 4) written.
    """
    # Of each triangle, after the sky: 0, not yet met; 1, one colour all over, which is kept; 2, not.
    kind, kept = np.zeros(len(faces) + 1, dtype=np.uint8), np.full((len(faces) + 1, 4), 255, dtype=np.uint8)
    kind[0] = 1
    for i in range(3):
        kept[0, i] = np.uint8(background[i] + 0.5)
    room = (np.empty((len(faces), 4, 3)), np.empty((6, 4)), np.empty(3), np.empty(3))
    _shade_all(who, points, faces, light, uv, base, texture, texels, lens, (kind, kept), room, image)


@compiled_in_place
def _shade_all(
    who: Ints32, points: Array, faces: Ints, light: Array, uv: Array, base: Array, texture: Ints, texels: Bytes,
    lens: Array, met: tuple[Bytes, Bytes], room: tuple[Array, Array, Array, Array], image: Bytes,
) -> None:  # fmt: skip
    """Do what `shade` does; `met`: kind and colour of each triangle, the sky's first; `room` is written over."""
    samples, height, width = who.shape
    kind, kept = met
    rows, work, colour, total = room
    for row in range(height):
        y = (row - lens[3]) / lens[1]
        for column in range(width):
            f = who[0, row, column]
            alone = kind[f + 1] == 1
            for s in range(1, samples):
                alone = alone and who[s, row, column] == f
            if alone:  # most of a picture: table and sky
                for i in range(4):
                    image[row, column, i] = kept[f + 1, i]
                continue
            x = (column - lens[2]) / lens[0]
            before, total[:] = -2, 0.0
            for s in range(samples):
                f = who[s, row, column]
                if kind[f + 1] == 0:
                    flat = plane_of(f, points, faces, light, uv, work, rows[f])
                    colour_of(rows[f], x, y, base[f], texture[f], texels, colour)
                    kind[f + 1] = 1 if flat and texture[f, 1] == 0 else 2
                    for i in range(3):
                        kept[f + 1, i] = np.uint8(colour[i])
                if kind[f + 1] == 1:
                    for i in range(3):
                        colour[i] = kept[f + 1, i]
                elif f != before:
                    colour_of(rows[f], x, y, base[f], texture[f], texels, colour)
                before = f
                for i in range(3):
                    total[i] += colour[i]
            for i in range(3):
                image[row, column, i] = np.uint8(total[i] / samples + 0.5)
            image[row, column, 3] = 255
