"""What reconstruction takes of one picture: where each pixel's point lies, which way it faces, how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.logs.frames.scene_folder import RgbdFrame
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.signals.arrays import Array

Map = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """What tells an edge from a slope, in pixels and in widths of a pixel on the surface."""

    normal_radius: int = 3
    """Half the width of the window whose plane gives a pixel's normal [pixel]: wider than depth noise is correlated."""

    edge_jump: float = 6.0
    """Depth between neighbours beyond which they lie on two surfaces, in widths of a pixel: a slope of 80°."""

    edge_floor: float = 0.004
    """Least such jump [m]: above the noise of cameras at arm's length."""

    edge_reach: int = 2
    """How far beside an edge depth is doubted [pixel]: cameras mix both sides, and colour and pose are off by as
    much."""

    at_edges: float = 0.02
    """Trust in depth near edges that neighbours share."""

    edge_across: float = 0.8
    """Distance across the surface per distance along the axis that is taken there, where normals are unknown."""

    cosine_floor: float = 0.2
    """Least cosine of incidence that is believed: beyond 78° depth says nothing."""


TUNING = Tuning()


@dataclass(frozen=True)
class DepthView:
    """One depth image with what follows from it.

    Attributes:
        camera: K and the pose as known so far.
        depth: (h, w) along the optical axis [m]; 0 where there is none.
        normals: (h, w, 3) in C, towards the camera; 0 where unknown.
        trust: (h, w) in [0, 1]: 1 well inside a surface that faces the camera, 0 at edges and where there is no depth.
        across: (h, w) distance across the surface per distance along the optical axis: −n·r of the ray r at depth 1 m.
        near_edge: (h, w), where depth may belong to either side of an edge.
        mask: (h, w) where the object shows, or None.
        rgb: (h, w, 3) of the colour camera, or None.
        colour: its camera.
        vote: what its rays count where they contradict what others see, in [0, 1].
        corner: row and column of its first pixel in the camera's whole picture.
    """

    camera: ViewCamera
    depth: Map
    normals: Map
    trust: Map
    across: Map
    near_edge: Mask
    mask: Mask | None
    rgb: npt.NDArray[np.uint8] | None
    colour: ViewCamera
    vote: float = 1.0
    corner: tuple[int, int] = (0, 0)

    def trusted_at(self, mask: Mask) -> DepthView:
        """Return the same view with surfaces beside a mask (h, w) no longer trusted; rays through there still are."""
        return replace(self, trust=np.where(mask, self.trust, 0).astype(np.float32))

    def at(self, camera: ViewCamera) -> DepthView:
        """Return the same view from another pose of the depth camera; the colour camera moves along."""
        if self.colour is self.camera:
            return replace(self, camera=camera, colour=camera)
        R_CD = self.colour.R_WC.T @ self.camera.R_WC
        p_CD = self.colour.R_WC.T @ (self.camera.p_WC - self.colour.p_WC)
        R_WC = camera.R_WC @ R_CD.T
        colour = self.colour.moved(R_WC, camera.p_WC - R_WC @ p_CD)
        return replace(self, camera=camera, colour=colour)


def make_view(
    camera: ViewCamera,
    depth: Map,
    mask: Mask | None = None,
    rgb: npt.NDArray[np.uint8] | None = None,
    colour: ViewCamera | None = None,
    reach: int = TUNING.edge_reach,
    no_surface: Mask | None = None,
) -> DepthView:
    """Return a view from its images; `colour` where the colour camera is another one, `reach` as of `near_edges`.

    Where `no_surface` of the object is seen (h, w), none is trusted, and rays end at the depth there.
    """
    there = depth > 0
    edge = near_edges(depth, camera.fx, reach)
    normals = surface_normals(depth, camera, edge)
    rays = camera.rays().astype(np.float32)
    across = -np.einsum("hwi,hwi->hw", normals, rays)
    facing = across / np.linalg.norm(rays, axis=-1)
    floor = TUNING.cosine_floor
    trust = np.where(there & ~edge, np.clip((facing - floor) / (1 - floor), 0, 1), 0).astype(np.float32)
    # At edges, where nothing else is known, depth that neighbours share is better than none: rims are all edge.
    trust = np.where(edge & _shared(depth), TUNING.at_edges, trust).astype(np.float32)
    across = np.where(edge, TUNING.edge_across, across).astype(np.float32)
    if no_surface is not None:
        trust, edge = np.where(no_surface, 0, trust).astype(np.float32), edge | no_surface
    return DepthView(
        camera, depth, normals, trust, np.maximum(across, 0.05), edge, mask, rgb, camera if colour is None else colour
    )


def thinned(frame: RgbdFrame, step: int) -> DepthView:
    """Return the view of every `step`-th row and column: enough to find the object."""
    depth, mask = frame.depth[::step, ::step], None if frame.mask is None else frame.mask[::step, ::step]
    apart = frame.colour is not frame.camera
    camera = _every(frame.camera, step, depth.shape)
    size = depth.shape if mask is None else mask.shape
    none = None if frame.no_surface is None else frame.no_surface[::step, ::step]
    return make_view(camera, depth, mask, None, _every(frame.colour, step, size) if apart else None, 1, none)


def cropped(frame: RgbdFrame, points: Array, margin: int) -> DepthView | None:
    """Return the view of a window about points (N, 3) in W, and `margin` pixels around.

    None where it shows none of them.
    """
    window = _window(frame.camera, points, margin)
    if window is None:
        return None
    own = frame.colour is frame.camera
    shown = window if own else _window(frame.colour, points, margin)
    if shown is None:
        return None
    mask = None if frame.mask is None else frame.mask[shown]
    rgb = None if frame.rgb is None else frame.rgb[shown]
    camera = _within(frame.camera, window)
    none = None if frame.no_surface is None else frame.no_surface[window]
    colour = None if own else _within(frame.colour, shown)
    view = make_view(camera, frame.depth[window], mask, rgb, colour, no_surface=none)
    return replace(view, corner=(window[0].start, window[1].start))


def _every(camera: ViewCamera, step: int, size: tuple[int, ...]) -> ViewCamera:
    fx, fy, cx, cy = (value / step for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    return replace(camera, width=size[1], height=size[0], fx=fx, fy=fy, cx=cx, cy=cy)


def _within(camera: ViewCamera, window: tuple[slice, slice]) -> ViewCamera:
    rows, columns = window
    return replace(
        camera,
        width=columns.stop - columns.start,
        height=rows.stop - rows.start,
        cx=camera.cx - columns.start,
        cy=camera.cy - rows.start,
    )


def _window(camera: ViewCamera, points: Array, margin: int) -> tuple[slice, slice] | None:
    u, v, z = camera.project(points)
    there = z > 1e-6
    if not there.any():
        return None
    spans = []
    for at, size in ((v[there], camera.height), (u[there], camera.width)):
        low, high = int(np.clip(at.min() - margin, 0, size)), int(np.clip(at.max() + margin + 1, 0, size))
        spans.append(slice(low, high))
        if high - low < 2 * TUNING.normal_radius + 2:
            return None
    return spans[0], spans[1]


def near_edges(depth: Map, focal: float, reach: int = TUNING.edge_reach) -> Mask:
    """Return (h, w), where a jump in depth or a pixel without depth is within `reach` [pixel]."""
    far = np.where(depth > 0, depth, 0)
    box = np.ones((3, 3), np.uint8)
    highest, lowest = cv2.dilate(far, box), cv2.erode(far, box)
    limit = np.maximum(TUNING.edge_floor, TUNING.edge_jump * far / focal)
    jump = ((highest - lowest) > limit).astype(np.uint8)
    size = 2 * reach - 1
    return np.asarray(cv2.dilate(jump, np.ones((size, size), np.uint8)) > 0)


def _shared(depth: Map) -> Mask:
    """Return (h, w), where at least half of the eight neighbours have about the same depth."""
    alike = np.zeros(depth.shape, np.uint8)
    padded = np.pad(depth, 1)
    for row in range(3):
        for column in range(3):
            other = padded[row : row + depth.shape[0], column : column + depth.shape[1]]
            alike += np.abs(other - depth) < TUNING.edge_floor / 2
    return (alike >= 5) & (depth > 0)


def surface_normals(depth: Map, camera: ViewCamera, edge: Mask) -> Map:
    """Return (h, w, 3) normals in C towards the camera, 0 where too little of the neighbourhood is one surface.

    A plane seen by a pinhole has an inverse depth that is linear in u and v: 1/z = a u + b v + c, with its normal along
    (a fx, b fy, a cx + b cy + c). So the slopes of the inverse depth, by least squares over a window, give the normal.
    """
    good = ((depth > 0) & ~edge).astype(np.float64)
    inverse = np.where(good > 0, 1.0 / np.where(depth > 0, depth, 1.0), 0.0)
    reach = TUNING.normal_radius
    size = (2 * reach + 1, 2 * reach + 1)
    step = np.arange(-reach, reach + 1, dtype=float)
    one, ramp = np.ones_like(step), step

    def total(image: Array, along_u: Array, along_v: Array) -> Array:
        return np.asarray(cv2.sepFilter2D(image, cv2.CV_64F, along_u, along_v, borderType=cv2.BORDER_CONSTANT))

    n, su, sv = total(good, one, one), total(good, ramp, one), total(good, one, ramp)
    suu, svv, suv = total(good, ramp**2, one), total(good, one, ramp**2), total(good, ramp, ramp)
    w, wu, wv = total(inverse, one, one), total(inverse, ramp, one), total(inverse, one, ramp)
    safe = np.maximum(n, 1)
    cuu, cvv, cuv = suu - su * su / safe, svv - sv * sv / safe, suv - su * sv / safe
    bu, bv = wu - su * w / safe, wv - sv * w / safe
    determinant = cuu * cvv - cuv**2
    enough = (n >= 0.5 * size[0] * size[1]) & (good > 0) & (determinant > 1e-3 * safe**2)
    determinant = np.where(enough, determinant, 1.0)
    a, b = (cvv * bu - cuv * bv) / determinant, (cuu * bv - cuv * bu) / determinant
    c = (w - a * su - b * sv) / safe  # inverse depth of the plane at the pixel itself
    v, u = np.indices(depth.shape)
    normal = np.stack([a * camera.fx, b * camera.fy, c - a * (u - camera.cx) - b * (v - camera.cy)], axis=-1)
    normal = -normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    return np.where(enough[..., None], normal, 0).astype(np.float32)


def view_points(view: DepthView, stride: int, floor: float | None = 0.05) -> tuple[Array, Array, npt.NDArray[np.int64]]:
    """Return points (N, 3) and normals (N, 3) in W, and pixels (N, 2; row, column), where depth is trusted.

    Args:
        view: whose depth it is.
        stride: every so many rows and columns.
        floor: least trust; None: all that is not at an edge, normals of 0 among them.
    """
    good = (view.depth > 0) & ~view.near_edge if floor is None else view.trust > floor
    rows, columns = np.nonzero(good[::stride, ::stride])
    rows, columns = rows * stride, columns * stride
    z = view.depth[rows, columns].astype(float)
    c = view.camera
    p_C = np.stack([(columns - c.cx) / c.fx * z, (rows - c.cy) / c.fy * z, z], axis=1)
    points = p_C @ c.R_WC.T + c.p_WC
    return points, view.normals[rows, columns].astype(float) @ c.R_WC.T, np.stack([rows, columns], axis=1)
