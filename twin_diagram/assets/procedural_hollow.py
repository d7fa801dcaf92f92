"""Writes simple objects that are not convex as assets: an angle, a ring and a flask, with their exact convex pieces.

Example:
    >>> from twin_diagram.assets.procedural_hollow import write_ring
    >>> folder = write_ring("out/objects", "ring", (0.03, 0.045), 0.03)  # doctest: +SKIP
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twin_diagram.assets import shapes
from twin_diagram.assets.building.inertia import solid_of
from twin_diagram.assets.building.surface import weld
from twin_diagram.assets.building.write_asset import NewAsset, write_asset
from twin_diagram.assets.mesh import Mesh
from twin_diagram.assets.shapes import Patchwork
from twin_diagram.assets.texture import patches
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array


def write_angle(
    library: str | Path,
    name: str,
    legs: tuple[float, float],
    width: float,
    thick: float,
    texture_seed: int = 0,
    mass: float = 0.3,
) -> Path:
    """Write an L of two legs that are `legs` long (along x and z), `width` wide (y) and `thick` [m]; return its folder.

    Raises:
        AssetError: a length or the mass is not positive, or a leg is no longer than thick.
    """
    _check(name, mass, *legs, width, thick)
    if min(legs) <= thick:
        raise AssetError(f"asset {name!r}: legs of {legs} m are no longer than {thick} m, which is how thick they are")
    (a, b), half = legs, width / 2
    low = _box([0.0, -half, 0.0], [a, half, thick])
    high = _box([0.0, -half, thick], [thick, half, b])
    return _write(library, name, shapes.angle(legs, width, thick), [low, high], texture_seed, mass)


def write_ring(
    library: str | Path,
    name: str,
    radii: tuple[float, float],
    height: float,
    texture_seed: int = 0,
    mass: float = 0.25,
    segments: int = 16,
) -> Path:
    """Write a ring with an inner and an outer radius and a height [m]; return its folder.

    Raises:
        AssetError: a length or the mass is not positive, or the outer radius is not the larger one.
    """
    _check(name, mass, *radii, height)
    inner, outer = radii
    if outer <= inner:
        raise AssetError(f"asset {name!r}: the outer radius {outer} m is not above the inner one, {inner} m")
    pieces = []
    for k in range(segments):
        angles = 2 * np.pi * np.array([k, k + 0.5, k + 1]) / segments
        rims = [np.array([r * np.cos(angles), r * np.sin(angles)]).T for r in (inner, outer)]
        flat = np.concatenate([rims[0][[0, 2]], rims[1]])
        pieces.append(np.concatenate([np.insert(flat, 2, z, axis=1) for z in (-height / 2, height / 2)]))
    return _write(library, name, shapes.ring(radii, height), pieces, texture_seed, mass)


def write_flask(
    library: str | Path,
    name: str,
    radii: tuple[float, float],
    height: float,
    texture_seed: int = 0,
    mass: float = 0.4,
) -> Path:
    """Write a full flask that tapers from its foot's radius to its neck's; return its folder.

    Raises:
        AssetError: a length or the mass is not positive, or the neck is the wider.
    """
    _check(name, mass, *radii, height)
    foot, neck = radii
    if neck >= foot:
        raise AssetError(f"asset {name!r}: the neck's radius {neck} m is not below the foot's, {foot} m")
    profile = shapes.flask_profile(radii, height)[1:-1]
    pieces = [_frustum(profile[[k, k + 1]]) for k in range(len(profile) - 1)]
    return _write(library, name, shapes.flask(radii, height), pieces, texture_seed, mass)


def _frustum(ends: Array, sides: int = 32) -> Array:
    angle = 2 * np.pi * np.arange(sides) / sides
    rings = [[r * np.cos(angle), r * np.sin(angle), np.full(sides, z)] for r, z in ends]
    return np.concatenate([np.array(ring).T for ring in rings])


def _box(low: list[float], high: list[float]) -> Array:
    return np.array(np.meshgrid(*zip(low, high, strict=True))).T.reshape(-1, 3)


def _check(name: str, mass: float, *lengths: float) -> None:
    values = np.array([mass, *lengths], dtype=float)
    if not np.isfinite(values).all() or (values <= 0).any():
        raise AssetError(f"asset {name!r}: mass and lengths must be positive, not {[float(x) for x in values]}")


def _write(
    library: str | Path, name: str, patchwork: Patchwork, pieces: list[Array], texture_seed: int, mass: float
) -> Path:
    mesh = patchwork.mesh
    solid = solid_of(weld(mesh.vertices[mesh.faces]))
    colour = patches(patchwork.texels.reshape(-1, 3), texture_seed).reshape(patchwork.texels.shape)
    moved = Mesh(mesh.vertices - solid.centre, mesh.normals, mesh.uv, mesh.faces)
    new = NewAsset(
        name=name,
        mesh=moved,
        texture=np.round(colour * 255).astype(np.uint8),
        solid=type(solid)(solid.volume, np.zeros(3), solid.second, solid.by),
        mass=mass,
        pieces=tuple(piece - solid.centre for piece in pieces),
        origin=solid.centre,
        unit="m",
        source="procedural_hollow",
    )
    return write_asset(new, library, replace=True)
