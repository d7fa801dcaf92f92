"""Finds where a camera truly stands, by what it shows of table, bins and platform, whose places are told.

A picture's pixels are held against the faces that the camera, as told, should see there; `perception.calibration` tells
from their distances to those faces by what the camera is off. Pixels near the border between two faces, of another
slant, or far off their face may be the arm's, an object's, or nobody's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from twin_diagram.assets.building.depth_view import make_view
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.perception.calibration import KnownSurface, calibrate
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.planning.collision.convex_solids import Box, Solid
from twin_diagram.runs.learning.cell import Cell, Picture, told_camera
from twin_diagram.scenario import Camera, Learning
from twin_diagram.scenario.lenses import calibration_error
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import CalibrationError


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    stride: int = 2
    """Every n-th pixel in each direction is looked at."""

    borders: tuple[int, ...] = (6, 3, 2)
    """So many of these from where another face begins do not count, each time that the camera is corrected: by 0.3° and
    5 mm it shows them 7 pixels aside, of 640 a row. Walls that are seen from above are 15 pixels wide."""

    off: float = 0.02
    """A point farther from its face is another thing's [m]."""

    slant: float = 0.95
    """Least cosine between a point's normal and its face's: 18°."""

    least: int = 200
    """Points without which nothing is told."""


TUNING = Tuning()


@dataclass(frozen=True)
class KnownFaces:
    """Rectangles in W that do not move: middles, outward normals, both directions along them (F, 3), half sizes (F, 2).

    Attributes:
        middle: (F, 3) [m].
        normal: (F, 3).
        along: (F, 2, 3) unit vectors.
        half: (F, 2) [m].
    """

    middle: Array
    normal: Array
    along: Array
    half: Array

    @staticmethod
    def of(solids: Sequence[Solid]) -> KnownFaces:
        """Return the faces of all boxes among some solids in W."""
        rows: list[tuple[Array, Array, Array, Array]] = []
        for box in (solid for solid in solids if isinstance(solid, Box)):
            for axis in range(3):
                a, b = (axis + 1) % 3, (axis + 2) % 3
                for sign in (1.0, -1.0):
                    normal = sign * box.R_GB[:, axis]
                    along = np.stack([box.R_GB[:, a], box.R_GB[:, b]])
                    rows.append((box.p_GB + box.half[axis] * normal, normal, along, box.half[[a, b]]))
        if not rows:
            return KnownFaces(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2, 3)), np.zeros((0, 2)))
        middle, normal, along, half = (np.array(column) for column in zip(*rows, strict=True))
        return KnownFaces(middle, normal, along, half)

    def hit(self, eye: Array, rays: Array) -> tuple[npt.NDArray[np.int64], Array]:
        """Return which face rays (N, 3) from an eye (3,) meet first (N,), -1: none, and how many rays away (N,)."""
        which, nearest = np.full(len(rays), -1), np.full(len(rays), np.inf)
        for k in range(len(self.middle)):
            towards = rays @ self.normal[k]
            with np.errstate(divide="ignore", invalid="ignore"):
                far = float((self.middle[k] - eye) @ self.normal[k]) / towards
            there = (towards < -1e-9) & (far > 0.0) & (far < nearest)
            some = np.flatnonzero(there)
            at = eye + far[some, None] * rays[some] - self.middle[k]
            inside = np.abs(at @ self.along[k].T) <= self.half[k]
            some = some[inside[:, 0] & inside[:, 1]]
            which[some], nearest[some] = k, far[some]
        return which, nearest


@dataclass(frozen=True)
class Correction:
    """What was found of a camera.

    Attributes:
        camera: as it stands.
        depth: what its depth is to be multiplied by.
        shift: by how much it is off what was told [m].
        turn: the same [rad].
        points: how many told it.
    """

    camera: ViewCamera
    depth: float
    shift: float
    turn: float
    points: int


def correct_cameras(
    cell: Cell, learning: Learning, cameras: Mapping[str, Camera], faces: KnownFaces
) -> list[dict[str, str | float]]:
    """Have a cell see by where its cameras truly stand; return how far each is off what was told.

    Args:
        cell: whose arm is out of the way.
        learning: which cameras are used.
        cameras: as told, by name.
        faces: of what stands still.
    """
    told: list[dict[str, str | float]] = []
    for name in dict.fromkeys((learning.bin_camera, learning.scan_camera)):
        found = check_camera(cameras[name], cell.look(name), faces)
        if found is not None:
            cell.correct(name, found.camera, found.depth)
            degrees = round(float(np.rad2deg(found.turn)), 3)
            told.append({"camera": name, "off_mm": round(1e3 * found.shift, 2), "off_deg": degrees})
    return told


def check_camera(told: Camera, picture: Picture, faces: KnownFaces) -> Correction | None:
    """Return where a camera stands by one picture; None: the picture shows too little that is known.

    Args:
        told: the camera as its calibration has it, with what is told of its errors.
        picture: that it took, in the camera as told.
        faces: in W.
    """
    errors, pinhole, view = calibration_error(told), _pinhole(told), told_camera(told)
    if errors == CalibrationError():
        return None
    camera, depth, points = view, 1.0, 0
    for border in TUNING.borders:
        surfaces = known_surfaces(
            camera, picture.depth.astype(float), depth, faces, max(1, round(border * view.width / 640))
        )
        points = sum(len(one.depth) for one in surfaces)
        if points < TUNING.least:
            return None
        found, depth = calibrate(surfaces, pinhole, errors).corrected(pinhole)
        cx, cy = found.centre
        camera = replace(view, fx=found.fx, fy=found.fy, cx=cx, cy=cy, R_WC=found.R_WC, p_WC=found.p_WC)
    turn = float(np.arccos(np.clip((np.trace(view.R_WC.T @ camera.R_WC) - 1.0) / 2.0, -1.0, 1.0)))
    return Correction(camera, depth, float(np.linalg.norm(camera.p_WC - view.p_WC)), turn, points)


def known_surfaces(
    camera: ViewCamera, depth: Array, scale: float, faces: KnownFaces, border: int
) -> list[KnownSurface]:
    """Return what a picture shows of each face, by pixels that can be of no other.

    Args:
        camera: that took it, as far as it is known.
        depth: (H, W) as delivered [m], 0 where none is.
        scale: what it is to be multiplied by.
        faces: in W.
        border: pixels that are left out where another face begins, `stride` of the picture's each.
    """
    if not len(faces.middle):
        return []
    step, seen = slice(None, None, TUNING.stride), depth * scale
    rays = (camera.rays()[step, step] @ camera.R_WC.T).reshape(-1, 3)
    which, far = faces.hit(camera.p_WC, rays)
    thin = seen[step, step]
    label, width = which.reshape(thin.shape), 2 * border + 1
    inner = ndimage.minimum_filter(label, width) == ndimage.maximum_filter(label, width)
    normals = make_view(camera, seen.astype(np.float32), reach=1).normals[step, step] @ camera.R_WC.T
    towards = np.abs(np.einsum("ni,ni->n", rays, faces.normal[which])).reshape(thin.shape)
    off = np.abs(thin - far.reshape(thin.shape)) * towards
    # What is seen at a grazing angle, as walls from above, has no normal in a picture.
    alike = np.einsum("hwi,hwi->hw", normals, faces.normal[label]) > TUNING.slant
    alike |= np.linalg.norm(normals, axis=-1) < 0.5
    good = inner & (label >= 0) & (thin > 0) & (off < TUNING.off) & alike
    found = []
    for k in np.unique(label[good]):
        rows = np.argwhere(good & (label == k))
        pixels = TUNING.stride * rows[:, ::-1].astype(float)
        own = depth[step, step][rows[:, 0], rows[:, 1]].astype(float)
        plane = _Plane(faces.middle[k], faces.normal[k])
        found.append(KnownSurface(pixels, own, plane, stride=TUNING.stride, body=int(k)))
    return found


@dataclass(frozen=True)
class _Plane:
    """The plane through a point (3,) with a normal (3,)."""

    point: Array
    normal: Array

    def __call__(self, points: Array) -> tuple[Array, Array]:
        """Return the nearest points (N, 3) of the plane to some, and its normals there."""
        off = (points - self.point) @ self.normal
        return points - off[:, None] * self.normal, np.broadcast_to(self.normal, points.shape)


def _pinhole(told: Camera) -> Pinhole:
    """Return a camera as told, on the colours' grid and without distortion."""
    pinhole = Pinhole.from_scenario(told)
    return replace(pinhole, lens=pinhole.optics.straight)
