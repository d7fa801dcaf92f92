"""Descriptions of an object: its file `asset.yaml` and the SDF model that Drake simulates and shows."""

# No `from __future__ import annotations` here: Drake's YAML functions read the fields' types themselves, not strings.

from dataclasses import dataclass, field

import numpy as np

from twin_diagram.assets.mesh import Mesh
from twin_diagram.signals.arrays import Array


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


def solid_inertia(spec: AssetSpec) -> Array:
    """Return (3, 3) moments about the centre of mass of a full box.

    Or else of a full upright cylinder, of uniform density.
    """
    x, y, z = spec.size
    m = spec.mass
    if spec.shape == "box":
        return np.diag([y * y + z * z, x * x + z * z, x * x + y * y]) * (m / 12)
    r = min(x, y) / 2
    return np.diag([3 * r * r + z * z, 3 * r * r + z * z, 6 * r * r]) * (m / 12)


def shell_inertia(mesh: Mesh, mass: float) -> tuple[Array, Array]:
    """Return the centre of mass p_OBcm (3,) and moments (3, 3) about it, axes of O, of a thin wall of even thickness.

    Exact for each flat triangle: its second moment is area/12 · (Σ vᵢvᵢᵀ + 9 c cᵀ) with its centroid c.
    """
    v = mesh.vertices[mesh.faces]
    area = 0.5 * np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1)
    centroid = v.mean(axis=1)
    share = area / area.sum() * mass
    com = (share[:, None] * centroid).sum(axis=0) / mass
    corner, middle = v - com, centroid - com
    second = np.einsum("f,fki,fkj->ij", share / 12, corner, corner)
    second += np.einsum("f,fi,fj->ij", share * 9 / 12, middle, middle)
    return com, np.trace(second) * np.eye(3) - second


def feet(solid: CollisionShape) -> Array:
    """Return centres (k, 3) of the spheres on which an object stands.

    Corners of a box, eight along each rim of a cylinder.
    """
    if solid.kind == "box":
        half = np.asarray(solid.size) / 2 - TUNING.foot
        return np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).T.reshape(-1, 3) * half
    radius, length = solid.size
    angle = np.arange(8) * np.pi / 4
    ring = np.stack([np.cos(angle) * (radius - TUNING.foot), np.sin(angle) * (radius - TUNING.foot)], axis=1)
    return np.concatenate([np.insert(ring, 2, sign * (length / 2 - TUNING.foot), axis=1) for sign in (-1.0, 1.0)])


def _pose(translation: Array | list[float], rpy: list[float] | None = None) -> str:
    numbers = [*translation, *(rpy or [0.0, 0.0, 0.0])]
    return "<pose>" + " ".join(f"{x:.9g}" for x in numbers) + "</pose>"


def _collision(name: str, pose: str, shape: str, friction: float) -> str:
    return (
        f'      <collision name="{name}">{pose}<geometry>{shape}</geometry>\n'
        f"        <drake:proximity_properties><drake:mu_dynamic>{friction:g}</drake:mu_dynamic>"
        f"<drake:mu_static>{friction:g}</drake:mu_static></drake:proximity_properties></collision>\n"
    )


def sdf(spec: AssetSpec, com: Array, inertia: Array, friction: float = 0.6) -> str:
    """Return the model as SDF: one free link `object`, frame O, textured visual, primitive collision shapes.

    A box on a table has one point of contact in Drake's point contact, and rocks on it. Small spheres in the corners
    of the first solid stand a little proud of it and give the object feet.
    """
    i = np.asarray(inertia)
    text = (
        f'<?xml version="1.0"?>\n<sdf xmlns:drake="drake.mit.edu" version="1.9">\n  <model name="{spec.name}">\n'
        f'    <link name="object">\n      <inertial>{_pose(com)}<mass>{spec.mass:.9g}</mass><inertia>'
        f"<ixx>{i[0, 0]:.9g}</ixx><iyy>{i[1, 1]:.9g}</iyy><izz>{i[2, 2]:.9g}</izz>"
        f"<ixy>{i[0, 1]:.9g}</ixy><ixz>{i[0, 2]:.9g}</ixz><iyz>{i[1, 2]:.9g}</iyz></inertia></inertial>\n"
        f'      <visual name="surface"><geometry><mesh><uri>{spec.visual}</uri></mesh></geometry></visual>\n'
    )
    for k, solid in enumerate(spec.solids):
        if solid.kind == "box":
            x, y, z = (edge - 2 * TUNING.recess for edge in solid.size)
            shape = f"<box><size>{x:.9g} {y:.9g} {z:.9g}</size></box>"
        else:
            radius, length = solid.size[0] - TUNING.recess, solid.size[1] - 2 * TUNING.recess
            shape = f"<cylinder><radius>{radius:.9g}</radius><length>{length:.9g}</length></cylinder>"
        text += _collision(f"solid{k}", _pose(solid.translation, solid.rpy), shape, friction)
    for k, centre in enumerate(feet(spec.solids[0])):
        shape = f"<sphere><radius>{TUNING.foot:g}</radius></sphere>"
        text += _collision(f"foot{k}", _pose(centre + spec.solids[0].translation), shape, friction)
    return text + "    </link>\n  </model>\n</sdf>\n"
