"""One known object as the twin uses it."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pydrake.math import RigidTransform, RollPitchYaw

from twin_diagram.assets.description import AssetSpec, CollisionShape, read_spec
from twin_diagram.assets.mesh import Cloud, parse_obj, read_obj, read_png, sample
from twin_diagram.assets.symmetry import parsed
from twin_diagram.errors import AssetError
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    cloud_points: int = 3000
    """Points of an asset's cloud; registration thins it further."""

    fewest: int = 100
    """A cloud of fewer points is no surface."""

    most: int = 20_000
    """Of a cloud of more points so many are taken: they are less than 2 mm apart on what a hand can hold, and 200,000
    take twenty times as long to be made ready and find no more."""

    stretches: int = 10
    """Into so many stretches a cloud is cut to see whether its points are in random order."""

    mixed: float = 5.0
    """In random order the middles of stretches vary as those of so many drawn points do; this many times as much is
    order (of a hundred sampled clouds none had more than 2.4)."""

    rounding: float = 1e-3
    """Lengths of normals and colours in single precision may be off by so much."""

    too_large: float = 10.0
    """A cloud so many times the object's size is in another unit: millimetres make it 1,000 times."""

    too_small: float = 0.02
    """… or less than this share of it: a size in mm. About O, a load in a corner may make it twice as large."""


TUNING = Tuning()


@dataclass(frozen=True)
class Asset:
    """A known object: frame O at its geometric centre (its centre of mass where it was built from a mesh), z up.

    Attributes:
        name: as in `asset.yaml`.
        folder: where it lies; `folder / "model.sdf"` is its model with one link `object`.
        points_O: (M, 3) surface points in random order [m].
        normals_O: (M, 3) unit, outward.
        colours: (M, 3) RGB in [0, 1], without light or shade.
        symmetric_axis: `z` where turning about it is not told apart, else None.
        convex_pieces: vertices (m, 3) of convex pieces that together hold the object [m].
        mass: [kg]
        size: (3,) edge lengths of the box about O that holds it [m].
        symmetries: axis of O (0 to 2) and repetitions in a whole turn (0: any) of turns that nothing tells apart.
        unpainted: (M,) points whose colours no picture showed: they are made up; None: none is.
    """

    name: str
    folder: Path
    points_O: Array
    normals_O: Array
    colours: Array
    symmetric_axis: str | None
    convex_pieces: tuple[Array, ...]
    mass: float
    size: Array
    symmetries: tuple[tuple[int, int], ...] = ()
    unpainted: npt.NDArray[np.bool_] | None = None

    @property
    def model_file(self) -> Path:
        """The SDF model."""
        return self.folder / "model.sdf"

    @staticmethod
    def load(folder: str | Path) -> Asset:
        """Read an asset's folder.

        Its cloud is `cloud.npz` (points, normals, colours) where there is one, else it is sampled from the visual mesh.

        Raises:
            AssetError: the folder, a file in it or a value is missing or malformed; the message names it.
        """
        folder = Path(folder)
        description, spec = folder / "asset.yaml", read_spec(folder)
        size = np.array(spec.size, dtype=float)
        if size.shape != (3,) or not (np.isfinite(size) & (size > 0)).all():
            raise AssetError(f"{description}: size must be three positive lengths, not {spec.size}")
        if not (np.isfinite(spec.mass) and spec.mass > 0):
            raise AssetError(f"{description}: mass must be positive, not {spec.mass}")
        if spec.symmetric_axis not in (None, "z"):
            raise AssetError(f"{description}: symmetric_axis must be null or z, not {spec.symmetric_axis!r}")
        if not spec.solids and not spec.pieces:
            raise AssetError(f"{description}: solids or pieces must name at least one convex piece")
        cloud = _cloud(folder, spec)
        for array in (cloud.points, cloud.normals, cloud.colours, size):
            array.setflags(write=False)
        pieces = tuple(_vertices(solid, description) for solid in spec.solids)
        pieces += tuple(_piece(folder / name) for name in spec.pieces or ())
        return Asset(
            spec.name,
            folder,
            cloud.points,
            cloud.normals,
            cloud.colours,
            spec.symmetric_axis,
            pieces,
            float(spec.mass),
            size,
            parsed(spec.symmetries or (), str(description)),
            cloud.unpainted,
        )


def _cloud(folder: Path, spec: AssetSpec) -> Cloud:
    """Return the asset's coloured cloud, checked."""
    cached = folder / "cloud.npz"
    if cached.is_file():
        try:
            with np.load(cached, allow_pickle=False) as data:
                read = [np.array(data[key], dtype=float) for key in ("points", "normals", "colours")]
                unpainted = np.array(data["unpainted"]) if "unpainted" in data else None
        except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
            raise AssetError(f"{cached}: cannot be read: {error}; build the asset anew") from None
        return checked_cloud(Cloud(read[0], read[1], read[2], unpainted), np.array(spec.size, dtype=float), cached)
    mesh = folder / spec.visual
    return sample(read_obj(mesh), read_png(mesh.with_suffix(".png")), TUNING.cloud_points)


def checked_cloud(cloud: Cloud, size: Array, file: Path | str) -> Cloud:
    """Return a cloud by others as registration takes it: each point once, in random order, its normal of length 1.

    Args:
        cloud: of M points.
        size: (3,) of the object [m].
        file: what the cloud is from, for messages.

    Raises:
        AssetError: it is no surface.
    """
    points, normals, colours = cloud.points, cloud.normals, cloud.colours
    good = points.ndim == 2 and points.shape[1] == 3 and points.shape == normals.shape == colours.shape
    if not good or not all(np.isfinite(a).all() for a in (points, normals, colours)):
        raise AssetError(f"{file}: points, normals and colours must be finite and of one shape (M, 3)")
    unpainted = cloud.unpainted
    if unpainted is not None and (unpainted.shape != (len(points),) or unpainted.dtype != np.bool_):
        said = f"{unpainted.dtype} of shape {unpainted.shape}"
        raise AssetError(f"{file}: unpainted must be {len(points)} truth values, one a point, not {said}")
    # Points that lie on one another would make the distance between neighbours nothing.
    once = np.sort(np.unique(points, axis=0, return_index=True)[1])
    if len(once) < TUNING.fewest:
        raise AssetError(f"{file}: {len(once)} different points; {TUNING.fewest} at least are a surface")
    once = once[_in_random_order(points[once])]
    points, normals, colours = points[once], normals[once], colours[once]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    if length.min() < 1e-6:
        raise AssetError(f"{file}: a normal has no length: each must point out of the surface")
    if colours.min() < -TUNING.rounding or colours.max() > 1.0 + TUNING.rounding:
        raise AssetError(f"{file}: colours must lie from 0 to 1, not {colours.min():g} to {colours.max():g}")
    extent = float(np.ptp(points, axis=0).max())
    if not TUNING.too_small * size.max() <= extent <= TUNING.too_large * size.max():
        raise AssetError(f"{file}: points span {extent:g} m, the object's size {size.max():g} m: give both in metres")
    # What is of length 1 already stays as it is, to the bit.
    if np.abs(length - 1.0).max() > TUNING.rounding:
        normals = normals / length
    return Cloud(points, normals, colours, None if unpainted is None else unpainted[once])


def _in_random_order(points: Array) -> npt.NDArray[np.int64]:
    """Return which points (M, 3) to take, the first hundreds of which are to be from all over the surface."""
    count = len(points) // TUNING.stretches
    middles = points[: count * TUNING.stretches].reshape(TUNING.stretches, count, 3).mean(axis=1)
    ratio = count * middles.var(axis=0, ddof=1).sum() / points.var(axis=0).sum()
    order = np.arange(len(points))
    if ratio > TUNING.mixed or len(points) > TUNING.most:
        order = np.random.default_rng(0).permutation(order)
    return order[: TUNING.most]


def _piece(file: Path) -> Array:
    """Return the vertices (m, 3) of a convex piece's file."""
    vertices = parse_obj(file).v if file.is_file() else np.empty((0, 3))
    if len(vertices) < 4:
        raise AssetError(f"{file}: no such convex piece; it needs four vertices at least")
    vertices.setflags(write=False)
    return vertices


def _vertices(solid: CollisionShape, where: Path) -> Array:
    """Return vertices (m, 3) in O of a solid's convex hull; a cylinder becomes the prism of 16 sides around it."""
    expected = {"box": 3, "cylinder": 2}.get(solid.kind)
    if expected is None or len(solid.size) != expected or not (np.array(solid.size) > 0).all():
        raise AssetError(f"{where}: no such solid: {solid.kind} of size {solid.size}")
    for name, numbers in (("translation", solid.translation), ("rpy", solid.rpy)):
        if len(numbers) != 3 or not np.isfinite(numbers).all():
            raise AssetError(f"{where}: a solid's {name} is three numbers, not {numbers}")
    if solid.kind == "box":
        corners = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).T.reshape(-1, 3) * solid.size
    else:
        radius, length = solid.size
        angle = (np.arange(16) + 0.5) * np.pi / 8
        ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) * (radius / np.cos(np.pi / 16))
        corners = np.concatenate([np.insert(ring, 2, z, axis=1) for z in (-length / 2, length / 2)])
    X_OG = RigidTransform(RollPitchYaw(solid.rpy), solid.translation)
    vertices = np.asarray(X_OG.multiply(corners.T)).T.copy()
    vertices.setflags(write=False)
    return vertices
