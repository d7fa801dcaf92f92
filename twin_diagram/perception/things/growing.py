"""An unknown thing followed by what was seen of it, and the pictures that may make it an asset: pure functions.

The thing's own frame T is that of W, about its middle, when its first picture was taken. From image to image it is
registered with its own partial cloud, as known objects are with theirs, so it does not matter whether it turned or the
camera moved. A picture that shows a new side is kept in T (see `assets.building.growth`), and its surface joins the
cloud. A thing that cannot be followed any more begins anew: pictures of two places of T would be of two things.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from twin_diagram.assets import Asset
from twin_diagram.assets.building.growth import Growth, Support, in_thing
from twin_diagram.logs.frames.scene_folder import RgbdFrame
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.perception.registration.frame import whole_pixels
from twin_diagram.perception.registration.model_cloud import ModelCloud
from twin_diagram.perception.registration.registration import RegisteredPose, claimed, register
from twin_diagram.perception.registration.rotation import exp
from twin_diagram.perception.registration.slots import Slot, predict, seen
from twin_diagram.perception.registration.view import Known, View
from twin_diagram.perception.registration.where_expected import TUNING as EXPECTED
from twin_diagram.perception.registration.where_expected import register_where_expected
from twin_diagram.perception.segmentation.planes import Plane
from twin_diagram.perception.segmentation.segments import TUNING as SEGMENTS
from twin_diagram.perception.segmentation.segments import Segments
from twin_diagram.perception.things.clusters import Placed, clusters, unexplained
from twin_diagram.perception.things.memory import Indices, Remembered, beneath, matched
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER
from twin_diagram.signals.things import Thing

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them; chosen by hand."""

    fewest: int = 200
    """Points that a thing's first picture must have: fewer make no cloud that could be followed."""

    most: int = 3000
    """Points of a partial cloud: as many as an asset's has."""

    fits: float = 0.6
    """Share of the cloud in view that must fit where a picture is kept: what is followed well has 0.8 and more."""

    open: float = 0.8
    """And share of what faces the camera that nothing hides: half behind an arm, a box was taken for tilted by 10°."""

    given_up: float = 1.0
    """A thing that could not be followed for so long begins anew [s]."""

    stands: float = 0.02
    """A thing whose lowest points are farther above all planes stands on none [m], but for noise: see `sigmas`."""

    sinks: float = 0.05
    """Nor does what is so far below one [m]: pixels at a thing's edge may lie deeper."""

    turns: float = 0.2
    """What stands may turn on its plane by this from image to image [rad], a standard deviation, …"""

    shifts: float = 0.03
    """… slide on it by this [m], …"""

    steady: tuple[float, float] = (0.01, 0.002)
    """… and tilts and lifts by no more than a plane is known to [rad], [m]."""

    sure: float = 0.85
    """Where less than this share of what fits in shape fits in colour …"""

    tried: tuple[float, ...] = (-0.12, 0.12)
    """… turns by these are tried, too [rad]: registration finds back from about that."""

    exact: float = 0.0015
    """Where depth is noisier [m], image points do not pull: a mug before a D435 was then held back from turning, while
    before an exact camera they halve the error of a box without texture."""

    shown: float = 0.3
    """Of what is shown to a smaller share, what stands cannot be told from what does not."""

    snaps: float = float(np.radians(7.0))
    """What stood on a plane and seems tilted by less than this stands on it [rad]: noise of a D435 does …"""

    tipped: float = float(np.radians(15.0))
    """… and beyond this it was tipped over [rad]; in between no picture is kept."""

    on_plane: float = 0.006
    """What is nearer to the plane than this shows it [m], …"""

    sigmas: float = 3.0
    """… and so many standard deviations of depth."""

    beside: float = 0.5
    """About a thing so much of its extent in the image is kept with it: the plane under it is found there, …"""

    least_beside: int = 24
    """… and no fewer pixels than this."""

    fastest: float = 2.0
    """A picture is kept of what turns more slowly than this [rad/s]: a frame of 1/15 s then blurs it by 8°."""


TUNING = Tuning()


@dataclass(frozen=True)
class GrowingThing:
    """An unknown thing and what was seen of it.

    Attributes:
        slot: where it is and how it moves: X_WT.
        growth: its pictures.
        cloud: what they show, ready to be registered; None before there is one.
        begun: capture time of its first picture [s].
    """

    slot: Slot = field(default_factory=Slot)
    growth: Growth = field(default_factory=Growth)
    cloud: Known | None = None
    begun: float = NEVER

    def placed(self, R_TO: Array, p_TO: Array, time: float) -> tuple[Array, Array]:
        """Return R_WO (3, 3) and p_WO (3,) [m] at a time of what sits in the thing."""
        R, p = predict(self.slot, time)
        return R @ R_TO, R @ p_TO + p


def shown(things: Sequence[Thing], segments: Segments, known: Sequence[Placed]) -> dict[int, Indices]:
    """Return which of the segments' points show which unknown thing, by its identity.

    Args:
        things: as they are believed to be after this image.
        segments: the image taken apart.
        known: the known objects that the image shows.
    """
    slots = [Remembered(thing) for thing in things if thing.stands and thing.last_seen >= segments.time]
    if not slots:
        return {}
    found = clusters(segments, unexplained(segments, known))
    cluster_of, _ = matched(slots, [segments.points_W[own] for own in found], segments)
    return {slots[k].thing.identity: found[j] for k, j in cluster_of.items()}


def grown_on(
    growing: Mapping[int, GrowingThing], shows: Mapping[int, Indices], view: View, most: int
) -> dict[int, GrowingThing]:
    """Return what is known of unknown things after an image.

    Args:
        growing: before it, by identity.
        shows: which of the segments' points show which thing; see `shown`.
        view: the image.
        most: so many things are followed at a time; further ones wait.
    """
    after = dict(growing)
    for identity, own in sorted(shows.items()):
        if identity in after or len(after) < most:
            after[identity] = _with_image(after.get(identity, GrowingThing()), view, own)
    return {identity: one for identity, one in after.items() if one.cloud is not None}


def _with_image(thing: GrowingThing, view: View, own: Indices) -> GrowingThing:
    """Return what is known of a thing after an image that shows it as the segments' points `own`."""
    time, points = view.segments.time, view.segments.points_W[own]
    if thing.cloud is None:
        if len(own) < TUNING.fewest:
            return thing
        slot = Slot(True, np.eye(3), points.mean(axis=0), np.zeros(6), time)
        return _with_picture(GrowingThing(slot, begun=time), view.segments, own)
    under = _plane_under(view.segments, own)
    found = _upright(thing, view, under) or register_where_expected(thing.cloud, thing.slot, view)
    if found is None:
        lost = time - thing.slot.seen > TUNING.given_up
        return _with_image(GrowingThing(), view, own) if lost else thing
    found, tilt = standing(found, thing.growth, under)
    after = replace(thing, slot=seen(thing.slot, found, time))
    away = (view.segments.camera.p_WC - points.mean(axis=0)) @ found.R
    new = thing.growth.shows_new_side(away / np.linalg.norm(away))
    slow = bool(np.linalg.norm(after.slot.velocity[:3]) < TUNING.fastest)
    sure = tilt < TUNING.snaps or tilt > TUNING.tipped
    # Where the table does not show for once, nobody knows whether it stands.
    sure = sure and bool(view.segments.planes or not any(thing.growth.supports))
    well = found.shape >= TUNING.fits and found.visible_share >= TUNING.open
    return _with_picture(after, view.segments, own) if new and slow and sure and well else after


def _upright(thing: GrowingThing, view: View, under: Plane | None) -> RegisteredPose | None:
    """Register a thing that stood on a plane as one that still does; None where that does not explain the image.

    One noisy side of what is round is explained by tilting it nearly as well as by turning it.
    """
    if thing.cloud is None or under is None or not any(thing.growth.supports):
        return None
    slot, time = thing.slot, view.segments.time
    n = np.abs(under.normal)
    turn = n / TUNING.turns + (1.0 - n) / TUNING.steady[0]
    shift = n / TUNING.steady[1] + (1.0 - n) / TUNING.shifts
    prior = np.square(np.concatenate([turn, shift]))
    z = float((slot.p - view.segments.camera.p_WC) @ view.segments.camera.R_WC[:, 2])
    exact = float(view.segments.camera.depth_noise(np.array(z))) < TUNING.exact
    best: RegisteredPose | None = None
    starts = [predict(slot, time)] + ([(slot.R, slot.p)] if slot.velocity.any() else [])
    for k, (R, p) in enumerate(starts):  # which may grow
        model, segments = thing.cloud.model, view.segments
        thin = segments.points_W[claimed(model, segments, R, p, view.params.reach, EXPECTED.thin)] if exact else None
        found = register(model, view.frame, R, p, view.params, prior=prior, points_W=thin)
        if best is None or found.quality > best.quality:
            best = found
        if k == 0 and found.quality < TUNING.sure * found.shape:
            turns = (exp(angle * under.normal) for angle in TUNING.tried)
            starts += [(T @ R, p) for T in turns]
    assert best is not None
    return best if best.shape >= TUNING.fits and best.visible_share >= TUNING.shown else None


def standing(found: RegisteredPose, growth: Growth, under: Plane | None) -> tuple[RegisteredPose, float]:
    """Return the pose of what stands as it stood before, and by how much it seems tilted [rad]; 0 where nobody can say.

    Noise that is correlated over a thing tilts and lifts it; a plane that is seen around it does not move.

    Args:
        found: X_WT as registered.
        growth: its pictures.
        under: the plane on which it stands in this image; None: none.
    """
    before = growth.supports[0] if growth.supports else None
    if before is None or under is None:
        return found, 0.0
    n, m = found.R @ before.plane[:3], under.normal
    axis = np.cross(n, m)
    sine = float(np.linalg.norm(axis))
    tilt = float(np.arctan2(sine, n @ m))
    if tilt > TUNING.snaps:
        return found, tilt
    R = found.R if sine < 1e-9 else exp(axis / sine * tilt) @ found.R
    # The plane stays where it is in T: n·(p + R x) = offset for n_T·x = d.
    p = found.p + (under.offset - before.plane[3] - m @ found.p) * m
    return replace(found, R=R, p=p), tilt


def _with_picture(thing: GrowingThing, segments: Segments, own: Indices) -> GrowingThing:
    """Return a thing with one picture more, and what that shows in its cloud."""
    R, p = thing.slot.R, thing.slot.p
    frame, support = picture_of(segments, own, R, p)
    growth = thing.growth.with_frame(in_thing(frame, R, p, turned=False), support)
    if len(growth) == len(thing.growth):
        return thing
    cloud = cloud_of(growth)
    return replace(thing, growth=growth, cloud=thing.cloud if cloud is None else cloud)


def cloud_of(growth: Growth) -> Known | None:
    """Return what pictures show of a thing as a cloud that can be registered; None where it is too little."""
    part = growth.partial()
    if len(part.points) < TUNING.fewest:
        return None
    chosen = np.random.default_rng(0).permutation(len(part.points))[: TUNING.most]
    points, normals, colours = part.points[chosen], part.normals[chosen], part.colours[chosen]
    size = 2.0 * np.abs(points).max(axis=0)
    asset = Asset("thing", Path(), points, normals, colours, None, (), 1.0, size)
    return Known(ModelCloud.of(asset, len(chosen)), [], [])


def picture_of(segments: Segments, own: Indices, R_WT: Array, p_WT: Array) -> tuple[RgbdFrame, Support | None]:
    """Return the part of an image that shows a thing, its cameras in W, and what it shows of the plane under it.

    Kept are the thing's depth, that of the robot before it, and that of the plane; all else may move on its own.

    Args:
        segments: the image taken apart.
        own: the segments' points that show the thing.
        R_WT: (3, 3) of the thing, for the plane in T.
        p_WT: (3,) [m].
    """
    standing = segments.label_image >= 0
    cells = np.zeros(standing.shape, dtype=bool)
    rows, columns = np.nonzero(standing)
    cells[rows[own], columns[own]] = True
    window = _window(cells, segments.stride, segments.depth.shape)
    depth = segments.depth[window]

    def whole(mask: Mask) -> Mask:
        return np.asarray(whole_pixels(mask, segments.stride, segments.depth.shape)[window])

    mask, before = whole(cells), whole(segments.label_image == SEGMENTS.robot)
    camera = _camera(segments, window)
    support = None
    plane = _plane_under(segments, own)
    table = np.zeros(mask.shape, dtype=bool)
    if plane is not None:
        points = (camera.rays() * depth[..., None]) @ camera.R_WC.T + camera.p_WC
        near = TUNING.on_plane + TUNING.sigmas * segments.camera.depth_noise(depth)
        table = (np.abs(plane.height(points)) < near) & (depth > 0) & ~mask & ~before
        n = R_WT.T @ plane.normal
        support = Support(np.array([*n, plane.offset - plane.normal @ p_WT]), table)
    kept = np.where(mask | before | table, depth, 0).astype(np.float32)
    rgb = np.ascontiguousarray(segments.rgb[window])
    return RgbdFrame(0, segments.time, rgb, kept, mask & (depth > 0), camera, camera), support


def _plane_under(segments: Segments, own: Indices) -> Plane | None:
    """Return the plane on which stands what points `own` show; None where it stands on none that is seen."""
    points, planes = segments.points_W[own], beneath(own, segments)
    z = float((points.mean(axis=0) - segments.camera.p_WC) @ segments.camera.R_WC[:, 2])
    above = TUNING.stands + TUNING.sigmas * float(segments.camera.depth_noise(np.array(z)))
    feet = [float(np.percentile(plane.height(points), 5.0)) for plane in planes]
    near = [(abs(foot), k) for k, foot in enumerate(feet) if -TUNING.sinks < foot < above]
    return planes[min(near)[1]] if near else None


def _window(cells: Mask, stride: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the rows and columns of the image about cells of the working grid."""
    spans = []
    for axis, size in ((1, shape[0]), (0, shape[1])):
        there = np.flatnonzero(cells.any(axis=axis)) * stride
        more = max(TUNING.least_beside, int(TUNING.beside * (there[-1] - there[0])))
        spans.append(slice(max(0, int(there[0]) - more), min(size, int(there[-1]) + stride + more)))
    return spans[0], spans[1]


def _camera(segments: Segments, window: tuple[slice, slice]) -> ViewCamera:
    """Return the camera of a window of the image, in W."""
    rows, columns = window
    lens, own = segments.camera.optics, segments.camera
    size = columns.stop - columns.start, rows.stop - rows.start
    return ViewCamera(*size, lens.fx, lens.fy, lens.cx - columns.start, lens.cy - rows.start, own.R_WC, own.p_WC)
