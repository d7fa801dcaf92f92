"""Draws meshes and clouds from one side, by painting what is far first."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from twin_diagram.signals.arrays import Array

Picture = npt.NDArray[np.uint8]
SIZE = 320
"""Of a picture [pixel]."""
LIGHT = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
PAINTS = np.array([[228, 110, 80], [90, 150, 220], [110, 190, 110], [220, 190, 80], [170, 110, 200], [90, 200, 200]])


def axes_from(azimuth: float, height: float) -> Array:
    """Return the rows right, down, away of a view from that azimuth and height [deg]."""
    a, h = np.radians([azimuth, height])
    away = -np.array([np.cos(h) * np.cos(a), np.cos(h) * np.sin(a), np.sin(h)])
    right = np.cross(away, [0.0, 0, 1]) / np.cos(h)
    return np.stack([right, np.cross(away, right), away])


def _placed(points: Array, axes: Array, middle: Array, reach: float) -> Array:
    """Return pixel columns and rows, and depth, of points (…, 3)."""
    own = (points - middle) @ axes.T
    own[..., :2] = own[..., :2] * (0.45 * SIZE / reach) + SIZE / 2
    return np.asarray(own)


def mesh_picture(
    corners: Array, colours: Array, middle: Array, reach: float, azimuth: float = -60.0, height: float = 30.0
) -> Picture:
    """Return a picture of triangles (F, 3, 3) in colours (F, 3) of 255, what is within `reach` [m] of the middle."""
    axes = axes_from(azimuth, height)
    at = _placed(corners, axes, middle, reach)
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-20)
    facing = flat @ axes[2] < 0
    shade = 0.55 + 0.45 * np.clip(flat @ LIGHT, 0, 1)
    image = np.full((SIZE, SIZE, 3), 255, np.uint8)
    paint = np.clip(colours * shade[:, None], 0, 255)
    for k in np.argsort(-at[:, :, 2].mean(axis=1)):
        if facing[k]:
            corner = np.rint(at[k, :, :2] * 16).astype(np.int32)
            cv2.fillConvexPoly(image, corner, paint[k].tolist(), cv2.LINE_8, 4)
    return image


def pieces_picture(pieces: Sequence[Array], middle: Array, reach: float) -> Picture:
    """Return a picture of convex pieces, each in a colour of its own."""
    corners, colours = [], []
    for k, piece in enumerate(pieces):
        hull = ConvexHull(piece)
        flat = piece[hull.simplices]
        inside = np.einsum(
            "fi,fi->f", np.cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]), hull.equations[:, :3]
        )
        flat[inside < 0] = flat[inside < 0][:, ::-1]
        corners.append(flat)
        colours.append(np.tile(PAINTS[k % len(PAINTS)].astype(float), (len(flat), 1)))
    return mesh_picture(np.concatenate(corners), np.concatenate(colours), middle, reach)


def cloud_picture(points: Array, colours: Array, middle: Array, reach: float, height: float = 30.0) -> Picture:
    """Return a picture of points (N, 3) in colours (N, 3) of 255."""
    at = _placed(points, axes_from(-60.0, height), middle, reach)
    image = np.full((SIZE, SIZE, 3), 255, np.uint8)
    order = np.argsort(-at[:, 2])
    column, row = np.rint(at[order, :2]).astype(int).T
    good = (column >= 0) & (row >= 0) & (column < SIZE - 1) & (row < SIZE - 1)
    for k in range(4):
        image[row[good] + k // 2, column[good] + k % 2] = colours[order][good]
    return image


def view_picture(rgb: Picture, mask: npt.NDArray[np.bool_] | None, width: int = 160) -> Picture:
    """Return a small view, its mask's outline drawn."""
    step = max(1, rgb.shape[1] // (2 * width))
    image = np.ascontiguousarray(rgb[::step, ::step])
    if mask is not None:
        outline, _ = cv2.findContours(
            np.ascontiguousarray(mask[::step, ::step]).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
        )
        cv2.drawContours(image, outline, -1, (255, 60, 0), 2)
    return np.asarray(
        cv2.resize(image, (width, width * image.shape[0] // image.shape[1]), interpolation=cv2.INTER_AREA)
    )
