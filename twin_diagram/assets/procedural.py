"""Writes simple objects as assets: box, can, bottle and mug, with a seeded texture that tells every side apart.

Example:
    >>> from twin_diagram.assets.procedural import write_box
    >>> folder = write_box("out/objects/box", "box", (0.08, 0.06, 0.10), texture_seed=3)  # doctest: +SKIP
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from pydrake.common.yaml import yaml_dump_typed

from twin_diagram.assets import shapes
from twin_diagram.assets.building.inertia import solid_of
from twin_diagram.assets.building.surface import weld
from twin_diagram.assets.description import AssetSpec, CollisionShape, sdf, solid_inertia
from twin_diagram.assets.mesh import write_obj
from twin_diagram.assets.shapes import Patchwork
from twin_diagram.assets.texture import patches
from twin_diagram.errors import AssetError
from twin_diagram.runtime import atomic_file


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with what set them."""

    staves: int = 16
    """Flat pieces of a mug's wall: they lie 0.8 mm inside a radius of 42 mm at most."""

    handle: int = 7
    """Straight pieces of its handle: an odd number, so that one stands where it reaches out farthest."""


TUNING = Tuning()


def write_box(
    folder: str | Path, name: str, size: tuple[float, float, float], texture_seed: int = 0, mass: float = 0.4
) -> Path:
    """Write a full box with edge lengths `size` [m], O at its centre; return its folder.

    Raises:
        AssetError: a length or the mass is not positive.
    """
    _check(name, mass, *size)
    spec = AssetSpec(name, "box", list(size), mass, None, texture_seed, solids=[CollisionShape("box", list(size))])
    return _write(Path(folder), spec, shapes.box(size))


def write_can(
    folder: str | Path, name: str, radius: float, height: float, texture_seed: int = 0, mass: float = 0.35
) -> Path:
    """Write a full can, declared symmetric about z, O at its centre; return its folder."""
    _check(name, mass, radius, height)
    size = [2 * radius, 2 * radius, height]
    spec = AssetSpec(name, "can", size, mass, "z", texture_seed, solids=[CollisionShape("cylinder", [radius, height])])
    return _write(Path(folder), spec, shapes.can(radius, height))


def write_bottle(
    folder: str | Path, name: str, radius: float, height: float, texture_seed: int = 0, mass: float = 0.5
) -> Path:
    """Write a full bottle whose texture breaks its symmetry about z, O on the axis half-way up; return its folder.

    Its centre of mass lies below O, as its neck is narrow: what is told of it is of an even body within its surface.
    """
    _check(name, mass, radius, height)
    body, top = 0.72 * height, 0.82 * height
    solids = [
        CollisionShape("cylinder", [radius, body], [0.0, 0.0, (body - height) / 2]),
        CollisionShape("cylinder", [0.92 * radius, top - body], [0.0, 0.0, (body + top - height) / 2]),
        CollisionShape("cylinder", [0.36 * radius, height - top], [0.0, 0.0, top / 2]),
    ]
    spec = AssetSpec(name, "bottle", [2 * radius, 2 * radius, height], mass, None, texture_seed, solids=solids)
    return _write(Path(folder), spec, shapes.bottle(radius, height))


def write_mug(
    folder: str | Path, name: str, radius: float, height: float, texture_seed: int = 0, mass: float = 0.3
) -> Path:
    """Write an open mug with its handle towards +x, O on the axis half-way up; return its folder."""
    _check(name, mass, radius, height)
    bow_x, bow_z = shapes.handle_reach(radius, height)
    reach = radius + bow_x + shapes.TUNING.handle_tube
    thick = 2 * shapes.TUNING.handle_tube
    depth, tall = reach - 0.9 * radius, 2 * (bow_z + shapes.TUNING.handle_tube)
    solids = [
        CollisionShape("cylinder", [radius, height]),
        CollisionShape("box", [depth, thick, tall], [0.9 * radius + depth / 2, 0.0, 0.0]),
    ]
    spec = AssetSpec(name, "mug", [2 * reach, 2 * radius, height], mass, None, texture_seed, solids=solids)
    return _write(Path(folder), spec, shapes.mug(radius, height), hollow_mug(radius, height))


def hollow_mug(radius: float, height: float) -> list[CollisionShape]:
    """Return a mug's bottom, the staves of its wall and the pieces of its handle: what fingers meet.

    Staves and pieces touch the true surface in their middles and lie inside of it at their edges.
    """
    wall = shapes.TUNING.mug_wall
    found = [CollisionShape("cylinder", [radius, wall], [0.0, 0.0, (wall - height) / 2])]
    step = 2 * np.pi / TUNING.staves
    # The corners of a stave's outer face lie on the circle.
    edge, middle = 2 * radius * np.sin(step / 2), radius * np.cos(step / 2) - wall / 2
    for k in range(TUNING.staves):
        turn = k * step
        place = [middle * float(np.cos(turn)), middle * float(np.sin(turn)), 0.0]
        found.append(CollisionShape("box", [wall, edge, height], place, [0.0, 0.0, turn]))
    bow_x, bow_z = shapes.handle_reach(radius, height)
    angles = np.pi * (np.arange(TUNING.handle + 1) / TUNING.handle - 0.5)
    inward = radius - wall / 2
    ends = np.stack([inward + bow_x * np.cos(angles), bow_z * np.sin(angles)], axis=1)
    tube = shapes.TUNING.handle_tube * np.sqrt(np.pi)  # a square of the tube's cross-section
    for a, b in pairwise(ends):
        x, z = (a + b) / 2
        along = float(np.arctan2(b[0] - a[0], b[1] - a[1]))
        # As much longer as leaves no notch on the outside of the bend to the next.
        long = float(np.linalg.norm(b - a)) + tube * float(np.tan(np.pi / TUNING.handle / 2))
        found.append(CollisionShape("box", [tube, tube, long], [float(x), 0.0, float(z)], [0.0, along, 0.0]))
    return found


def _check(name: str, mass: float, *lengths: float) -> None:
    values = np.array([mass, *lengths], dtype=float)
    if not np.isfinite(values).all() or (values <= 0).any():
        raise AssetError(f"asset {name!r}: mass and lengths must be positive, not {[float(x) for x in values]}")
    if not name or not name.replace("_", "").isalnum():
        raise AssetError(f"asset name {name!r}: use letters, digits and underscores")


def _write(folder: Path, spec: AssetSpec, patchwork: Patchwork, contact: Sequence[CollisionShape] = ()) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    colour = patches(patchwork.texels.reshape(-1, 3), spec.texture_seed).reshape(patchwork.texels.shape)
    write_obj(patchwork.mesh, folder / spec.visual, np.round(colour * 255).astype(np.uint8))
    if spec.shape in ("bottle", "mug"):
        mesh = patchwork.mesh
        body = solid_of(weld(mesh.vertices[mesh.faces]))
        com, inertia = body.centre, body.inertia(spec.mass)
    else:
        com, inertia = np.zeros(3), solid_inertia(spec)
    atomic_file.write(folder / "model.sdf", sdf(spec, com, inertia, contact=contact).encode())
    # Last, because a folder with an `asset.yaml` counts as an asset.
    atomic_file.write(folder / "asset.yaml", yaml_dump_typed(spec).encode())
    return folder
