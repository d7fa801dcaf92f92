"""Writes an asset into a library: aside, in a hidden folder, read back as the twin reads it, and then renamed."""

from __future__ import annotations

import hashlib
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common.yaml import yaml_dump_typed
from pydrake.multibody.plant import MultibodyPlant
from scipy.spatial import HalfspaceIntersection, QhullError

from twin_diagram.assets import symmetry
from twin_diagram.assets.asset import TUNING as ASSET
from twin_diagram.assets.asset import Asset
from twin_diagram.assets.building.flat_faces import flat_faces, flattened
from twin_diagram.assets.building.inertia import EvenBody, hull_of, outward
from twin_diagram.assets.building.measured import SIX, MeasuredInertia
from twin_diagram.assets.building.overlap import in_view
from twin_diagram.assets.building.shape_errors import ShapeErrors
from twin_diagram.assets.description import TUNING as SDF
from twin_diagram.assets.description import VERSION, AssetSpec, ConvexFile, sdf
from twin_diagram.assets.mesh import Image, Mesh, write_obj
from twin_diagram.assets.mjcf import mjcf
from twin_diagram.assets.model_check import add_model
from twin_diagram.errors import AssetError
from twin_diagram.runtime import atomic_file, written_files
from twin_diagram.runtime.output_place import why_not
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    feet: int = 24
    """Small spheres on which an object stands, at the most: a round rim keeps eight or so of them."""


TUNING = Tuning()

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
"""An asset's name: names a folder on any disk, and nothing but a folder; SDF and scenarios take it as it is."""


@dataclass(frozen=True)
class NewAsset:
    """What an asset is written from; lengths in m, in O: z upwards, the origin at the centre of mass.

    Attributes:
        name: of the asset and its folder.
        mesh: its surface.
        texture: the picture of it.
        solid: volume and moments.
        mass: [kg]
        pieces: vertices of convex pieces.
        origin: (3,) where O lies in the source [m].
        unit: of the source.
        source: the source's name, without a path.
        unseen: share of the surface that was never seen; None where that is not known.
        measured: its inertia in O, whose origin is its centre; None: that of an even body.
        errors: of volume, centre and moments by its shape; None: not known.
        mass_told: whether the mass was told, not a density.
        blank: a picture as the texture is one, white where no picture showed the surface; None: nowhere.
    """

    name: str
    mesh: Mesh
    texture: Image
    solid: EvenBody
    mass: float
    pieces: tuple[Array, ...]
    origin: Array
    unit: str
    source: str
    unseen: float | None = None
    measured: MeasuredInertia | None = None
    errors: ShapeErrors | None = None
    mass_told: bool = False
    blank: Image | None = None


def place_for(name: str, library: str | Path, replace: bool) -> Path:
    """Return the folder that an asset of that name would have, tried before anything is computed for it.

    Raises:
        AssetError: the name is none, exists without `replace`, or nothing can be written there.
    """
    if not NAME.fullmatch(name):
        raise AssetError(f"--name {name!r}: an asset's name is letters, digits, '_' and '-', at most 64, and no path")
    folder = Path(library) / name
    if folder.is_symlink() or (folder.exists() and not (folder / "asset.yaml").is_file()):
        raise AssetError(f"--name {name!r}: {folder} is something else than an asset; choose another name")
    if folder.exists() and not replace:
        raise AssetError(f"--name {name!r}: {library} has an asset of this name; --replace writes it anew")
    if why := why_not(folder, folder=True):
        raise AssetError(f"--library {library}: {why}")
    return folder


def write_asset(new: NewAsset, library: str | Path, replace: bool = False) -> Path:
    """Write an asset, whole or not at all. Returns its folder.

    What an asset that is replaced has beside its own files stays.

    Raises:
        AssetError: as of `place_for`; or what was written cannot be read back.
    """
    folder = place_for(new.name, library, replace)
    with atomic_file.folder(folder) as aside:
        _write_files(new, aside)
        _read_back(aside, new.name)
        if folder.exists():
            for path in kept_files(folder):
                if not (aside / path).exists():
                    (aside / path).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy2(folder / path, aside / path, follow_symlinks=False)
    return folder


def own_files(folder: Path) -> set[str]:
    """Return the files of a folder that belong to the asset, as paths below it."""
    usual = {"asset.yaml", "model.sdf", "cloud.npz", "visual.obj", "visual.mtl", "visual.png", "model.xml"}
    every = list(written_files.files_of(folder))
    made = re.compile(r"pieces/piece\d+\.obj|grasps/[A-Za-z0-9_-]+\.json")
    return {path for path in every if path in usual or made.fullmatch(path)}


def kept_files(folder: Path) -> list[str]:
    """Return the files of a folder that somebody else put there."""
    own = own_files(folder)
    return [path for path in written_files.files_of(folder) if path not in own]


def _write_files(new: NewAsset, folder: Path) -> None:
    write_obj(new.mesh, folder / "visual.obj", new.texture)
    cloud = in_view(new.mesh, new.texture, ASSET.cloud_points)
    arrays: dict[str, Any] = {
        "points": cloud.points.astype(np.float32),
        "normals": cloud.normals.astype(np.float32),
        "colours": cloud.colours.astype(np.float32),
    }
    if new.blank is not None and new.blank.any():
        # The same points again: they are drawn alike.
        arrays["unpainted"] = in_view(new.mesh, new.blank, ASSET.cloud_points).colours[:, 0] > 0.5
    np.savez(folder / "cloud.npz", **arrays)
    inertia = new.solid.inertia(new.mass) if new.measured is None else new.measured.inertia
    reach = np.abs(new.mesh.vertices).max(axis=0)
    symmetries = symmetry.proposed(cloud.points, cloud.normals, cloud.colours, arrays.get("unpainted"))
    spec = AssetSpec(
        name=new.name,
        shape="mesh",
        size=[float(x) for x in 2 * reach],
        mass=new.mass,
        version=VERSION,
        origin=[float(x) for x in new.origin],
        inertia=[float(inertia[i, j]) for i, j in SIX],
        volume=new.solid.volume,
        volume_by=new.solid.by,
        symmetric_axis="z" if f"z {symmetry.ANY}" in symmetries else None,
        symmetries=list(symmetries),
        unit=new.unit,
        source=new.source,
        unseen=new.unseen,
    )
    if new.errors is not None:
        _tell_errors_of_shape(spec, new, new.errors)
    if new.measured is not None:
        _tell_errors(spec, new.measured)
    write_models(folder, spec, new.pieces, new.mesh.vertices, flat_faces(new.mesh.vertices[new.mesh.faces]))
    spec.files = {
        path: hashlib.sha256((folder / path).read_bytes()).hexdigest() for path in written_files.files_of(folder)
    }
    (folder / "asset.yaml").write_text(yaml_dump_typed(spec))


def write_models(folder: Path, spec: AssetSpec, pieces: Sequence[Array], vertices: Array, flat: Array) -> None:
    """Write an asset's pieces and the models that are made of them, and name the pieces in its description.

    Args:
        folder: of the asset; has no pieces.
        spec: with mass and inertia.
        pieces: vertices (m, 3) of each [m].
        vertices: (V, 3) of its surface [m].
        flat: (k, 4) planes of its flat faces; no piece stands out of them.
    """
    (folder / "pieces").mkdir()
    files = [ConvexFile(f"pieces/piece{k}.obj", flattened(piece, flat)) for k, piece in enumerate(pieces)]
    for file in files:
        (folder / file.name).write_text(_obj_of(file.vertices))
    spec.pieces = [file.name for file in files]
    inertia = np.array(spec.inertia)[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
    (folder / "model.xml").write_text(mjcf(spec, np.zeros(3), inertia, spec.pieces))
    (folder / "model.sdf").write_text(sdf(spec, np.zeros(3), inertia, pieces=files, feet_O=feet(vertices, flat)))


def _tell_errors_of_shape(spec: AssetSpec, new: NewAsset, errors: ShapeErrors) -> None:
    """Put into a description how well an even body's numbers are known by its shape."""
    spec.volume_std = errors.volume_std
    if new.measured is None:
        if not new.mass_told:
            spec.mass_std = new.mass / new.solid.volume * errors.volume_std
        spec.centre_std = [float(x) for x in errors.centre_std(new.solid.volume)]
        spec.inertia_std = [float(x) for x in errors.inertia_std(new.solid, new.mass, new.mass_told)]


def _tell_errors(spec: AssetSpec, measured: MeasuredInertia) -> None:
    """Put into a description how well its inertia is known; what is not known at all is left out."""
    if np.isfinite(measured.mass_std):
        spec.mass_std = float(measured.mass_std)
    if np.isfinite(measured.centre_std).all():
        spec.centre_std = [float(x) for x in measured.centre_std]
    if np.isfinite(measured.inertia_std).all():
        spec.inertia_std = [float(x) for x in measured.inertia_std]
    spec.inertial_by = dict(measured.by)


def _obj_of(vertices: Array) -> str:
    """Return a convex piece as an OBJ file."""
    hull = hull_of(vertices)
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*row) for row in hull.points]
    lines += ["f {} {} {}".format(*row) for row in outward(hull) + 1]
    return "\n".join(lines) + "\n"


def feet(vertices: Array, flat: Array | None = None) -> Array:
    """Return centres (k, 3) of the spheres on which the hull of vertices (V, 3) stands, far from one another.

    They touch three faces of the hull each, from inside; of flat faces that were found (f, 4), n·p + d = 0, each has
    its share of them, in one plane and far apart. None where the object is too thin to have them.
    """
    hull = hull_of(vertices)
    flat = np.empty((0, 4)) if flat is None else flat
    planes = np.unique(np.round(np.concatenate([hull.equations, flat]), 9), axis=0)
    planes[:, 3] += SDF.foot
    try:
        corners = HalfspaceIntersection(planes, vertices[hull.vertices].mean(axis=0)).intersections
    except (QhullError, ValueError):
        return np.empty((0, 3))
    corners = np.unique(np.round(corners[np.isfinite(corners).all(axis=1)], 7), axis=0)
    on = np.abs(corners @ flat[:, :3].T + flat[:, 3] + SDF.foot) < 1e-6
    groups = [np.flatnonzero(face) for face in [*on.T, np.ones(len(corners), bool)]]
    away = [np.full(len(own), np.inf) for own in groups]  # of each corner of a face from those of it that were chosen
    chosen = np.zeros(len(corners), bool)
    for k in [*range(len(groups))] * TUNING.feet:
        own, left = groups[k], ~chosen[groups[k]]
        if chosen.sum() < min(TUNING.feet, len(corners)) and left.any():
            # The first one is farthest from the middle, each other one from all that the face has.
            face = corners[own]
            far = np.linalg.norm(face - face.mean(axis=0), axis=1) if left.all() else away[k]
            new = own[left][far[left].argmax()]
            chosen[new] = True
            step = np.linalg.norm(corners - corners[new], axis=1)
            for group, distance in zip(groups, away, strict=True):
                if new in group:
                    np.minimum(distance, step[group], out=distance)
    return np.asarray(corners[chosen])


def _read_back(folder: Path, name: str) -> None:
    """Read an asset as the twin and its plant do.

    Raises:
        AssetError: it cannot be.
    """
    Asset.load(folder)
    plant = MultibodyPlant(0.0)
    try:
        add_model(plant, folder / "model.sdf")
        plant.Finalize()
    except RuntimeError as error:
        raise AssetError(f"{name}: what was made of it is no model ({str(error).splitlines()[0]})") from None
