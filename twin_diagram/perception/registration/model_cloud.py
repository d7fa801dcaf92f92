"""An asset made ready for registration: what of it is seen from where, its colours at two scales, a search tree."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError, cKDTree

from twin_diagram.assets import Asset, symmetry
from twin_diagram.errors import expect
from twin_diagram.perception.registration.cloud_kernels import SurfaceCloud
from twin_diagram.perception.registration.hues import hues
from twin_diagram.perception.registration.nearest_points import NearestPoints
from twin_diagram.perception.registration.point_kernels import UNPAINTED, PointTable
from twin_diagram.perception.registration.rotation import exp
from twin_diagram.perception.registration.round_body import is_round
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.compiled import one_layout


@dataclass(frozen=True)
class Tuning:
    """Constants of an asset's tables, chosen by hand for the objects of `models/objects`.

    `tests/perception/registration` holds what can be seen against ray casting.
    """

    directions: int = 160
    """Directions from which the visible points are worked out beforehand: one is never farther than about 12° away."""

    blur: tuple[float, ...] = (0.003, 0.008)
    """Standard deviation of the colours' blur on the surface [m]: fine, coarse."""

    neighbours: int = 24
    """Points that the blur on the surface takes in, at most: beyond them its weights are small."""

    kept: int = 32
    """Objects whose tables are kept for further twins of the same process: twice the slots."""

    alike: float = 0.08
    """A turned shape is much the same where it lies this share of its radius off itself on average."""

    coloured: float = 0.02
    """A turn after which colours differ by less on average [of 1] nobody can tell: it is no mistake."""

    grey: float = 0.02
    """Colours that differ by less than this [of 1] from one grey are none: the object's mesh had none."""

    other: float = 0.12
    """Turns are other poses where they differ by more, up to symmetries [rad], as in `turned_alike`."""

    steps: int = 24
    """About the axis of a round thing so many turns are told apart: 15° from each to the next."""


TUNING = Tuning()


@dataclass(frozen=True)
class ModelCloud:
    """An asset's cloud with tables for registration.

    Attributes:
        asset: the object.
        points: (M, 3) in O.
        normals: (M, 3).
        colours: (2, M, 3), fine and coarse.
        directions: (D, 3) unit vectors in O towards a far camera.
        views: (D, P) indices of points that such a camera sees, in random order; repeated to fill the row.
        view_counts: (D,) how many of a row are not repeated.
        tree: over `points`.
        spacing: mean distance between neighbouring points [m].
        radius: of the sphere about O that holds the object [m].
        texture: (M,) squared slope of its fine colours along the surface [1/m²]; `UNPAINTED` where no picture showed
            them.
        turns: (T, 3, 3) turns about O's axes that leave the shape much as it was, but not the colours: what is mistaken
            for one another.
    """

    asset: Asset
    points: Array
    normals: Array
    colours: Array
    directions: Array
    views: npt.NDArray[np.int64]
    view_counts: npt.NDArray[np.int64]
    tree: cKDTree
    spacing: float
    radius: float
    texture: Array
    turns: Array

    @cached_property
    def table(self) -> Array:
        """(M, 13) points, normals, texture, fine and coarse colours: what each step of a registration looks up."""
        return one_layout(np.hstack([self.points, self.normals, self.texture[:, None], *self.colours]))

    @cached_property
    def seen(self) -> PointTable:
        """What `look_up` reads."""
        views = one_layout(self.directions), one_layout(self.views), one_layout(self.view_counts)
        return PointTable(self.table, *views)

    @cached_property
    def coloured(self) -> bool:
        """Whether its colours say anything: those of a mesh without any are one grey, and veto nothing."""
        return bool(np.abs(self.colours[0] - self.colours[0].mean()).max() > TUNING.grey)

    @cached_property
    def hues(self) -> Array:
        """(144,) its colours, however bright."""
        return hues(self.asset.colours)

    @cached_property
    def mistaken(self) -> Array:
        """(S, 3, 3) those of `turns` that are other poses up to the asset's symmetries."""
        return other_poses(self.turns, self.asset.symmetries)

    @cached_property
    def is_round(self) -> bool:
        """Whether its shape is round about an axis of O, all of it."""
        return self.asset.symmetric_axis == "z" or is_round(self.points, self.normals)

    @cached_property
    def corners(self) -> Array:
        """(C, 3) those of its points that lie outermost: how tall it is in any way, they tell [m]."""
        try:
            return np.asarray(self.points[ConvexHull(self.points).vertices])
        except QhullError:
            return self.points

    @cached_property
    def view_area(self) -> float:
        """Mean area of what a far camera sees of it, over all sides [m²]: a quarter of the surface (Cauchy)."""
        return 0.25 * len(self.points) * self.spacing**2

    @cached_property
    def middle(self) -> Array:
        """(3,) middle of the box that holds it, in O [m]."""
        return np.asarray(0.5 * (self.points.min(axis=0) + self.points.max(axis=0)))

    def kept_in_place(self, R: Array, p: Array, turned: Array) -> Array:
        """Return (B, 3) places of O at which the object, turned anew, has its middle where (R, p) has it.

        Args:
            R: (3, 3).
            p: (3,) [m].
            turned: (B, 3, 3).
        """
        return np.asarray(p + R @ self.middle - turned @ self.middle)

    @cached_property
    def nearest(self) -> NearestPoints:
        """Its points, to be searched for the nearest."""
        return NearestPoints.of(self.points, self.spacing)

    @cached_property
    def cloud(self) -> SurfaceCloud:
        """What `cloud_kernels` read."""
        return SurfaceCloud(one_layout(self.points), one_layout(self.normals), self.nearest.grid)

    @staticmethod
    def of(asset: Asset, view_points: int) -> ModelCloud:
        """Work the tables out.

        Args:
            asset: the object.
            view_points: points kept per direction.
        """
        expect(asset, Asset, "library", "an Asset for each name (Asset.load(FOLDER))")
        key = _digest(asset, view_points)
        if (kept := _KEPT.get(key)) is None:
            kept = _KEPT[key] = ModelCloud._worked_out(asset, view_points)
            if len(_KEPT) > TUNING.kept:
                del _KEPT[next(iter(_KEPT))]
        return replace(kept, asset=asset)

    @staticmethod
    def _worked_out(asset: Asset, view_points: int) -> ModelCloud:
        points, normals = asset.points_O, asset.normals_O
        tree = cKDTree(points)
        distance, neighbour = tree.query(points, k=min(TUNING.neighbours, len(points)), workers=1)
        spacing = float(np.median(distance[:, 1]) * 2)
        alike = np.einsum("mki,mi->mk", normals[neighbour], normals) > 0.7
        painted = np.ones(len(points), dtype=bool) if asset.unpainted is None else ~asset.unpainted
        # What is made up does not blur into what is not.
        alike &= painted[neighbour] | ~painted[:, None]
        colours = np.empty((len(TUNING.blur), *points.shape))
        for level, sigma in enumerate(TUNING.blur):
            weight = np.exp(-0.5 * (distance / sigma) ** 2) * alike
            weight /= weight.sum(axis=1, keepdims=True)
            colours[level] = np.einsum("mk,mki->mi", weight, asset.colours[neighbour])
        directions = fibonacci_sphere(TUNING.directions)
        views = np.zeros((TUNING.directions, view_points), dtype=np.int64)
        counts = np.zeros(TUNING.directions, dtype=np.int64)
        for k, direction in enumerate(directions):
            seen = np.flatnonzero(visible(points, normals, direction, 2.0 * spacing))[:view_points]
            counts[k] = len(seen)
            if len(seen):
                views[k] = np.resize(seen, view_points)
        radius = float(np.linalg.norm(points, axis=1).max())
        steps = ((colours[0][neighbour] - colours[0][:, None]) ** 2).sum(axis=2) * alike
        # A slope g makes steps of g² d² / 2 on average over all ways to go.
        texture = 2.0 * steps.sum(axis=1) / np.maximum((distance**2 * alike).sum(axis=1), 1e-12)
        texture[~painted] = UNPAINTED
        turns = alike_turns(points, tree, 0.5 * spacing + TUNING.alike * radius, asset.symmetric_axis)
        turns = turns[[recoloured(points, tree, colours[0], turn) > TUNING.coloured for turn in turns]]
        return ModelCloud(
            asset, points, normals, colours, directions, views, counts, tree, spacing, radius, texture, turns
        )


_KEPT: dict[bytes, ModelCloud] = {}
"""Tables by what they follow from, the latest: another twin or tracker of the same objects has them at once."""


def _digest(asset: Asset, view_points: int) -> bytes:
    digest = hashlib.sha256(f"{asset.symmetric_axis} {view_points} {TUNING}".encode())
    unpainted = np.zeros(0, dtype=bool) if asset.unpainted is None else asset.unpainted
    for part in (asset.points_O, asset.normals_O, asset.colours, unpainted):
        digest.update(np.ascontiguousarray(part).tobytes() + str(part.dtype).encode())
    return digest.digest()


def alike_turns(points: Array, tree: cKDTree, most: float, symmetric_axis: str | None) -> Array:
    """Return turns (T, 3, 3) about O's axes, each with the middle of the box kept in place, that leave a shape alike.

    Quarter and half turns; about the axis of a round thing small ones, too, upside down or not.

    Args:
        points: (M, 3) of the surface.
        tree: over them.
        most: mean distance [m] between the surface and itself turned, up to which it is taken for alike.
        symmetric_axis: `z` where turns about it do not count.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    thin = points[:: max(1, len(points) // 400)] - middle

    def alike(turn: Array) -> bool:
        distance, _ = tree.query(thin @ turn.T + middle, workers=1)
        return bool(distance.mean() < most)

    axes = [axis for axis in np.eye(3) if not (axis[2] and symmetric_axis == "z")]
    found = [turn for axis in axes for turn in exp(0.5 * np.pi * np.outer([1, 2, 3], axis)) if alike(turn)]
    for axis in axes:
        around = exp(2.0 * np.pi * np.outer(np.arange(1, TUNING.steps) / TUNING.steps, axis))
        if all(alike(turn) for turn in around[:2]) and alike(around[TUNING.steps // 4 - 1]):
            over = [turn for turn in found if axis @ turn @ axis < -0.5][:1]
            found += [turn for turn in around if not _among(turn, found)]
            found += [turn @ one for one in over for turn in around if not _among(turn @ one, found)]
    return np.array(found).reshape(-1, 3, 3)


def other_poses(turns: Array, symmetries: tuple[tuple[int, int], ...]) -> Array:
    """Return those of turns (T, 3, 3) that are other poses up to symmetries, each once, by the least turn to it."""
    if not symmetries:
        return turns
    kept = [np.eye(3)]
    for turn in sorted(turns, key=lambda turn: -float(np.trace(turn))):
        if symmetry.apart(turn, np.array(kept), symmetries).min() > TUNING.other:
            kept.append(turn)
    return np.array(kept[1:]).reshape(-1, 3, 3)


def recoloured(points: Array, tree: cKDTree, colours: Array, turn: Array) -> float:
    """Return by how much the colours (M, 3) of a surface differ on average from its own after a turn (3, 3) [of 1].

    Args:
        points: (M, 3) of the surface; the middle of the box that holds them is kept in place.
        tree: over them.
        colours: (M, 3).
        turn: (3, 3).
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    every = slice(None, None, max(1, len(points) // 400))
    _, near = tree.query((points[every] - middle) @ turn.T + middle, workers=1)
    return float(np.linalg.norm(colours[every] - colours[near], axis=1).mean())


def _among(turn: Array, others: list[Array]) -> bool:
    return any(np.trace(turn.T @ one) > 2.99 for one in others)


def fibonacci_sphere(count: int) -> Array:
    """Return (count, 3) unit vectors spread evenly."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angle = np.pi * (1.0 + 5.0**0.5) * k
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def visible(points: Array, normals: Array, direction: Array, cell: float) -> npt.NDArray[np.bool_]:
    """Return which points a far camera in `direction` (from object to camera) sees: they face it, nothing is in front.

    A depth buffer of square cells of size `cell` [m]: a point is hidden where its cell's foremost point lies more than
    12 mm nearer to the camera, and as far above the point's own tangent plane (so a convex object hides nothing of
    itself).
    """
    helper = np.eye(3)[int(np.argmin(np.abs(direction)))]
    right = np.cross(direction, helper)
    right /= np.linalg.norm(right)
    flat = np.stack([right, np.cross(direction, right)]) @ points.T
    row, column = np.floor((flat - flat.min(axis=1, keepdims=True)) / cell).astype(np.int64)
    key = row * (column.max() + 1) + column
    height = points @ direction
    top = np.full(int(key.max()) + 1, -np.inf)
    np.maximum.at(top, key, height)
    # Far fewer than all face the camera and lie so deep that they may be hidden.
    seen = normals @ direction > 0.1
    asked = np.flatnonzero(seen & (top[key] - height > 0.012))
    highest = np.flatnonzero(height == top[key])
    foremost = np.zeros(len(top), dtype=np.int64)
    foremost[key[highest]] = highest
    before = points[foremost[key[asked]]] - points[asked]
    seen[asked] = np.einsum("mi,mi->m", normals[asked], before) <= 0.012
    return np.asarray(seen)
