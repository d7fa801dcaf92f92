"""Things of five kinds whose mass does not lie as their surface says, and what a scanner would tell of them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from twin_diagram.estimation.weighing import Shape
from twin_diagram.model.rigid_body.mass_properties import about_centre, parameters_of, second_of

Array = np.ndarray
KINDS = ("box", "can", "angle", "bottle", "cup")
LOADS = ("none", "lump", "fill")
CELL = 0.002
"""Edge of the cells that truth is summed over [m]."""
ROUND = 32
"""Sides of a turned thing."""


@dataclass(frozen=True)
class Thing:
    """One object, origin in the middle of the box about it, longest axis z.

    Attributes:
        kind, load: of `KINDS`, `LOADS`.
        size: (3,) edges of the box about it [m].
        parameters: (10,) true, about the origin.
        told: its shape as reconstructed.
        off_centre: how far the centre of mass is from the even one [m].
    """

    kind: str
    load: str
    size: Array
    parameters: Array
    told: Shape
    off_centre: float


def draw(random: np.random.Generator, mass: float | None = None) -> Thing:
    """A thing; mass 0.1 to 1.5 kg where none is told."""
    kind, load = KINDS[random.integers(len(KINDS))], LOADS[random.integers(len(LOADS))]
    mass = float(np.exp(random.uniform(np.log(0.1), np.log(1.5)))) if mass is None else mass
    profile, size = _profile(kind, random)
    points = _cells(kind, profile, size)
    weights = np.full(len(points), 1.0 / len(points))
    even = weights @ points
    vertices, faces = _surface(kind, profile, size)
    while True:
        loaded = _loaded(load, points, weights, size, random)
        centre = loaded[1] @ loaded[0]
        if np.all(np.abs(centre - even) <= 0.25 * size):
            break
    cloud, share = loaded
    second = np.einsum("n,na,nb->ab", share, cloud - centre, cloud - centre) + np.eye(3) * CELL**2 / 12.0
    told = Shape.of_mesh(_reconstructed(vertices, random), faces)
    parameters = parameters_of(np.array(mass), centre, mass * second)
    return Thing(kind, load, size, parameters, told, float(np.linalg.norm(centre - even)))


def _loaded(load: str, points: Array, weights: Array, size: Array, random: np.random.Generator) -> tuple[Array, Array]:
    """Points and shares of the mass: even; with a ball of some millimetres in it; or one end heavier."""
    if load == "lump":
        share, radius = random.uniform(0.1, 0.6), random.uniform(0.1, 0.2) * size.min()
        ball = random.normal(size=(200, 3))
        ball *= radius * np.cbrt(random.uniform(size=(200, 1))) / np.linalg.norm(ball, axis=1, keepdims=True)
        ball += points[random.integers(len(points))] - ball.mean(axis=0)
        return np.vstack([points, ball]), np.concatenate([(1 - share) * weights, np.full(200, share / 200)])
    if load == "fill":
        normal = random.normal(size=3)
        along = points @ (normal / np.linalg.norm(normal))
        level = np.quantile(along, random.uniform(0.25, 0.75))
        heavier = np.where(along < level, random.uniform(2.0, 6.0), 1.0) * weights
        return points, heavier / heavier.sum()
    return points, weights


def _profile(kind: str, random: np.random.Generator) -> tuple[Array, Array]:
    """What describes a kind (radii over heights of turned things, widths of an angle), and the box about it [m]."""
    if kind == "box":
        edges = np.sort(random.uniform([0.035, 0.05, 0.08], [0.08, 0.11, 0.2]))
        return edges, edges
    if kind == "angle":
        size = random.uniform([0.03, 0.06, 0.08], [0.06, 0.1, 0.16])
        return random.uniform(0.3, 0.5, 2) * size[1:], size
    radius, height = random.uniform(0.022, 0.042), random.uniform(0.08, 0.2)
    h = height / 2
    if kind == "can":
        outline = np.array([[0, -h], [radius, -h], [radius, h], [0, h]])
    elif kind == "bottle":
        neck = random.uniform(0.35, 0.6) * radius
        outline = np.array([[0, -h], [radius, -h], [radius, 0.2 * h], [neck, 0.6 * h], [neck, h], [0, h]])
    else:
        wall, height = random.uniform(0.004, 0.008), random.uniform(0.07, 0.12)
        h = height / 2
        outline = np.array(
            [[0, -h], [radius, -h], [radius, h], [radius - wall, h], [radius - wall, wall - h], [0, wall - h]]
        )
    return outline, np.array([2 * radius, 2 * radius, 2 * h])


def _cells(kind: str, profile: Array, size: Array) -> Array:
    """Middles (N, 3) of cells inside."""
    axes = [(np.arange(int(np.ceil(s / CELL))) + 0.5) * s / np.ceil(s / CELL) - s / 2 for s in size]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    if kind == "box":
        return points
    if kind == "angle":
        return points[(points[:, 1] < profile[0] - size[1] / 2) | (points[:, 2] < profile[1] - size[2] / 2)]
    r, z = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    inside = np.zeros(len(points), dtype=bool)
    for (r0, z0), (r1, z1) in pairwise(profile):  # as many rays towards +r cross as not
        if z0 != z1:
            between = (z >= min(z0, z1)) & (z < max(z0, z1))
            inside ^= between & (r < r0 + (z - z0) / (z1 - z0) * (r1 - r0))
    return points[inside]


def _surface(kind: str, profile: Array, size: Array) -> tuple[Array, Array]:
    """Closed triangles, outside out: a turned outline, or an outline in y and z drawn along x."""
    if kind in ("box", "angle"):
        y, z = size[1:] / 2
        a, b = (profile - size[1:] / 2) if kind == "angle" else (y, z)
        outline = [[-y, -z], [y, -z], [y, b], [a, b], [a, z], [-y, z]] if kind == "angle" else []
        outline = np.array(outline or [[-y, -z], [y, -z], [y, z], [-y, z]])
        n = len(outline)
        vertices = np.vstack([np.column_stack([np.full(n, x), outline]) for x in (-size[0] / 2, size[0] / 2)])
        # An angle's caps are fans about its inner corner, which sees all of it; a box's about any.
        at = 3 if kind == "angle" else 0
        cap = [[at, (at + k) % n, (at + k + 1) % n] for k in range(1, n - 1)]
        sides = [[k, (k + 1) % n, n + (k + 1) % n] for k in range(n)] + [[k, n + (k + 1) % n, n + k] for k in range(n)]
        faces = [c[::-1] for c in cap] + [[n + i for i in c] for c in cap] + sides
        return vertices, np.array(faces)
    turn = 2 * np.pi * np.arange(ROUND) / ROUND
    grow = np.sqrt(2 * np.pi / ROUND / np.sin(2 * np.pi / ROUND))  # a polygon with the circle's area
    rings = [np.column_stack([grow * r * np.cos(turn), grow * r * np.sin(turn), np.full(ROUND, z)]) for r, z in profile]
    faces = []
    for k in range(len(profile) - 1):
        for i in range(ROUND):
            a, b = k * ROUND + i, k * ROUND + (i + 1) % ROUND
            faces += [[a, b, b + ROUND], [a, b + ROUND, a + ROUND]]
    return np.vstack(rings), np.array(faces)


def _reconstructed(vertices: Array, random: np.random.Generator) -> Array:
    """The surface as a scan has it: stretched and shifted by about a millimetre at its ends."""
    stretch = 1.0 + 0.008 * random.normal(size=3) + 0.0005 * random.normal(size=3) / np.ptp(vertices, axis=0)
    return vertices * stretch + 0.0005 * random.normal(size=3)


def principal(parameters: Array) -> tuple[Array, Array]:
    """Principal moments (3,), smallest first, and axes (3, 3) as columns."""
    moments, axes = np.linalg.eigh(about_centre(parameters)[2])
    return moments, axes


def spread(parameters: Array) -> Array:
    """Second moments about the centre per mass [m²]."""
    return second_of(about_centre(parameters)[2]) / parameters[0]
