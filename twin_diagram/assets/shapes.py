"""Meshes of simple objects with a texture atlas, and the surface point that each texel of it shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import cast

import numpy as np

from twin_diagram.assets.mesh import Mesh
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Patchwork:
    """A mesh and its atlas: `texels` (h, w, 3) holds the point in O that each texel shows."""

    mesh: Mesh
    texels: Array


@dataclass(frozen=True)
class _Chart:
    """A surface over the unit square (s to the right, t upwards); it fills one rectangle of the atlas.

    Attributes:
        point: (s, t), each (...,), to points (..., 3); right × up points outwards.
        normal: the same for unit normals.
        s: (n,) and t: (m,) where the grid of vertices has its lines; a t that appears twice is a sharp edge, its first
            row takes the normal from below, its second from above.
    """

    point: Callable[[Array, Array], Array]
    normal: Callable[[Array, Array], Array]
    s: Array
    t: Array


def _assemble(charts: list[_Chart], columns: int, width: int, height: int) -> Patchwork:
    """Lay charts out on a regular atlas, `columns` beside each other, each `width` by `height` texels."""
    rows = -(-len(charts) // columns)
    texels = np.zeros((rows * height, columns * width, 3))
    vertices, normals, uvs, faces = [], [], [], []
    start = 0
    for k, chart in enumerate(charts):
        row, column = divmod(k, columns)
        dense = np.meshgrid(np.linspace(0, 1, width), np.linspace(1, 0, height))
        texels[row * height : (row + 1) * height, column * width : (column + 1) * width] = chart.point(*dense)
        m, n = len(chart.t), len(chart.s)
        s, t = (x.ravel() for x in np.meshgrid(chart.s, chart.t))
        # A sharp edge: evaluate the normal a little to its own side.
        side = np.zeros(m)
        side[:-1][np.diff(chart.t) == 0] = -1e-6
        side[1:][np.diff(chart.t) == 0] = 1e-6
        vertices.append(chart.point(s, t))
        normals.append(chart.normal(s, t + np.repeat(side, n)))
        # Half a texel stays free at the rim, so that interpolation never reaches into the neighbouring chart.
        u = (column * width + 0.5 + s * (width - 1)) / texels.shape[1]
        v = 1.0 - (row * height + 0.5 + (1 - t) * (height - 1)) / texels.shape[0]
        uvs.append(np.stack([u, v], axis=1))
        i = (np.arange(m - 1)[:, None] * n + np.arange(n - 1)[None, :]).ravel() + start
        faces.append(np.concatenate([np.stack([i, i + 1, i + n + 1], 1), np.stack([i, i + n + 1, i + n], 1)]))
        start += m * n
    v3, f = np.concatenate(vertices), np.concatenate(faces)
    # A row that has shrunk to a point on the axis leaves triangles without area.
    area = np.linalg.norm(np.cross(v3[f[:, 1]] - v3[f[:, 0]], v3[f[:, 2]] - v3[f[:, 0]]), axis=1)
    return Patchwork(Mesh(v3, np.concatenate(normals), np.concatenate(uvs), f[area > 1e-12]), texels)


def box(size: tuple[float, float, float]) -> Patchwork:
    """Return a box of `size` [m] about O: one chart per face."""
    half = np.asarray(size) / 2
    charts = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            normal, upward = np.eye(3)[axis] * sign, np.eye(3)[2 if axis != 2 else 1]
            right = np.cross(upward, normal)

            def point(s: Array, t: Array, n: Array = normal, r: Array = right, w: Array = upward) -> Array:
                return cast(Array, half * (n + r * (2 * s - 1)[..., None] + w * (2 * t - 1)[..., None]))

            def constant(s: Array, t: Array, n: Array = normal) -> Array:
                return np.broadcast_to(n, (*s.shape, 3))

            charts.append(_Chart(point, constant, np.array([0.0, 1.0]), np.array([0.0, 1.0])))
    return _assemble(charts, 3, 84, 126)


def _turned(profile: Array, sectors: int) -> _Chart:
    """Return a body of revolution about z from its outline (N, 2) of radius and z, lower pole to upper."""
    step = np.diff(profile, axis=0)
    lengths = np.linalg.norm(step, axis=1)
    at = np.concatenate([[0.0], np.cumsum(lengths)]) / lengths.sum()
    slope = np.stack([step[:, 1], -step[:, 0]], axis=1) / lengths[:, None]

    def point(s: Array, t: Array) -> Array:
        r, z = (np.interp(t, at, profile[:, k]) for k in range(2))
        return np.stack([r * np.cos(2 * np.pi * s), r * np.sin(2 * np.pi * s), z], axis=-1)

    def normal(s: Array, t: Array) -> Array:
        n = slope[np.clip(np.searchsorted(at, t) - 1, 0, len(slope) - 1)]
        return np.stack([n[..., 0] * np.cos(2 * np.pi * s), n[..., 0] * np.sin(2 * np.pi * s), n[..., 1]], axis=-1)

    return _Chart(point, normal, _spaced(sectors), np.repeat(at, 2)[1:-1])


def _spaced(steps: int) -> Array:
    return np.linspace(0.0, 1.0, steps + 1, dtype=np.float64)


def can(radius: float, height: float) -> Patchwork:
    """Return an upright cylinder about O."""
    h = height / 2
    return _assemble([_turned(np.array([[0, -h], [radius, -h], [radius, h], [0, h]]), 40)], 1, 256, 192)


def bottle(radius: float, height: float) -> Patchwork:
    """Return a cylinder with a round shoulder and a narrow neck; O half-way up."""
    h, neck = height / 2, 0.36 * radius
    turn = np.linspace(0, np.pi / 2, 7)
    shoulder = np.stack([neck + (radius - neck) * np.cos(turn), 0.12 * height + 0.2 * height * np.sin(turn)], axis=1)
    profile = np.concatenate([[[0, -h], [radius, -h]], shoulder, [[neck, h], [0, h]]])
    return _assemble([_turned(profile, 40)], 1, 256, 256)


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand, as mugs are."""

    mug_wall: float = 0.004
    """Thickness of a mug's wall [m]."""

    handle_tube: float = 0.006
    """Radius of the tube that makes a mug's handle [m]."""


TUNING = Tuning()


def mug(radius: float, height: float) -> Patchwork:
    """Return an open cylinder with a handle on the +x side; O on the cylinder's axis half-way up."""
    h, inner = height / 2, radius - TUNING.mug_wall
    profile = np.array(
        [[0, -h], [radius, -h], [radius, h], [inner, h], [inner, TUNING.mug_wall - h], [0, TUNING.mug_wall - h]]
    )
    bow_x, bow_z = handle_reach(radius, height)

    def tube(s: Array, t: Array) -> tuple[Array, Array]:
        along, around = np.pi * (t - 0.5), 2 * np.pi * s
        inward = radius - TUNING.mug_wall / 2
        centre = np.stack([inward + bow_x * np.cos(along), np.zeros_like(s), bow_z * np.sin(along)], axis=-1)
        out = np.stack([bow_z * np.cos(along), np.zeros_like(s), bow_x * np.sin(along)], axis=-1)
        out = out / np.linalg.norm(out, axis=-1, keepdims=True)
        normal = out * np.cos(around)[..., None] + np.array([0.0, 1.0, 0.0]) * np.sin(around)[..., None]
        return centre + TUNING.handle_tube * normal, normal

    handle = _Chart(lambda s, t: tube(s, t)[0], lambda s, t: tube(s, t)[1], _spaced(12), _spaced(16))
    return _assemble([_turned(profile, 40), handle], 1, 256, 128)


def handle_reach(radius: float, height: float) -> tuple[float, float]:
    """Return how far a mug's handle reaches out from the wall, and half its height [m], to the tube's centre line."""
    return 0.62 * radius, 0.30 * height


def _rectangle(corner: Array, right: Array, up: Array) -> _Chart:
    """Return a flat chart from a corner (3,) along two edges (3,) each; right × up points outwards."""
    normal = np.cross(right, up) / (np.linalg.norm(right) * np.linalg.norm(up))

    def point(s: Array, t: Array) -> Array:
        return cast(Array, corner + s[..., None] * right + t[..., None] * up)

    def constant(s: Array, t: Array) -> Array:
        return np.broadcast_to(normal, (*s.shape, 3))

    return _Chart(point, constant, np.array([0.0, 1.0]), np.array([0.0, 1.0]))


def angle(legs: tuple[float, float], width: float, thick: float) -> Patchwork:
    """Return an L: legs along x and z from the origin, `width` about y = 0, `thick` [m]; closed, no T-junctions."""
    (a, b), w, t = legs, width, thick
    y, across = np.array([0.0, 1.0, 0.0]), np.array([0.0, w, 0.0])
    # The outline (x, z), counter-clockwise seen from −y, cut where the legs' inner faces meet it.
    outline = np.array([[0, 0], [t, 0], [a, 0], [a, t], [t, t], [t, b], [0, b], [0, t]], dtype=float)
    charts = []
    for k, (x, z) in enumerate(outline):
        step = outline[(k + 1) % len(outline)] - (x, z)
        charts.append(_rectangle(np.array([x, -w / 2, z]), np.array([step[0], 0.0, step[1]]), across))
    for low, size in (((0.0, 0.0), (t, t)), ((t, 0.0), (a - t, t)), ((0.0, t), (t, b - t))):
        right, up = np.array([size[0], 0.0, 0.0]), np.array([0.0, 0.0, size[1]])
        corner = np.array([low[0], 0.0, low[1]])
        charts.append(_rectangle(corner - w / 2 * y, right, up))
        charts.append(_rectangle(corner + w / 2 * y + right, -right, up))
    charts = [chart if _outward(chart, np.array([t / 2, 0.0, t / 2])) else _turned_over(chart) for chart in charts]
    return _assemble(charts, 4, 84, 84)


def _outward(chart: _Chart, inside: Array) -> bool:
    """Return whether a flat chart's normal leads away from a point that lies behind it."""
    middle = np.array([0.5])
    return bool((chart.normal(middle, middle)[0] @ (chart.point(middle, middle)[0] - inside)) > 0)


def _turned_over(chart: _Chart) -> _Chart:
    """Return a flat chart with its other side outwards."""
    corner = chart.point(np.array([0.0]), np.array([0.0]))[0]
    right = chart.point(np.array([1.0]), np.array([0.0]))[0] - corner
    up = chart.point(np.array([0.0]), np.array([1.0]))[0] - corner
    return _rectangle(corner + right, -right, up)


def ring(radii: tuple[float, float], height: float) -> Patchwork:
    """Return an upright ring about O: inner and outer radius, height [m]."""
    (inner, outer), h = radii, height / 2
    outline = np.array([[inner, -h], [outer, -h], [outer, h], [inner, h], [inner, -h]])
    return _assemble([_turned(outline, 48)], 1, 256, 192)


def flask_profile(radii: tuple[float, float], height: float) -> Array:
    """Return the outline (N, 2) of a flask, radius and z, pole to pole: foot, taper, neck."""
    (foot, neck), h = radii, height / 2
    return np.array([[0.0, -h], [foot, -h], [foot, -0.45 * h], [neck, 0.5 * h], [neck, h], [0.0, h]])


def flask(radii: tuple[float, float], height: float) -> Patchwork:
    """Return an upright flask about O that tapers from its foot to its neck [m]."""
    return _assemble([_turned(flask_profile(radii, height), 40)], 1, 256, 256)
