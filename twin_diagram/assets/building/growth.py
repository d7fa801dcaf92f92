"""An unknown thing that is seen from more and more sides, until it can become an asset.

Pictures are kept in the thing's own frame T, so it does not matter whether the camera moved or the thing turned. From
one side it is a `PartialThing`: the surface that was seen and nothing else. Seen from enough sides, it is
reconstructed as any other object; what no picture shows is counted in the asset's `unseen`.

Example:
    >>> growth = Growth()
    >>> for frame in frames:  # doctest: +SKIP
    ...     growth = growth.with_frame(in_thing(frame, R_WT, p_WT))
    >>> growth.ready  # doctest: +SKIP
    True
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_diagram.assets.building.colouring import bilinear_rgb
from twin_diagram.assets.building.depth_view import Mask, make_view, view_points
from twin_diagram.assets.building.from_frames import asset_of_shape, upright_pose
from twin_diagram.assets.building.from_mesh import AssetPlace, BuiltAsset
from twin_diagram.assets.building.opening import fibonacci_sphere
from twin_diagram.assets.building.reconstruct import reconstruct
from twin_diagram.assets.description import read_spec
from twin_diagram.errors import FramesError
from twin_diagram.logs.frames.scene_folder import RgbdFrame
from twin_diagram.runtime.threads import one_thread
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the growth, chosen by hand."""

    apart: float = float(np.radians(20.0))
    """Least angle between the directions from which two kept pictures show the thing [rad]."""

    most: int = 24
    """Pictures that are kept: twice as many change an asset by a tenth of a millimetre."""

    least: int = 6
    """Pictures without which nothing is built."""

    faces: float = float(np.radians(65.0))
    """Angle from a picture's direction up to which it shows the thing's surface [rad]; depth ends at 75°."""

    share: float = 0.7
    """Share of all directions from which it must have been seen: what stands on a table shows four fifths."""

    directions: int = 300
    """By which that share is counted."""

    below: float = -0.2
    """Of what stands on a plane, directions whose height above it is less than this are not asked for, as a sine: its
    underside shows nowhere. A camera 50° up sees all others when the thing turns once …"""

    standing_share: float = 0.98
    """… of which so many make an asset: with 0.9 a camera that had gone half around a box left its far side 10 mm too
    thick."""

    tilted: float = float(np.radians(3.0))
    """A thing whose support turns by more about it does not stand on it [rad]: ten times what a table's tilt is known
    to; …"""

    lifted: float = 0.004
    """… nor one whose support comes nearer or goes farther by more than this [m]: noise of cameras at arm's length."""

    cell: float = 0.002
    """Edge of the cells by which a partial thing's points are thinned [m]."""


TUNING = Tuning()


@dataclass(frozen=True)
class PartialThing:
    """The surface of a thing that was seen, in T; of the rest nothing is claimed.

    Attributes:
        points: (N, 3) [m].
        normals: (N, 3) unit, outward.
        colours: (N, 3) RGB in [0, 1]; grey where pictures have no colours.
        seen: share of all directions from which it was seen.
    """

    points: Array
    normals: Array
    colours: Array
    seen: float


def in_thing(frame: RgbdFrame, R_WT: Array, p_WT: Array, turned: bool = True, before: Mask | None = None) -> RgbdFrame:
    """Return a masked frame with its cameras in the frame of a thing that is at (R_WT, p_WT).

    Args:
        frame: with a mask of the thing, depth on the grid of colours.
        R_WT: (3, 3) of the thing.
        p_WT: (3,) [m].
        turned: whether it moved since the first frame: then its surroundings do not belong to it, and depth there is
            left out.
        before: (h, w), where something may hide it, such as the arm: depth there stays, so that what lies behind is
            not taken for free.

    Raises:
        FramesError: no mask, an empty one, or another grid.
    """
    if frame.mask is None or not (frame.mask & (frame.depth > 0)).any():
        raise FramesError(f"frame {frame.number}: no mask of the thing that holds depth")
    if frame.mask.shape != frame.depth.shape:
        raise FramesError(f"frame {frame.number}: depth is not on the grid of the mask")
    depth = frame.depth
    if turned:
        depth = np.where(frame.mask if before is None else frame.mask | before, depth, 0).astype(np.float32)
    c = frame.camera
    camera = c.moved(R_WT.T @ c.R_WC, R_WT.T @ (c.p_WC - p_WT))
    return replace(frame, depth=depth, camera=camera, colour=camera)


@dataclass(frozen=True)
class GrownAsset:
    """A thing that became an asset: what was built, and R_TO (3, 3) and p_TO (3,) [m] of it in the thing's frame."""

    built: BuiltAsset
    R_TO: Array
    p_TO: Array


@dataclass(frozen=True)
class Support:
    """What a picture shows of the plane that a thing stands on.

    Attributes:
        plane: (4,) in T: n·p = d, n up [m].
        shown: (h, w) where the picture shows it: while the thing turns on it, it belongs to what was seen.
    """

    plane: Array
    shown: Mask


@dataclass(frozen=True)
class Growth:
    """Pictures of one thing from different sides, as `reconstruct` reads them; grows by `with_frame`.

    Attributes:
        frames: with cameras in T and masks.
        directions: (n, 3) unit, from the thing towards each of their cameras.
        supports: what each picture shows of the plane under it, where that is known.
    """

    frames: tuple[RgbdFrame, ...] = ()
    directions: tuple[Array, ...] = ()
    supports: tuple[Support | None, ...] = ()

    def __len__(self) -> int:
        return len(self.frames)

    def read(self, index: int) -> RgbdFrame:
        """Return a frame."""
        return self.frames[index]

    def with_frame(self, frame: RgbdFrame, support: Support | None = None) -> Growth:
        """Return the growth with one picture more, or this one where it shows no new side or there are enough."""
        direction = _direction(frame)
        if not self.shows_new_side(direction):
            return self
        numbered = replace(frame, number=len(self), time=float(len(self)))
        return Growth((*self.frames, numbered), (*self.directions, direction), (*self.supports, support))

    def shows_new_side(self, direction: Array) -> bool:
        """Return whether a picture from a direction (3,) in T would be kept."""
        if len(self) >= TUNING.most:
            return False
        return all(float(direction @ other) <= np.cos(TUNING.apart) for other in self.directions)

    @property
    def up(self) -> Array | None:
        """Normal (3,) in T of the plane on which the thing stood in all pictures; None: it stood on none."""
        planes = [support.plane for support in self.supports if support is not None]
        if not planes or len(planes) < len(self):
            return None
        normals = np.array([plane[:3] for plane in planes])
        up = normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
        steady = (normals @ up).min() > np.cos(TUNING.tilted) and np.ptp([plane[3] for plane in planes]) < TUNING.lifted
        return up if steady else None

    def alone(self) -> Growth:
        """Return it without what shows of the plane under it: as the thing was turned over that does not belong."""
        frames = [
            frame if support is None else replace(frame, depth=np.where(support.shown, 0, frame.depth))
            for frame, support in zip(self.frames, self.supports, strict=True)
        ]
        return replace(self, frames=tuple(frames), supports=(None,) * len(self))

    @property
    def seen(self) -> float:
        """Share of all directions from which the thing was seen; of what stands, of those that its underside leaves."""
        if not self.directions:
            return 0.0
        asked = fibonacci_sphere(TUNING.directions)
        if (up := self.up) is not None:
            asked = asked[asked @ up > TUNING.below]
        facing = asked @ np.array(self.directions).T
        return float((facing.max(axis=1) > np.cos(TUNING.faces)).mean())

    @property
    def ready(self) -> bool:
        """Whether it was seen from enough sides to become an asset."""
        return len(self) >= TUNING.least and self.seen >= self._share

    @property
    def _share(self) -> float:
        return TUNING.share if self.up is None else TUNING.standing_share

    def partial(self) -> PartialThing:
        """Return what was seen so far.

        Raises:
            FramesError: nothing was.
        """
        found = [_surface(frame) for frame in self.frames]
        if not found:
            raise FramesError("an unknown thing: no picture shows it yet")
        points, normals, colours = (np.concatenate([part[k] for part in found]) for k in range(3))
        _, first = np.unique(np.floor(points / TUNING.cell).astype(np.int64), axis=0, return_index=True)
        return PartialThing(points[first], normals[first], colours[first], self.seen)

    def built(self, place: AssetPlace) -> BuiltAsset:
        """Reconstruct the thing and put it into a library; raises what `grown` does."""
        return self.grown(place).built

    @one_thread()
    def grown(self, place: AssetPlace) -> GrownAsset:
        """Reconstruct the thing, put it into a library, and tell where the asset is in the thing's frame.

        Raises:
            FramesError: it was not seen from enough sides, or pictures contradict each other.
            AssetError: a name or place that cannot be; nothing is written.
        """
        if not self.ready:
            raise FramesError(
                f"{place.name}: {len(self)} pictures from {100 * self.seen:.0f} % of all sides, "
                f"{TUNING.least} from {100 * self._share:.0f} % are needed: it stays a partial thing"
            )
        told = any(support is not None for support in self.supports)
        lifted = told and self.up is None
        found = reconstruct(self.alone() if lifted else self, place.name, held=lifted)
        built = asset_of_shape(found, place, place.name)
        R, p = upright_pose(found)
        centre = np.array(read_spec(built.folder).origin)
        return GrownAsset(built, R.T, R.T @ centre + p)


def _direction(frame: RgbdFrame) -> Array:
    """Return the unit direction (3,) in T from the middle of what a frame shows of the thing to its camera."""
    assert frame.mask is not None
    c = frame.camera
    seen = frame.mask & (frame.depth > 0)
    middle = np.median((c.rays() * frame.depth[..., None])[seen], axis=0)
    away = -c.R_WC @ middle
    return np.asarray(away / np.linalg.norm(away))


def _surface(frame: RgbdFrame) -> tuple[Array, Array, Array]:
    """Return points, outward normals and colours (N, 3) that a frame shows of the thing."""
    assert frame.mask is not None
    points, normals, pixels = view_points(make_view(frame.camera, frame.depth), 1)
    own = frame.mask[pixels[:, 0], pixels[:, 1]]
    points, normals = points[own], normals[own]
    row, column = (np.asarray(pixels[own, k], dtype=np.float64) for k in range(2))
    grey = np.full(points.shape, 0.5)
    return points, normals, grey if frame.rgb is None else bilinear_rgb(frame.rgb, column, row)
