"""Descriptions of an object: its file `asset.yaml` and the SDF model that Drake simulates and shows."""

# No `from __future__ import annotations` here: Drake's YAML functions read the fields' types themselves, not strings.

import copy
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
import yaml
from pydrake.common.yaml import yaml_load_typed

from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array

VERSION = 1
"""Of `asset.yaml`, as `twin-diagram assets build` writes it."""


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand: small beside objects, large beside what contact penetrates."""

    foot: float = 0.002
    """Radius of the small spheres on which an object stands [m]."""

    recess: float = 0.0005
    """How far the solid shapes stay behind the feet, so that the feet alone carry the object on a plane [m]."""


TUNING = Tuning()


@dataclass
class CollisionShape:
    """One collision shape: a box (three edge lengths) or a cylinder about its z axis (radius, length)."""

    kind: str = "box"
    size: list[float] = field(default_factory=list)
    translation: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    rpy: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])


@dataclass
class AssetSpec:
    """What `asset.yaml` holds."""

    name: str = ""
    shape: str = ""
    """Which procedure made it; free text for anything else."""
    size: list[float] = field(default_factory=list)
    """Edge lengths of the box about O that holds the object [m]."""
    mass: float = 0.0
    symmetric_axis: str | None = None
    """`z` where turning about that axis is not to be told apart."""
    texture_seed: int = 0
    visual: str = "visual.obj"
    solids: list[CollisionShape] = field(default_factory=list)
    """Convex pieces that together hold the object; or else `pieces`."""

    pieces: list[str] | None = None
    """Files (OBJ) of convex pieces that together hold the object."""
    version: int | None = None
    """Of this file's layout; None where it was written by hand."""
    origin: list[float] | None = None
    """Where O, the centre of mass, lies in what the asset was made from, z upwards [m]."""
    inertia: list[float] | None = None
    """Moments about O, its axes: xx, yy, zz, xy, xz, yz [kg·m²]."""
    mass_std: float | None = None
    """Standard error of the mass, where it was measured, or is a density times a volume that pictures show [kg]."""
    centre_std: list[float] | None = None
    """Standard errors of where O, the centre of mass, is [m]; by the shape alone: of that of an even body, …"""
    inertia_std: list[float] | None = None
    """Standard errors of `inertia`, in its order [kg·m²]; … likewise."""
    inertial_by: dict[str, str] | None = None
    """Where `mass`, `centre` and `inertia` are from: `measured`, `partly` or `from shape alone`."""
    volume: float | None = None
    """[m³]; of pictures, what no view looks into counts by the chance that it is full, within the mesh it is so."""
    volume_std: float | None = None
    """Its standard error, where it was built from pictures [m³]."""
    volume_by: str | None = None
    """What volume and inertia were computed from: `surface`, `filling` (of an open one, or of bodies that
    overlap) or `hull`."""
    symmetries: list[str] | None = None
    """Turns that are not to be told apart: `z 4` is a quarter turn about z, `x any` every turn about x."""
    obj_id: int | None = None
    """Its number in results of the BOP layout; None: its place in the library, from 1."""
    unit: str | None = None
    """Of what the asset was made from."""
    source: str | None = None
    """Name of the file that it was made from."""
    unseen: float | None = None
    """Share of the surface that no picture showed, where it was built from pictures."""
    files: dict[str, str] | None = None
    """SHA-256 of the other files; `twin-diagram assets check` compares them."""


def read_spec(folder: Path) -> AssetSpec:
    """Read the `asset.yaml` of an asset's folder.

    Raises:
        AssetError: missing or malformed.
    """
    file = folder / "asset.yaml"
    if not file.is_file():
        raise AssetError(f"{folder}: not an asset, it has no asset.yaml")
    try:
        spec = _spec_at(file)
    except Exception as error:  # of YAML, of types, of Unicode
        raise AssetError(f"{file}: {_odd_field(file)}{error}") from None
    if spec.version not in (None, VERSION):
        raise AssetError(f"{file}: version {spec.version} is not known here, only {VERSION}")
    return spec


def _spec_at(file: Path) -> AssetSpec:
    with suppress(Exception):  # whatever it is, it is said below of the file
        return copy.deepcopy(_spec_of(file.read_bytes()))
    spec: AssetSpec = yaml_load_typed(schema=AssetSpec, filename=str(file))
    return spec


@lru_cache(maxsize=64)  # a run asks of each of its objects some ten times
def _spec_of(content: bytes) -> AssetSpec:
    spec: AssetSpec = yaml_load_typed(schema=AssetSpec, data=content.decode())
    return spec


def _odd_field(file: Path) -> str:
    """Return the field of a malformed description that cannot be read, with a colon; nothing where that is not one."""
    try:
        fields = dict(yaml.safe_load(file.read_text()))
    except (yaml.YAMLError, ValueError, TypeError):
        return ""
    for name, value in fields.items():
        try:
            yaml_load_typed(schema=AssetSpec, data=yaml.safe_dump({name: value}))
        except Exception:  # whatever it is, it is that of the whole file
            return f"{name}: "
    return ""


def solid_inertia(spec: AssetSpec) -> Array:
    """Return (3, 3) moments about its centre of a full box, or else a full upright cylinder, of even density."""
    x, y, z = spec.size
    m = spec.mass
    if spec.shape == "box":
        return np.diag([y * y + z * z, x * x + z * z, x * x + y * y]) * (m / 12)
    r = min(x, y) / 2
    return np.diag([3 * r * r + z * z, 3 * r * r + z * z, 6 * r * r]) * (m / 12)


def feet(solid: CollisionShape) -> Array:
    """Return centres (k, 3) of spheres on which an object stands: corners of a box, eight along a cylinder's rims."""
    if solid.kind == "box":
        half = np.asarray(solid.size) / 2 - TUNING.foot
        return np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).T.reshape(-1, 3) * half
    radius, length = solid.size
    angle = np.arange(8) * np.pi / 4
    ring = np.stack([np.cos(angle) * (radius - TUNING.foot), np.sin(angle) * (radius - TUNING.foot)], axis=1)
    return np.concatenate([np.insert(ring, 2, sign * (length / 2 - TUNING.foot), axis=1) for sign in (-1.0, 1.0)])


@dataclass(frozen=True)
class ConvexFile:
    """A convex piece as a file beside the model: `name`, and `vertices` (m, 3) in O [m]."""

    name: str
    vertices: Array


def _pose(translation: Array | list[float], rpy: list[float] | None = None) -> str:
    numbers = [*translation, *(rpy or [0.0, 0.0, 0.0])]
    return "<pose>" + " ".join(f"{x:.9g}" for x in numbers) + "</pose>"


def _collision(name: str, pose: str, shape: str, friction: float) -> str:
    return (
        f'      <collision name="{name}">{pose}<geometry>{shape}</geometry>\n'
        f"        <drake:proximity_properties><drake:mu_dynamic>{friction:g}</drake:mu_dynamic>"
        f"<drake:mu_static>{friction:g}</drake:mu_static></drake:proximity_properties></collision>\n"
    )


def sdf(
    spec: AssetSpec,
    com: Array,
    inertia: Array,
    friction: float = 0.6,
    pieces: Sequence[ConvexFile] = (),
    feet_O: Array | None = None,
    contact: Sequence[CollisionShape] = (),
) -> str:
    """Return the model as SDF: one free link `object`, frame O, textured visual, convex collision shapes.

    A box on a table has one point of contact in Drake's point contact, and rocks on it. Small spheres in the corners
    of the first solid stand a little proud of it and give the object feet.

    Args:
        spec: its solids are collision shapes.
        com: (3,) centre of mass in O [m].
        inertia: (3, 3) about it [kg·m²].
        friction: of all shapes.
        pieces: further collision shapes.
        feet_O: (k, 3) centres of the feet [m]; None: those of the first solid.
        contact: what is to be met in place of the solids, where those fill hollows.
    """
    i = np.asarray(inertia)
    text = (
        f'<?xml version="1.0"?>\n<sdf xmlns:drake="drake.mit.edu" version="1.9">\n  <model name="{spec.name}">\n'
        f'    <link name="object">\n      <inertial>{_pose(com)}<mass>{spec.mass:.9g}</mass><inertia>'
        f"<ixx>{i[0, 0]:.9g}</ixx><iyy>{i[1, 1]:.9g}</iyy><izz>{i[2, 2]:.9g}</izz>"
        f"<ixy>{i[0, 1]:.9g}</ixy><ixz>{i[0, 2]:.9g}</ixz><iyz>{i[1, 2]:.9g}</iyz></inertia></inertial>\n"
        f'      <visual name="surface"><geometry><mesh><uri>{spec.visual}</uri></mesh></geometry></visual>\n'
    )
    for k, solid in enumerate(contact or spec.solids):
        if solid.kind == "box":
            x, y, z = (edge - 2 * TUNING.recess for edge in solid.size)
            shape = f"<box><size>{x:.9g} {y:.9g} {z:.9g}</size></box>"
        else:
            radius, length = solid.size[0] - TUNING.recess, solid.size[1] - 2 * TUNING.recess
            shape = f"<cylinder><radius>{radius:.9g}</radius><length>{length:.9g}</length></cylinder>"
        text += _collision(f"solid{k}", _pose(solid.translation, solid.rpy), shape, friction)
    for k, piece in enumerate(pieces):
        low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
        scale = np.maximum(1.0 - 2 * TUNING.recess / (high - low), 0.5)
        x, y, z = scale
        # Scaled about its middle, while a mesh is scaled about its file's origin.
        shape = f"<mesh><uri>{piece.name}</uri><scale>{x:.9g} {y:.9g} {z:.9g}</scale><drake:declare_convex/></mesh>"
        text += _collision(f"piece{k}", _pose((1.0 - scale) * (low + high) / 2), shape, friction)
    for k, centre in enumerate(feet(spec.solids[0]) + spec.solids[0].translation if feet_O is None else feet_O):
        shape = f"<sphere><radius>{TUNING.foot:g}</radius></sphere>"
        text += _collision(f"foot{k}", _pose(centre), shape, friction)
    return text + "    </link>\n  </model>\n</sdf>\n"
