"""The library, a folder of assets: what is in it, whether it is whole, and taking something out."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from pydrake.multibody.plant import MultibodyPlant

from twin_diagram.assets.asset import Asset
from twin_diagram.assets.building.write_asset import NAME, own_files
from twin_diagram.assets.description import AssetSpec, read_spec
from twin_diagram.assets.mesh import read_obj, read_png
from twin_diagram.assets.model_check import add_model
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class LibraryEntry:
    """One asset of a library.

    Attributes:
        name: of its folder.
        asset: None where it is corrupt.
        extent: (3,) edges of the box that holds its surface [m]; None as well.
        wrong: what is wrong with it, if anything.
    """

    name: str
    asset: Asset | None
    extent: Array | None
    wrong: str | None


def entries(library: str | Path) -> list[LibraryEntry]:
    """Return a library's assets by name, each looked at.

    Hidden folders, which somebody may be writing, and such without `asset.yaml` are none.

    Raises:
        AssetError: no such folder.
    """
    folder = _folder(library)
    names = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
    return [_entry(folder / name) for name in names if (folder / name / "asset.yaml").is_file()]


def entry(library: str | Path, name: str) -> LibraryEntry:
    """Return one of a library's assets, looked at.

    Raises:
        AssetError: there is none of that name.
    """
    return _entry(_asset_folder(library, name))


def check(folder: Path) -> tuple[Asset, Array]:
    """Return an asset of which every file was read and compared with the others, and its surface's extent (3,) [m].

    Raises:
        AssetError: what is wrong.
    """
    spec = read_spec(folder)
    if spec.files is not None:
        unlisted = [name for name in ["model.sdf", spec.visual, *(spec.pieces or [])] if name not in spec.files]
        if unlisted:
            lacks = f"its list of files lacks {unlisted[0]}: cut off, or edited; build the asset anew"
            raise AssetError(f"{folder / 'asset.yaml'}: {lacks}")
    for name, digest in (spec.files or {}).items():
        file = folder / name
        if not (folder / name).resolve().is_relative_to(folder.resolve()) or not file.is_file():
            raise AssetError(f"{file}: missing")
        if hashlib.sha256(file.read_bytes()).hexdigest() != digest:
            raise AssetError(f"{file}: is not as it was written: damaged, or edited; build the asset anew")
    asset = Asset.load(folder)
    visual = folder / spec.visual
    extent = np.ptp(read_obj(visual).vertices, axis=0)
    read_png(visual.with_suffix(".png"))
    _check_told(spec, folder / "asset.yaml")
    _check_model(spec, asset)
    return asset, extent


def remove(library: str | Path, name: str) -> list[str]:
    """Take an asset out of a library; returns what is left in its folder, because it is not the asset's.

    Raises:
        AssetError: there is none of that name.
    """
    folder = _asset_folder(library, name)
    own = own_files(folder)
    # First what makes it an asset: half removed, it is none.
    for path in sorted(own, key=lambda path: path != "asset.yaml"):
        (folder / path).unlink()
    for inner in (folder / "pieces", folder / "grasps"):
        if inner.is_dir() and not any(inner.iterdir()):
            inner.rmdir()
    left = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir())
    if not any(folder.iterdir()):
        folder.rmdir()
    return left


def _check_told(spec: AssetSpec, file: Path) -> None:
    """Refuse what a description tells beside shape and mass where it cannot be."""
    counts = {"origin": 3, "inertia": 6, "centre_std": 3, "inertia_std": 6, "mass_std": 1, "volume": 1, "volume_std": 1}
    for name, count in counts.items():
        told = getattr(spec, name)
        values = np.atleast_1d(np.array([] if told is None else told, dtype=float))
        if told is not None and not (len(values) == count and np.isfinite(values).all()):
            raise AssetError(f"{file}: {name} must be {count} finite number(s), not {told}")
        if told is not None and name not in ("origin", "inertia") and (values < 0).any():
            raise AssetError(f"{file}: {name} is negative: {told}")
    if spec.unseen is not None and not 0.0 <= spec.unseen <= 1.0:
        raise AssetError(f"{file}: unseen is a share from 0 to 1, not {spec.unseen}")
    if spec.obj_id is not None and spec.obj_id < 0:
        raise AssetError(f"{file}: obj_id is negative: {spec.obj_id}")


def _check_model(spec: AssetSpec, asset: Asset) -> None:
    """Refuse a model that is not one free body with the asset's mass and an inertia that can be."""
    plant = MultibodyPlant(0.0)
    try:
        (instance,) = add_model(plant, asset.model_file)
        body = plant.GetBodyByName("object", instance)
        plant.Finalize()
    except (RuntimeError, ValueError) as error:
        raise AssetError(f"{asset.model_file}: {str(error).strip().splitlines()[0]}") from None
    links = [plant.get_body(index).name() for index in plant.GetBodyIndices(instance)]
    if len(links) > 1:
        raise AssetError(f"{asset.model_file}: an object is one link, these are {len(links)}: {', '.join(links)}")
    if not np.isclose(body.default_mass(), spec.mass, rtol=1e-6):
        raise AssetError(f"{asset.model_file}: has a mass of {body.default_mass():g} kg, asset.yaml of {spec.mass:g}")
    told = _told_inertia(asset.model_file)
    if told is None:
        return
    moments = np.linalg.eigvalsh(told[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]])
    if not (moments[0] > 0 and moments[0] + moments[1] >= moments[2] * (1 - 1e-6)):
        raise AssetError(f"{asset.model_file}: its principal moments {moments} kg·m² are those of no body")
    if spec.inertia is not None and not np.allclose(told, spec.inertia, rtol=0.0, atol=1e-6 * moments[2]):
        raise AssetError(f"{asset.model_file}: has an inertia of {told} kg·m², asset.yaml of {spec.inertia}")


def _told_inertia(model: Path) -> Array | None:
    """Return what a model says (6,), in the order of `SIX` [kg·m²]; Drake takes another where that cannot be."""
    inertia = ElementTree.parse(model).find("./model/link[@name='object']/inertial/inertia")
    if inertia is None:
        return None
    return np.array([float(inertia.findtext(f"i{axes}", "0")) for axes in "xx yy zz xy xz yz".split()])


def _entry(folder: Path) -> LibraryEntry:
    try:
        return LibraryEntry(folder.name, *check(folder), None)
    except (AssetError, OSError) as error:
        return LibraryEntry(folder.name, None, None, " ".join(str(error).split()))


def _folder(library: str | Path) -> Path:
    folder = Path(library)
    if not folder.is_dir():
        raise AssetError(f"--library {library}: no such folder")
    return folder


def _asset_folder(library: str | Path, name: str) -> Path:
    folder = _folder(library) / name
    if not NAME.fullmatch(name):
        raise AssetError(f"{name!r} is not an asset's name, which is letters, digits, '_' and '-'")
    if folder.is_symlink():
        raise AssetError(f"{folder}: is a link to an asset elsewhere; name the library that it lies in")
    if not (folder / "asset.yaml").is_file():
        raise AssetError(f"--library {library}: has no asset {name!r}")
    return folder
