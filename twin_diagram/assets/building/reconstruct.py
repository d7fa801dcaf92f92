"""From posed depth images to a closed, coloured mesh of the one object that they show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from twin_diagram.assets.building.colouring import views_that_see
from twin_diagram.assets.building.contradictions import agreeing, check_agreement, kept_to_mask
from twin_diagram.assets.building.cube_scale import Cube
from twin_diagram.assets.building.decimation import decimated, enclosed_volume
from twin_diagram.assets.building.depth_view import DepthView, cropped, thinned, view_points
from twin_diagram.assets.building.fusion import DistanceField, FusionGrid, fuse, without, without_hand, without_remains
from twin_diagram.assets.building.hollows import Opened, with_floors
from twin_diagram.assets.building.iso_surface import zero_surface
from twin_diagram.assets.building.lasting_error import TUNING as LASTING
from twin_diagram.assets.building.lasting_error import lasting_error, one_camera
from twin_diagram.assets.building.looking_past import check_unseen
from twin_diagram.assets.building.selection import TUNING as CHOICE
from twin_diagram.assets.building.selection import grown, looked_at, masked_by_most, the_one_thing
from twin_diagram.assets.building.shape_errors import Doubt
from twin_diagram.assets.building.smoothing import smoothed, vertex_normals
from twin_diagram.assets.building.support_plane import find_plane
from twin_diagram.assets.building.thin_walls import sloping_share
from twin_diagram.assets.building.unseen_places import unseen_places
from twin_diagram.assets.building.view_poses import AlignedViews, align, doubted
from twin_diagram.errors import FramesError
from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.logs.frames.scene_folder import RgbdFrame
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Sizes and limits of a reconstruction."""

    least_views: int = 3
    """Fewer pictures show too little of any object."""

    largest: float = 2.0
    """Longest edge of an object [m]; above it, its unit is most likely wrong."""

    smallest: float = 0.005
    """Least longest edge of an object [m]; below it, likewise."""

    thinned: int = 2
    """Every so many rows and columns are looked at to find the object, …"""

    least_columns: int = 300
    """… where so many columns are left of a picture: a mug's handle at 0.6 m is seven of a network's 320 wide, and
    thinned all of it lay beside an edge, so that the object ended before its handle."""

    window: int = 40
    """Pixels about the object that are kept: of the support, by which views are levelled."""

    voxel: float = 0.001
    """Finest grid [m]: half of the thinnest wall that is to be kept."""

    grid_points: float = 1.3e6
    """About how many points a grid may have; larger objects get coarser ones."""

    smoothing_rounds: int = 8
    """Pairs of smoothing steps on the dense mesh."""

    faces: int = 12000
    """About how many triangles a finished mesh has."""

    closest: float = 0.03
    """Least distance from cameras to what they look at [m]; less, and a unit is wrong."""

    farthest: float = 20.0
    """Greatest such distance [m]; more, and a unit is wrong, or millimetres cannot be told."""

    one_side: float = float(np.radians(15.0))
    """Angle that views must span about the object [rad]: from one side alone, no object is told."""

    asked_views: int = 24
    """About how many of the views of a held object tell where it is."""

    hand_within: float = 0.0005
    """Of the hand's boxes, a layer in which the object may lie [m]: by so much poses are off, and pads give way. With
    none, a box held before a D415 loses some of its sides; with 1 mm more of the fingers stays in its mesh."""


TUNING = Tuning()


class FrameSource(Protocol):
    """Hold frames that are read one at a time, such as a `FrameFolder`."""

    def __len__(self) -> int: ...

    def read(self, index: int) -> RgbdFrame:
        """Return the frame at a place."""
        ...


@dataclass(frozen=True)
class Reconstruction:
    """A closed mesh and what is known of it.

    Attributes:
        vertices: (V, 3) in W [m].
        faces: (F, 3), counter-clockwise from outside.
        views_of: (V,) how many pictures see each vertex.
        unseen: share of the surface that no picture shows.
        plane: (4,) under the object, n·p = d, n up; None where none was found.
        views: windows about the object, at refined poses.
        noise: standard deviation of depth at the object, as found [m].
        doubt: what may move the surface.
    """

    vertices: Array
    faces: npt.NDArray[np.int64]
    views_of: npt.NDArray[np.int64]
    unseen: float
    plane: Array | None
    views: list[DepthView]
    noise: float
    doubt: Doubt


def reconstruct(
    frames: FrameSource,
    where: str = "frames",
    seed: int = 0,
    say: Callable[[str], None] = lambda text: None,
    *,
    held: bool = False,
    beside: Cube | None = None,
    hands: Sequence[Boxes] = (),
) -> Reconstruction:
    """Return the object's mesh.

    Each frame is read twice: once to find the object, once for the window that shows it.

    Args:
        frames: three or more, posed in one frame W, in metres; with masks, all or none.
        where: begins the message of an error.
        seed: of all that is drawn.
        say: is told of each step.
        held: it is held in a hand, and stands on nothing; the frames have masks.
        beside: a cube in W that is none of it, where no view can look.
        hands: where a hand that held it was in W, likewise, a grasp each.

    Raises:
        FramesError: too few views, nothing or two things there, views that contradict each other, or an impossible
            size.
    """
    if len(frames) < TUNING.least_views:
        raise FramesError(f"{where}: {len(frames)} views, at least {TUNING.least_views} are needed to build an object")
    looks = [looked_over(frames.read(k)) for k in range(len(frames))]
    points, plane = held_points(looks, where) if held else object_points(looks, where, seed)
    check_size(points, where)
    low, high = points.min(axis=0), points.max(axis=0)
    box = np.stack(np.meshgrid(*np.stack([low - 0.01, high + 0.01], axis=1)), axis=-1).reshape(-1, 3)
    windows = [cropped(frames.read(k), box, TUNING.window) for k in range(len(frames))]
    views = [view for view in windows if view is not None]
    if len(views) < TUNING.least_views:
        raise FramesError(f"{where}: only {len(views)} views show the object, at least {TUNING.least_views} are needed")
    _check_sides(views, (low + high) / 2, where)
    found = _aligned(views, low, high, plane, seed, held, where, say)
    say(f"poses refined: surfaces agree to {found.noise * 1000:.2f} mm")
    # Only now, for what surrounds the object tells where the cameras were.
    views = [kept_to_mask(view, 0 if held else CHOICE.growth) for view in found.views]
    check_agreement(views, low, high, found.noise, where)
    surest = [doubted(view, c, found.centre, found.noise) for view, c in zip(views, found.covariances, strict=True)]
    fused = fuse(surest, _grid(low, high, TUNING.grid_points, TUNING.voxel), found.noise, found.plane)
    if beside is not None:
        fused = without(fused, beside)
    for hand in hands:
        fused = without_hand(fused, hand, TUNING.hand_within)
    if hands:
        fused = without_remains(fused)
    opened = with_floors(_one_body(fused, where), found.plane)
    vertices, faces = _mesh(_one_body(opened.field, where))
    check_size(vertices, where)
    count = views_that_see(views, vertices, vertex_normals(vertices, faces))
    unseen = check_unseen(share_unseen(vertices, faces, count), where)
    say(f"{len(faces)} triangles, {enclosed_volume(vertices, faces) * 1e6:.1f} cm³, {100 * unseen:.0f} % never seen")
    doubt = _doubt(found, opened, sloping_share(vertices, faces, count > 1, found.plane))
    return Reconstruction(vertices, faces, count, unseen, found.plane, views, found.noise, doubt)


def looked_over(frame: RgbdFrame) -> DepthView:
    """Return a frame's view as it is looked at to find the object: thinned, where it is large."""
    return thinned(frame, TUNING.thinned if frame.depth.shape[1] >= TUNING.thinned * TUNING.least_columns else 1)


def _doubt(found: AlignedViews, opened: Opened, sloping: float) -> Doubt:
    """Return what may move the surface of what was fused of views."""
    alike = len(found.views) < LASTING.least_views and one_camera(found.views)
    unseen = unseen_places(opened.field, opened.chance, found.plane, sloping)
    return Doubt(found.covariances, found.together, found.centre, alike, unseen, opened.field.grid.voxel**3)


def _aligned(
    views: list[DepthView],
    low: Array,
    high: Array,
    plane: Array | None,
    seed: int,
    held: bool,
    where: str,
    say: Callable[[str], None],
) -> AlignedViews:
    """Return views that agree, without those that slipped and without what all have wrong at the same pixels."""
    found = align(views, low, high, plane, seed)
    if held and len(kept := agreeing(found.views, low, high, found.noise)) < len(views):
        # What slipped in the hand as its picture was taken was followed wrongly; the others do without it.
        say(f"{len(views) - len(kept)} of {len(views)} views contradict the others and are left out")
        views = [views[k] for k in kept]
        _check_sides(views, (low + high) / 2, where)
        found = align(views, low, high, plane, seed)
    lasting = lasting_error(found, low, high, seed)
    if lasting is None:
        return found
    distance = float(np.median([np.linalg.norm(view.camera.p_WC - (low + high) / 2) for view in views]))
    say(f"at the same pixels of all views depth is off by {lasting.rms * distance**2 * 1000:.2f} mm: taken out")
    return align([lasting.taken_from(view) for view in views], low, high, plane, seed)


def share_unseen(vertices: Array, faces: npt.NDArray[np.int64], count: npt.NDArray[np.int64]) -> float:
    """Return the share of the surface whose corners no view sees."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return float((area * (count[faces] == 0).mean(axis=1)).sum() / area.sum())


def object_points(views: Sequence[DepthView], where: str, seed: int) -> tuple[Array, Array | None]:
    """Return the object's points (N, 3) and the plane under it."""
    focus, distance = looked_at(views)
    if not TUNING.closest <= distance <= TUNING.farthest:
        raise FramesError(
            f"{where}: the cameras would be {distance:.3g} m from what they look at; is a unit wrong "
            "(depth_scale: mm per step, cam_t_w2c: mm)?"
        )
    samples = [view_points(view, 2, None) for view in views]
    points = np.concatenate([sample[0] for sample in samples])
    normals = np.concatenate([sample[1] for sample in samples])
    near = np.linalg.norm(points - focus, axis=1) < CHOICE.reach * distance
    above = np.mean([view.camera.p_WC for view in views], axis=0)
    rng = np.random.default_rng(seed)
    own = [view.mask for view in views if view.mask is not None]
    if own:
        masks = [grown(mask) for mask in own]
        held = masked_by_most(views, points, masks)
        free = np.flatnonzero(~held & near)
    else:
        free = np.flatnonzero(near)
    free = free[np.linalg.norm(normals[free], axis=1) > 0.5]
    free = free[rng.permutation(len(free))[:6000]]
    plane = find_plane(points[free], normals[free], above, seed)
    if not own:
        if plane is None:
            raise FramesError(f"{where}: no plane on which a thing stands; give masks of the object")
        held = near
    if plane is None:  # held in the air: what a grown mask shows beside it lies behind it, and no plane parts it off
        held = held & within_own(views, [sample[0] for sample in samples])
    else:
        held = held & (points @ plane[:3] - plane[3] > stands_out(points, normals, plane))
    candidates = points[held]
    kept = candidates[the_one_thing(candidates, where)]
    if plane is not None:  # down to the plane itself
        foot = kept - np.outer(kept @ plane[:3] - plane[3], plane[:3])
        kept = np.concatenate([kept, foot])
    return kept, plane


def stands_out(points: Array, normals: Array, plane: Array) -> float:
    """Return the height above its support (4,) from which a point is a thing's [m]: more, where the support is bent.

    Args:
        points: (N, 3) of the scene [m].
        normals: (N, 3) unit, or 0 where unknown.
        plane: n·p = d, n up.
    """
    height = points @ plane[:3] - plane[3]
    on = height[(np.abs(height) < CHOICE.bent) & (normals @ plane[:3] > CHOICE.flat)]
    spread = 1.4826 * float(np.median(np.abs(on - np.median(on)))) if len(on) else 0.0
    return max(CHOICE.stands_out, CHOICE.spreads * spread)


def held_points(views: Sequence[DepthView], where: str) -> tuple[Array, None]:
    """Return the points (N, 3) that most masks hold, of an object with no plane under it."""
    some = views[:: max(1, len(views) // TUNING.asked_views)]
    each = [view_points(view, 2, None)[0] for view in some]
    points, masks = np.concatenate(each), [grown(view.mask) for view in some if view.mask is not None]
    kept = points[masked_by_most(some, points, masks) & within_own(some, each)]
    return kept[the_one_thing(kept, where)], None


def within_own(views: Sequence[DepthView], points: Sequence[Array]) -> npt.NDArray[np.bool_]:
    """Return (N,), which of each view's own points (…, 3) its own mask holds: what a grown one adds lies behind."""
    pairs = [(view, own, view.mask) for view, own in zip(views, points, strict=True) if view.mask is not None]
    return np.concatenate([masked_by_most([view], own, [mask]) for view, own, mask in pairs])


def check_size(points: Array, where: str) -> None:
    """Refuse points of what is larger or smaller than objects are; `where` begins the message."""
    longest = float((points.max(axis=0) - points.min(axis=0)).max())
    if not TUNING.smallest <= longest <= TUNING.largest:
        wrong = f"{longest:.3g} m" if longest > 1 else f"{longest * 1000:.3g} mm"
        raise FramesError(
            f"{where}: the object would be {wrong} long; objects are {TUNING.smallest * 1000:g} mm to "
            f"{TUNING.largest:g} m: "
            "is a unit wrong (depth_scale: mm per step, cam_t_w2c: mm)?"
        )


def _check_sides(views: Sequence[DepthView], middle: Array, where: str) -> None:
    """Refuse views that all show the object from one side."""
    away = np.array([view.camera.p_WC - middle for view in views])
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    span = float(np.arccos(np.clip((away @ away.T).min(), -1.0, 1.0)))
    if span < TUNING.one_side:
        raise FramesError(
            f"{where}: all {len(views)} views show the object from one side, within {np.degrees(span):.1f}°; "
            f"{np.degrees(TUNING.one_side):.0f}° at least are needed, views from all around are better"
        )


def _grid(low: Array, high: Array, count: float, finest: float) -> FusionGrid:
    extent = high - low
    voxel = max(finest, float((np.prod(extent + 0.02) / count) ** (1 / 3)))
    return FusionGrid.around(low, high, voxel, max(0.01, 5 * voxel))


def _mesh(fused: DistanceField) -> tuple[Array, npt.NDArray[np.int64]]:
    """Return a field's surface, smoothed and with no more faces than are kept, in W."""
    vertices, faces = zero_surface(fused.distance)
    vertices = vertices * fused.grid.voxel + fused.grid.origin
    return decimated(smoothed(vertices, faces, TUNING.smoothing_rounds), faces, TUNING.faces)


def _one_body(fused: DistanceField, where: str) -> DistanceField:
    """Return a field with the largest thing in it alone, outside at all its ends; closed cavities within are filled."""
    field = fused.distance.copy()
    for axis in range(3):
        for end in (0, -1):
            np.moveaxis(field, axis, 0)[end] = np.maximum(np.moveaxis(field, axis, 0)[end], fused.grid.voxel)
    label, count = ndimage.label(field < 0)
    if not count:
        raise FramesError(f"{where}: no surface: the views look through each other's")
    sizes = np.bincount(label.ravel())
    sizes[0] = 0
    kept = label == int(np.argmax(sizes))
    field = np.where((field < 0) & ~kept, fused.grid.voxel * 0.5, field)
    outside, _ = ndimage.label(~kept)
    bubbles = ~kept & (outside != outside[0, 0, 0])
    field = np.where(bubbles, -0.5 * fused.grid.voxel, field)
    return replace(fused, distance=field.astype(np.float32))
