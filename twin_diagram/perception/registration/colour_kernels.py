"""Samples colours at many pixels and fits their brightness, compiled; B poses, P points each."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import compiled, compiled_in_place

Image = npt.NDArray[np.float32]


@compiled_in_place
def sample(image: Image, x: float, y: float, out: Array) -> None:
    """Write what an image (h, w, 3) shows at (x, y), bilinear, its rim going on outside."""
    height, width = image.shape[:2]
    x, y = min(max(x, -2.0), width + 1.0), min(max(y, -2.0), height + 1.0)
    column, line = int(np.floor(x)), int(np.floor(y))
    s, t = x - column, y - line
    left, right = min(max(column, 0), width - 1), min(max(column + 1, 0), width - 1)
    top, bottom = min(max(line, 0), height - 1), min(max(line + 1, 0), height - 1)
    for i in range(3):
        above = image[top, left, i] * (1.0 - s) + image[top, right, i] * s
        below = image[bottom, left, i] * (1.0 - s) + image[bottom, right, i] * s
        out[i] = above * (1.0 - t) + below * t


@compiled
def plain_colours(image: Image, u: Array, v: Array, corner: tuple[float, float]) -> Array:
    """Return what an image from `corner` on shows at pixels u, v (B, P): (B, P, 3)."""
    found = np.empty((*u.shape, 3))
    for b in range(u.shape[0]):
        for k in range(u.shape[1]):
            sample(image, u[b, k] - corner[0], v[b, k] - corner[1], found[b, k])
    return found


@compiled
def cut_out(
    rgb: npt.NDArray[np.uint8], label: npt.NDArray[np.int16], stride: int, corners: tuple[int, int, int, int]
) -> Image:
    """Return colours (h, w, 3) of 1 of what stands in a part of an image, and beside them 1 there: (h, w, 4).

    Args:
        rgb: (H, W, 3) the whole image.
        label: of every `stride`-th pixel; what stands has one from 0 on.
        stride: see there.
        corners: first and last row and column.
    """
    v0, v1, u0, u1 = corners
    out = np.zeros((v1 - v0, u1 - u0, 4), dtype=np.float32)
    share = np.float32(1.0 / 255.0)
    for i in range(v0, v1):
        line = i // stride
        for cell in range(u0 // stride, (u1 - 1) // stride + 1):
            if label[line, cell] < 0:
                continue
            for j in range(max(u0, cell * stride), min(u1, (cell + 1) * stride)):
                for k in range(3):
                    out[i - v0, j - u0, k] = np.float32(rgb[i, j, k]) * share
                out[i - v0, j - u0, 3] = 1.0
    return out


@compiled
def shared_out(blurred: Image, least: np.float32) -> Image:
    """Return the colours (h, w, 3) of blurred ones (h, w, 4), over how much of each pixel's surroundings counted."""
    height, width = blurred.shape[:2]
    out = np.zeros((height, width, 3), dtype=np.float32)
    for i in range(height):
        for j in range(width):
            if blurred[i, j, 3] == 0.0:
                continue
            total = max(blurred[i, j, 3], least)
            for k in range(3):
                out[i, j, k] = blurred[i, j, k] / total
    return out


@compiled_in_place
def solve(A: Array, b: Array) -> None:
    """Turn b (n,) into the solution of A x = b, A (n, n) being positive definite; both are written over."""
    n = b.shape[0]
    for i in range(n):
        for j in range(i + 1, n):
            share = A[j, i] / A[i, i]
            for k in range(i + 1, n):
                A[j, k] -= share * A[i, k]
            b[j] -= share * b[i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= A[i, k] * b[k]
        b[i] /= A[i, i]


@compiled
def gains(found: Array, colour: Array, n: Array, weight: Array, even: Array) -> Array:
    """Return the brightness (B, P) of points: g(n) = a + b · n for which g · colour is nearest to what was found."""
    result = np.empty(weight.shape)
    feature = np.ones(4)
    for b in range(weight.shape[0]):
        normal, right, total = np.zeros((4, 4)), np.zeros(4), 1e-6
        for k in range(weight.shape[1]):
            w = weight[b, k]
            if w == 0.0:
                continue
            energy, match = 0.0, 0.0
            for i in range(3):
                energy += colour[b, k, i] * colour[b, k, i] * w
                match += colour[b, k, i] * found[b, k, i] * w
                feature[1 + i] = n[b, k, i]
            total += energy
            for i in range(4):
                right[i] += feature[i] * match
                for j in range(4):
                    normal[i, j] += feature[i] * feature[j] * energy
        for i in range(4):
            normal[i, i] += total * even[i]
        solve(normal, right)
        for k in range(weight.shape[1]):
            gain = right[0] + right[1] * n[b, k, 0] + right[2] * n[b, k, 1] + right[3] * n[b, k, 2]
            result[b, k] = min(max(gain, 0.1), 2.0)
    return result


@compiled
def sloped_colours(image: Image, u: Array, v: Array, weight: Array, corner: tuple[float, float]) -> Array:
    """Return colours and their derivatives by u and v (B, P, 9) where `weight` (B, P) is not 0."""
    found = np.zeros((*weight.shape, 9))
    _sample_all(image, (u, v, weight), corner, (np.empty(3), np.empty(3)), found)
    return found


@compiled_in_place
def _sample_all(
    image: Image,
    places: tuple[Array, Array, Array],
    corner: tuple[float, float],
    room: tuple[Array, Array],
    found: Array,
) -> None:
    """Write what `sloped_colours` returns where it is not 0; `room`, twice (3,), is written over."""
    u, v, weight = places
    height, width = image.shape[:2]
    more, less = room
    for b in range(weight.shape[0]):
        for k in range(weight.shape[1]):
            if weight[b, k] == 0.0:
                continue
            x, y, out = u[b, k] - corner[0], v[b, k] - corner[1], found[b, k]
            if x >= 1.0 and y >= 1.0 and x < width - 2.0 and y < height - 2.0:
                _sample_sloped(image, x, y, out)
                continue
            sample(image, x, y, out)
            sample(image, x + 1.0, y, more)
            sample(image, x - 1.0, y, less)
            for i in range(3):
                out[3 + i] = 0.5 * (more[i] - less[i])
            sample(image, x, y + 1.0, more)
            sample(image, x, y - 1.0, less)
            for i in range(3):
                out[6 + i] = 0.5 * (more[i] - less[i])


@compiled_in_place
def _sample_sloped(image: Image, x: float, y: float, out: Array) -> None:
    """Write colours (3,) at (x, y) and their central differences by x and y, a pixel and more within an image."""
    column, line = int(x), int(y)
    s, t = x - column, y - line
    for i in range(3):
        a, b = float(image[line, column, i]), float(image[line, column + 1, i])
        c, d = float(image[line + 1, column, i]), float(image[line + 1, column + 1, i])
        out[i] = (a * (1.0 - s) + b * s) * (1.0 - t) + (c * (1.0 - s) + d * s) * t
        upper = (b - image[line, column - 1, i]) * (1.0 - s) + (image[line, column + 2, i] - a) * s
        lower = (d - image[line + 1, column - 1, i]) * (1.0 - s) + (image[line + 1, column + 2, i] - c) * s
        out[3 + i] = 0.5 * (upper * (1.0 - t) + lower * t)
        left = (c - image[line - 1, column, i]) * (1.0 - t) + (image[line + 2, column, i] - a) * t
        right = (d - image[line - 1, column + 1, i]) * (1.0 - t) + (image[line + 2, column + 1, i] - b) * t
        out[6 + i] = 0.5 * (left * (1.0 - s) + right * s)


@compiled
def curvature_counts(image: npt.NDArray[np.uint8], step: int) -> npt.NDArray[np.int64]:
    """Return how often each size of a difference of Laplacians occurs (3, 2041), at every `step`-th pixel (h, w, 3)."""
    counts = np.zeros((3, 2041), dtype=np.int64)
    for line in range(1, image.shape[0] - 1, step):
        for column in range(1, image.shape[1] - 1, step):
            for i in range(3):
                value = 4 * np.int64(image[line, column, i])
                for near in (-1, 1):
                    value -= 2 * (np.int64(image[line + near, column, i]) + np.int64(image[line, column + near, i]))
                    value += np.int64(image[line + near, column - 1, i]) + np.int64(image[line + near, column + 1, i])
                counts[i, abs(value)] += 1
    return counts
