"""Objects whose whole shape is known: an asset of a library, or a mesh; as triangles, and as a cloud on them."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from twin_diagram.assets.asset import Asset
from twin_diagram.assets.building.from_mesh import UNITS, check_size, check_told
from twin_diagram.assets.building.inertia import solid_of
from twin_diagram.assets.building.source_mesh import read_source, z_up
from twin_diagram.assets.building.surface import weld
from twin_diagram.assets.description import read_spec
from twin_diagram.assets.mesh import read_obj
from twin_diagram.errors import AssetError
from twin_diagram.planning.grasps.target import GraspTarget, target_of
from twin_diagram.planning.grasps.triangles import surface_cloud
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    cloud_points: int = 3000
    """Points of the cloud: 6 mm apart on a cracker box, and what the search looks at in the time that it has."""


TUNING = Tuning()


@dataclass(frozen=True)
class KnownObject:
    """An object's surface in O: an asset's frame, or a mesh's own, z upwards.

    Attributes:
        name: of the asset or the mesh's file.
        triangles: (F, 3, 3) corners, counter-clockwise from outside [m].
        mass: [kg]; None: not known.
        centre: (3,) centre of mass [m]; None: not known.
        folder: of the asset; None: a mesh.
        digest: of the files that all this is from.
    """

    name: str
    triangles: Array
    mass: float | None
    centre: Array | None
    folder: Path | None
    digest: str

    def target(self, seed: int = 0, table: bool = False) -> GraspTarget:
        """Return it as the search sees it.

        Args:
            seed: of the cloud.
            table: whether it stands on one, as O has it upright.

        Raises:
            GraspError: a mass that cannot be.
        """
        points, normals = surface_cloud(self.triangles, TUNING.cloud_points, seed)
        plane = np.array([0.0, 0.0, 1.0, self.triangles[:, :, 2].min()]) if table else None
        return target_of(points, normals, table=plane, mass=self.mass, centre=self.centre)


def read_known(source: str | Path, unit: str = "m", mass: float | None = None) -> KnownObject:
    """Read an asset's folder or a mesh's file.

    Args:
        source: a folder with an asset.yaml, or the name of one that comes along (``objects/mug``); .obj, .stl, .ply (z
            upwards), .glb or .gltf (y upwards, turned), .dae.
        unit: of a mesh: m, cm, mm or in.
        mass: [kg], in place of an asset's own.

    Raises:
        AssetError: it cannot be read, is empty, not finite, or of a size that says that the unit is another one.
    """
    path = Path(source)
    if not path.exists() and (models_dir() / path / "asset.yaml").is_file():
        path = models_dir() / path
    check_told(mass, None, unit)
    if path.is_dir():
        if unit != "m":
            raise AssetError(f"--unit {unit}: is of a mesh; the asset {path} is in m")
        return _asset(path, mass)
    corners = np.concatenate([part.corners for part in read_source(path, looks=False).parts]) * UNITS[unit]
    if path.suffix.lower() in (".glb", ".gltf"):
        corners = z_up(corners)
    check_size(path, corners, unit)
    surface = weld(corners)
    if not len(surface.faces):
        raise AssetError(f"{path}: the mesh has no faces (triangles) with an area")
    triangles = surface.vertices[surface.faces]
    centre = solid_of(surface).centre if mass is not None else None
    # What a glTF names lies in other files: of what was read, not of one file.
    digest = hashlib.sha256(np.ascontiguousarray(triangles).tobytes()).hexdigest()
    return KnownObject(path.stem, triangles, mass, centre, None, digest)


def _asset(folder: Path, mass: float | None) -> KnownObject:
    asset = Asset.load(folder)
    mesh = read_obj(folder / read_spec(folder).visual)
    # The model's figures are what the twin plans and simulates with.
    files = [folder / name for name in ("asset.yaml", "model.sdf", read_spec(folder).visual)]
    digest = hashlib.sha256()
    for file in files:
        digest.update(hashlib.sha256(file.read_bytes() if file.is_file() else b"").digest())
    return KnownObject(
        asset.name,
        mesh.vertices[mesh.faces],
        asset.mass if mass is None else mass,
        _centre_of_mass(asset.model_file),
        folder,
        digest.hexdigest(),
    )


def _centre_of_mass(model: Path) -> Array:
    """Return where a model says that the mass is (3,) [m]; O's origin where it says nothing."""
    try:
        pose = ElementTree.parse(model).findtext("./model/link[@name='object']/inertial/pose", "")
        place = np.array([float(word) for word in pose.split()[:3]])
    except (OSError, ValueError, ElementTree.ParseError) as error:
        raise AssetError(f"{model}: cannot be read ({error})") from None
    return place if place.shape == (3,) and np.isfinite(place).all() else np.zeros(3)
