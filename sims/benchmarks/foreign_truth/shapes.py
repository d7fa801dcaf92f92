"""Draws things that no other part of the project has: lathed and sawn ones of few colours, and strangers like them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import trimesh
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]
Colour = Array
HALF = {axis: Rotation.from_rotvec(np.pi * np.eye(3)[k]).as_matrix() for k, axis in enumerate("xyz")}


@dataclass(frozen=True)
class Part:
    """A watertight mesh of one colour (3,) of 255."""

    mesh: trimesh.Trimesh
    colour: Colour


@dataclass(frozen=True)
class Foreign:
    """A thing, z upwards, its lowest point at z = 0.

    Attributes:
        name: of it; of what is in no library it begins with `?`.
        parts: the last one tells it from its like, where `telling`.
        axis: any turn about z leaves it alike.
        turns: (T, 3, 3) that leave it alike, none first.
        telling: name of the part that alone tells which way round it is; empty: there is none.
        lying: it lies on its side.
    """

    name: str
    parts: tuple[Part, ...]
    axis: bool = False
    turns: tuple[Array, ...] = (np.eye(3),)
    telling: str = ""
    lying: bool = False

    @property
    def vertices(self) -> Array:
        """(V, 3) of all its parts [m]."""
        return np.concatenate([np.asarray(part.mesh.vertices) for part in self.parts])

    def whole(self) -> trimesh.Trimesh:
        """Return all parts as one mesh with colours at its vertices, as others' programs write them."""
        meshes = []
        for part in self.parts:
            mesh = part.mesh.copy()
            mesh.visual.vertex_colors = np.append(part.colour, 255).astype(np.uint8)
            meshes.append(mesh)
        return trimesh.util.concatenate(meshes)


def library(rng: np.random.Generator) -> list[Foreign]:
    """Draw ten things to be known."""
    grey, white, paint = np.full(3, 150.0), np.full(3, 225.0), _paint(rng)
    r, h = rng.uniform(0.036, 0.044), rng.uniform(0.085, 0.105)
    mug = (Part(_cup(r, h, 0.003), grey), Part(_handle(r, h, rng), grey))
    bowl = Part(_bowl(rng.uniform(0.06, 0.075), rng.uniform(0.045, 0.06)), _paint(rng))
    bottle = Part(_lathe([(0.034, 0), (0.034, 0.11), (0.014, 0.15), (0.014, 0.19)], rng), _paint(rng))
    vase = Part(_lathe([(0.03, 0), (0.045, 0.05), (0.022, 0.10), (0.036, 0.13)], rng), grey)
    long, high, deep = rng.uniform(0.10, 0.13), rng.uniform(0.07, 0.09), rng.uniform(0.035, 0.05)
    ell = (Part(_box(long, deep, 0.03), grey), Part(_box(0.03, deep, high, (0.015 - long / 2, 0, 0)), grey))
    tee = (Part(_box(long, deep, 0.025, (0, 0, high)), paint), Part(_box(0.028, deep, high), paint))
    w, d, top = rng.uniform(0.065, 0.08), rng.uniform(0.06, 0.07), rng.uniform(0.12, 0.15)
    carton = (Part(_box(w, d, top), white), Part(_roof(w, d, top, 0.03), white))
    plain = Part(_box(rng.uniform(0.11, 0.13), rng.uniform(0.075, 0.09), rng.uniform(0.045, 0.06)), white)
    w, d, top = rng.uniform(0.09, 0.11), rng.uniform(0.05, 0.06), rng.uniform(0.12, 0.15)
    label = _box(0.6 * w, 0.001, 0.5 * top, (0.0, -d / 2, 0.3 * top))
    return [
        Foreign("mug", mug, telling="handle"),
        Foreign("bowl", (bowl,), axis=True),
        Foreign("screwdriver", _screwdriver(rng), axis=True, telling="shaft", lying=True),
        Foreign("bottle", (bottle,), axis=True),
        Foreign("vase", (vase,), axis=True),
        Foreign("ell", ell),
        Foreign("tee", tee, turns=(np.eye(3), HALF["z"])),
        Foreign("carton", carton, turns=(np.eye(3), HALF["z"]), telling="roof"),
        Foreign("box", (plain,), turns=(np.eye(3), *HALF.values())),
        Foreign("labelled", (Part(_box(w, d, top), _paint(rng)), Part(label, white)), telling="label"),
    ]


def strangers(known: Sequence[Foreign], rng: np.random.Generator) -> list[Foreign]:
    """Draw four things that no library holds: two are like known ones, as far as one side shows."""
    of = {one.name: one for one in known}
    mug, box = of["mug"].parts[0], of["box"].parts[0]
    radius, height = float(mug.mesh.extents[0]) / 2, float(mug.mesh.extents[2])
    size = box.mesh.extents * (1 + rng.uniform(0.12, 0.25, 3) * rng.choice([-1, 1], 3))
    profile = [(rng.uniform(0.02, 0.05), z) for z in np.linspace(0, rng.uniform(0.06, 0.14), 4)]
    ball = trimesh.creation.icosphere(subdivisions=3, radius=rng.uniform(0.03, 0.05))
    ball.apply_translation([0, 0, -ball.bounds[0, 2]])
    return [
        Foreign("?cylinder", (Part(_lathe([(radius, 0), (radius, height)], None), mug.colour),), axis=True),
        Foreign("?box", (Part(_box(*size), box.colour),)),
        Foreign("?turned", (Part(_lathe(profile, None), _paint(rng)),), axis=True),
        Foreign("?ball", (Part(ball, _paint(rng)),), axis=True),
    ]


def _paint(rng: np.random.Generator) -> Colour:
    return np.asarray(rng.uniform(40.0, 220.0, 3))


def _box(x: float, y: float, z: float, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    """Return a box whose foot's middle is at a place [m]."""
    mesh = trimesh.creation.box((x, y, z))
    mesh.apply_translation(np.array(at) + [0.0, 0.0, z / 2])
    return mesh


def _roof(x: float, y: float, foot: float, height: float) -> trimesh.Trimesh:
    """Return a roof whose ridge goes along x."""
    foot_corners = [[sx * x / 2, sy * y / 2, foot] for sx in (-1, 1) for sy in (-1, 1)]
    ridge = [[sx * x / 2, 0.0, foot + height] for sx in (-1, 1)]
    return trimesh.convex.convex_hull(np.array(foot_corners + ridge))


def _lathe(profile: Sequence[tuple[float, float]], rng: np.random.Generator | None) -> trimesh.Trimesh:
    """Return a full body turned about z from radius and height [m], each drawn to 8 % where `rng` is."""
    line = np.array(profile)
    if rng is not None:
        line = line * (1 + 0.08 * rng.uniform(-1, 1, 2))
    closed = np.concatenate([[[0.0, line[0, 1]]], line, [[0.0, line[-1, 1]]]])
    return trimesh.creation.revolve(closed, sections=64)


def _cup(radius: float, height: float, wall: float) -> trimesh.Trimesh:
    inner = radius - wall
    line = [(0, 0), (radius, 0), (radius, height), (inner, height), (inner, 2 * wall), (0, 2 * wall)]
    return trimesh.creation.revolve(np.array(line), sections=64)


def _bowl(radius: float, height: float) -> trimesh.Trimesh:
    angle = np.linspace(0.35, np.pi / 2, 12)
    outer = np.stack([radius * np.sin(angle), height * (1 - np.cos(angle))], axis=1)
    outer[:, 1] -= outer[0, 1]
    inner = outer[::-1] * [1.0, 1.0] + [-0.004, 0.004]
    inner[0, 1] = outer[-1, 1]
    line = np.concatenate([[[0.0, 0.0]], outer, inner, [[0.0, inner[-1, 1]]]])
    return trimesh.creation.revolve(line, sections=64)


def _handle(radius: float, height: float, rng: np.random.Generator) -> trimesh.Trimesh:
    """Return half a ring at the side of a cup."""
    ring, tube = 0.3 * height, rng.uniform(0.005, 0.0065)
    angle = np.linspace(-np.pi / 2, np.pi / 2, 17)
    path = np.stack([radius - 0.004 + 0.9 * ring * np.cos(angle), 0 * angle, height / 2 + ring * np.sin(angle)], axis=1)
    pieces = [trimesh.creation.cylinder(tube, segment=[a, b], sections=16) for a, b in pairwise(path)]
    balls = [trimesh.creation.icosphere(subdivisions=1, radius=tube).apply_translation(place) for place in path]
    return trimesh.util.concatenate([*pieces, *balls])


def _screwdriver(rng: np.random.Generator) -> tuple[Part, Part]:
    grip, shaft = rng.uniform(0.09, 0.11), rng.uniform(0.08, 0.11)
    r = rng.uniform(0.013, 0.016)
    profile = [(0.7 * r, 0), (r, 0.01), (r, 0.7 * grip), (0.75 * r, 0.8 * grip), (0.9 * r, grip)]
    blade = trimesh.creation.cylinder(0.0035, height=shaft, sections=24)
    blade.apply_translation([0, 0, grip + shaft / 2 - 0.001])
    return Part(_lathe(profile, None), _paint(rng)), Part(blade, np.full(3, 170.0))
