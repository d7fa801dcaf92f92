"""One texture for all of an object: pictures that repeat are laid out, several stacked, plain colours get patches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from twin_diagram.assets.building.mesh_parts import Part
from twin_diagram.assets.mesh import Image
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    longest: int = 1024
    """Edge of a picture [px]; a texel of half a millimetre on half a metre is finer than the camera sees."""

    most_repeats: int = 8
    """How often a picture may be repeated across one triangle, along either edge."""

    patch: int = 4
    """Edge of a plain colour's patch [px]: its middle stays pure where a renderer blends texels."""

    levels: int = 32
    """Shades per channel of plain colours; fewer where there are too many different ones."""

    most_colours: int = 4096
    """Patches; 256 × 256 texels at the most."""


TUNING = Tuning()


def one_texture(parts: Sequence[Part]) -> tuple[Array, Image]:
    """Return texture coordinates (F, 3, 2) of all parts' corners, v upwards, and the picture that they are in.

    Raises:
        AssetError: a picture is repeated too often.
    """
    pictures: list[Image] = []
    coordinates: list[Array] = []
    for part in parts:
        uv, picture = _pictured(part)
        coordinates.append(uv)
        pictures.append(picture)
    width, height = max(p.shape[1] for p in pictures), sum(p.shape[0] for p in pictures)
    atlas = np.zeros((height, width, 3), np.uint8)
    top = 0
    for uv, picture in zip(coordinates, pictures, strict=True):
        h, w = picture.shape[:2]
        atlas[top : top + h, :w] = picture
        uv[..., 0] *= w / width
        uv[..., 1] = (height - top - (1.0 - uv[..., 1]) * h) / height
        top += h
    return np.concatenate(coordinates), atlas


def _pictured(part: Part) -> tuple[Array, Image]:
    """Return a part's coordinates within [0, 1], and its picture."""
    if part.image is None or part.uv is None:
        return plain(part.colours)
    uv, picture = laid_out(part.uv, _reduced(part.image))
    return uv, _reduced(picture)


def _reduced(picture: Image) -> Image:
    """Return the picture no larger than it may be, and with two texels at least along each edge."""
    h, w = picture.shape[:2]
    share = min(1.0, TUNING.longest / max(h, w))
    size = (max(round(w * share), 2), max(round(h * share), 2))
    if size == (w, h):
        return picture
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def laid_out(uv: Array, picture: Image) -> tuple[Array, Image]:
    """Return coordinates (F, 3, 2) within [0, 1] and the picture, repeated where a triangle runs on over its edge."""
    beyond = ((uv < -1e-6) | (uv > 1 + 1e-6)).any(axis=1, keepdims=True)
    uv = np.where(beyond, uv - np.floor(uv.min(axis=1, keepdims=True) + 1e-6), uv)
    repeats = np.maximum(np.ceil(uv.max(axis=(0, 1)) - 1e-6), 1.0).astype(int)
    if (repeats > TUNING.most_repeats).any():
        raise AssetError(
            f"a texture is repeated {int(repeats.max())} times across a triangle, more than {TUNING.most_repeats}; "
            "bake it into one picture"
        )
    return np.clip(uv / repeats, 0.0, 1.0), np.tile(picture, (int(repeats[1]), int(repeats[0]), 1))


def plain(colours: Array) -> tuple[Array, Image]:
    """Return coordinates (F, 3, 2) and a picture with a patch for each of the colours (F, 3)."""
    steps = 255
    unique, inverse = np.unique(np.round(colours * steps), axis=0, return_inverse=True)
    while len(unique) > TUNING.most_colours:
        steps = min(steps // 2, TUNING.levels - 1)
        unique, inverse = np.unique(np.round(colours * steps), axis=0, return_inverse=True)
    edge = int(np.ceil(np.sqrt(len(unique))))
    grid = np.zeros((edge * edge, 3))
    grid[: len(unique)] = unique * (255 / steps)
    picture = np.round(grid).astype(np.uint8).reshape(edge, edge, 3)
    picture = np.repeat(np.repeat(picture, TUNING.patch, axis=0), TUNING.patch, axis=1)
    row, column = np.divmod(inverse.reshape(-1), edge)
    middle = np.stack([(column + 0.5) / edge, 1.0 - (row + 0.5) / edge], axis=-1)
    return np.repeat(middle[:, None], 3, axis=1), picture
