"""From a mesh to an asset.

Example:
    >>> from twin_diagram.assets.building import build_from_mesh
    >>> build_from_mesh("mug.glb", "mug", "my_objects", mass=0.3).folder  # doctest: +SKIP
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeVar

import numpy as np

from twin_diagram.assets.building.inertia import EvenBody, Hollow, enclosed, less, solid_of
from twin_diagram.assets.building.measured import MeasuredInertia
from twin_diagram.assets.building.one_texture import one_texture
from twin_diagram.assets.building.pieces import Pieces, pieces_of
from twin_diagram.assets.building.shape_errors import ShapeErrors
from twin_diagram.assets.building.source_mesh import read_source, z_up
from twin_diagram.assets.building.surface import Surface, outer_faces, weld, with_normals
from twin_diagram.assets.building.write_asset import NewAsset, place_for, write_asset
from twin_diagram.assets.description import read_spec
from twin_diagram.assets.mesh import Image
from twin_diagram.errors import AssetError
from twin_diagram.runtime.threads import one_thread
from twin_diagram.signals.arrays import Array

Made = TypeVar("Made")

UNITS: Final[dict[str, float]] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
"""Units of a mesh [m]."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    largest: float = 2.0
    """Longest edge of an object's box [m]; what is larger has another unit, or is no object on a table."""

    smallest: float = 0.005
    """The same at the least [m]; a depth camera does not see it."""

    density: float = 1000.0
    """Where neither mass nor density is told [kg/m³]: water's."""

    slow: int = 100_000
    """Triangles from which it is told that they are read: what comes then takes seconds."""

    densest: float = 22_600.0
    """Osmium's [kg/m³]: above it, something was told in another unit."""


TUNING = Tuning()


@dataclass(frozen=True)
class BuiltAsset:
    """What was built: its `folder`, `mass` [kg], `volume` [m³], `size` (3,) of its box [m], and `notes` for people."""

    folder: Path
    mass: float
    volume: float
    size: Array
    notes: tuple[str, ...]


@one_thread()
def build_from_mesh(
    mesh: str | Path,
    name: str,
    library: str | Path,
    mass: float | None = None,
    density: float | None = None,
    unit: str = "m",
    replace_it: bool = False,
    root: str | Path | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> BuiltAsset:
    """Make an asset of a mesh and put it into a library.

    glTF, whose y axis is up, is turned; other meshes are taken to stand as they are, z upwards.

    Args:
        mesh: .obj, .stl, .ply, .glb, .gltf or .dae, which tells unit and upward axis itself.
        name: of the asset: letters, digits, `_`, `-`.
        library: the folder of assets; made where there is none.
        mass: [kg]
        density: [kg/m³]; without either: water's.
        unit: of the mesh: m, cm, mm, in.
        replace_it: write an asset of that name anew.
        root: the folder within which the mesh may name files, such as holds `meshes/` and `textures/`; None: its own.
        say: is told of each step.

    Raises:
        AssetError: anything that cannot be used; nothing is written.
    """
    path = Path(mesh)
    check_told(mass, density, unit)
    place_for(name, library, replace_it)
    if root is not None and not Path(root).is_dir():
        raise AssetError(f"--root {root}: no such folder")
    source = read_source(path, root=None if root is None else Path(root))
    corners = np.concatenate([part.corners for part in source.parts]) * UNITS[unit]
    if path.suffix.lower() in (".glb", ".gltf"):
        corners = z_up(corners)
    check_size(path, corners, unit)
    if len(corners) > TUNING.slow:
        say(f"{path.name}: {len(corners)} triangles read")
    uv, texture = _named(path, lambda: one_texture(source.parts))
    told = AssetPlace(name, library, mass, density, replace_it)
    return _named(
        path,
        lambda: build_from_triangles(corners, uv, texture, told, path.name, unit, notes=source.notes, say=say),
    )


@dataclass(frozen=True)
class AssetPlace:
    """What is told of an asset to be.

    Its `name` and `library`, its `mass` [kg] or `density` [kg/m³], whether one there goes, and what was measured of its
    inertia in the frame of its triangles: then O is at the centre that was measured.
    """

    name: str
    library: str | Path
    mass: float | None = None
    density: float | None = None
    replace_it: bool = False
    measured: MeasuredInertia | None = None


def build_from_triangles(
    corners: Array,
    uv: Array,
    texture: Image,
    told: AssetPlace,
    source: str,
    unit: str = "m",
    unseen: float | None = None,
    notes: Sequence[str] = (),
    errors: ShapeErrors | None = None,
    hollow: Hollow | None = None,
    blank: Image | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> BuiltAsset:
    """Make an asset of triangles: weld, weigh, take apart, write.

    Args:
        corners: (F, 3, 3), z upwards [m].
        uv: (F, 3, 2), v upwards.
        texture: RGB.
        told: what else is told of it.
        source: its name, without a path.
        unit: of the source.
        unseen: share of the surface that was never seen, where that is known.
        notes: for people.
        errors: of volume, centre and moments by its shape, where they are known.
        hollow: what within the triangles may be empty: volume, centre and moments are those of the mean.
        blank: as the texture, white where no picture showed the surface: colours are made up there; None: nowhere.
        say: is told of each step.

    Raises:
        AssetError: triangles without an area; or as of `write_asset`.
    """
    surface = _welded(corners)
    within, solid = _solids(surface, hollow)
    centre = solid.centre if told.measured is None else np.asarray(told.measured.centre)
    surface = replace(surface, vertices=surface.vertices - centre)
    say(f"{len(surface.vertices)} vertices, {solid.volume * 1e6:.4g} cm³; looking for convex pieces that hold it")
    pieces = _pieces(surface, within)
    say("writing it and reading it back")
    said = [*notes, *_volume_notes(surface, within), f"held by {pieces.how}"]
    mass = _mass(told, solid, said)
    new = NewAsset(
        name=told.name,
        mesh=with_normals(surface, surface.of_corners(uv)),
        texture=texture,
        solid=replace(solid, centre=solid.centre - centre),
        mass=mass,
        pieces=pieces.vertices,
        origin=centre,
        unit=unit,
        source=source,
        unseen=unseen,
        errors=errors,
        mass_told=told.mass is not None,
        measured=None if told.measured is None else replace(told.measured, centre=np.zeros(3)),
        blank=blank,
    )
    folder = write_asset(new, told.library, told.replace_it)
    return BuiltAsset(folder, mass, solid.volume, np.ptp(surface.vertices, axis=0), (*said, *_symmetry_notes(folder)))


def _welded(corners: Array) -> Surface:
    """Return triangles (F, 3, 3) welded; refuse such of which none has an area."""
    surface = weld(corners)
    if not len(surface.faces):
        raise AssetError("the mesh has no faces (triangles) with an area")
    return surface


def _solids(surface: Surface, hollow: Hollow | None) -> tuple[EvenBody, EvenBody]:
    """Return the body within a surface, full, and what of it is there once what may be empty counts by its chance."""
    full = solid_of(surface)
    return full, full if hollow is None else less(full, hollow)


def _pieces(surface: Surface, solid: EvenBody) -> Pieces:
    """Return convex pieces of a surface; cavities that are closed count as full, for nothing can meet their walls."""
    faces, volume = surface.faces, solid.volume
    if surface.closed and len(outer := outer_faces(surface)) < len(faces):
        faces, volume = outer, enclosed(surface.vertices, outer, "surface").volume
    return pieces_of(surface.vertices, faces, volume)


def _mass(told: AssetPlace, solid: EvenBody, said: list[str]) -> float:
    """Return the mass that was measured or told, or that of a density [kg]; notes on it are added to what is `said`."""
    mass = told.mass if told.measured is None else told.measured.mass
    if mass is None:
        mass = (told.density or TUNING.density) * solid.volume
        if told.density is None:
            said.append(f"mass not told: {mass:.4g} kg, as if of water; --mass or --density say better")
    elif mass > TUNING.densest * solid.volume:
        said.append(f"--mass {mass:g} kg in {solid.volume * 1e6:.4g} cm³ is denser than any metal; is it in grams?")
    return float(mass)


def _named(path: Path, make: Callable[[], Made]) -> Made:
    """Run `make`; what is wrong is said with the file's name."""
    try:
        return make()
    except AssetError as error:
        raise AssetError(f"{path}: {error}") from None


def check_told(mass: float | None, density: float | None, unit: str) -> None:
    """Refuse a mass, density or unit that is none."""
    if mass is not None and density is not None:
        raise AssetError(f"--mass {mass:g} and --density {density:g}: tell one of them")
    for option, value, of in (("--mass", mass, "kg"), ("--density", density, "kg/m³")):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise AssetError(f"{option} {value:g}: must be positive [{of}]")
    if unit not in UNITS:
        raise AssetError(f"--unit {unit!r}: no such unit; these are: {', '.join(UNITS)}")


def check_size(path: Path, corners: Array, unit: str) -> None:
    """Refuse what is too large or too small for an object, and say in which unit it would not be."""
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    if TUNING.smallest <= size <= TUNING.largest:
        return
    wrong = f"over {TUNING.largest:g} m" if size > TUNING.largest else f"under {TUNING.smallest * 1e3:g} mm"
    sizes = {other: size / UNITS[unit] * scale for other, scale in UNITS.items()}
    fitting = [
        f"--unit {other} it would be {x * 1e3:.4g} mm" if x < 1 else f"--unit {other} it would be {x:.4g} m"
        for other, x in sizes.items()
        if TUNING.smallest <= x <= TUNING.largest
    ]
    advice = f"with {', with '.join(fitting)}" if fitting else f"no unit of {', '.join(UNITS)} fits"
    raise AssetError(f"{path}: the object is {size:.4g} m long in {unit}, {wrong}; {advice}")


def _volume_notes(surface: Surface, solid: EvenBody) -> list[str]:
    if solid.by == "surface":
        return []
    how = "its convex hull" if solid.by == "hull" else "filling it, small holes closed"
    why = "bodies in it overlap" if surface.closed else "not watertight"
    return [f"{why}: volume {solid.volume * 1e6:.4g} cm³, centre and inertia are by {how}"]


def _symmetry_notes(folder: Path) -> list[str]:
    symmetries = read_spec(folder).symmetries
    return [f"looks the same turned: {', '.join(symmetries)} (asset.yaml: symmetries)"] if symmetries else []
