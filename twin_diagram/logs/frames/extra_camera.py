"""What `camera_extra.json` adds to a BOP scene: distortion, a depth camera of its own, how well it is calibrated.

`{"distortion": [k1, k2, p1, p2, k3], "lens": "brown", "depth_camera": {"cam_K": [9 numbers], "distortion": […], "lens":
…, "R_CD": [9 numbers], "t_CD": [3 numbers, mm], "depth_scale": mm}, "calibration_std": {"position": mm, "rotation":
rad, "focal": share, "centre": px, "depth_scale": share}}`, all optional; distortion as OpenCV has it: of a `brown` lens
4, 5 or 8 (rational) coefficients, of a `fisheye` k1 to k4. D is the depth camera's optical frame, C that of the colour
camera. The depth camera's own `depth_scale` goes before that of `scene_camera.json`. Other names are told and
passed over, but for those that may be a slip of writing.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.errors import FramesError
from twin_diagram.logs.frames.folder_files import in_folder, read_json
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.between_pixels import depth_between
from twin_diagram.signals.calibration_error import CalibrationError
from twin_diagram.signals.lens import TUNING as LENSES
from twin_diagram.signals.lens import Lens, Map, folds, straightening

METRES = (1e-6, 5e-4)
"""Cameras in one housing stand 5 to 500 mm apart, which told in metres counts as so little [m], …"""

ONE_LENS = (0.005, 0.05)
"""… unless both are one sensor's: they look the same way, to this [rad], through lenses alike to such a share. Two in
one housing are turned by as much, or have lenses of their own: a D435's differ by half. A D405's depth camera, which
is the one that colours are of, is told to be 0.01 mm from it."""


@dataclass(frozen=True)
class ExtraCamera:
    """Distortion of both cameras, (n,) or empty, whether they are fisheyes, and the depth camera's (fx, fy, cx, cy).

    R_CD and p_CD [m] where it is apart. `depth_scale`: its own [mm], or None. `calibration`: how well all that is
    known; None where it is not told. `file`: that says so. `unread`: names in it that nothing is done about.
    """

    distortion: Array
    depth_distortion: Array
    depth_apart: bool = False
    depth_K: tuple[float, float, float, float] = (1.0, 1.0, 0.0, 0.0)
    R_CD: Array | None = None
    p_CD: Array | None = None
    depth_scale: float | None = None
    calibration: CalibrationError | None = None
    file: Path = Path("camera_extra.json")
    fisheyes: tuple[bool, bool] = (False, False)
    unread: tuple[str, ...] = ()

    def depth_camera(self, colour: ViewCamera, size: tuple[int, ...]) -> ViewCamera:
        """Return the camera of a depth image of `size` (h, w) beside that of the colour image."""
        if not self.depth_apart or self.R_CD is None or self.p_CD is None:
            return colour
        R_WD, p_WD = colour.R_WC @ self.R_CD, colour.p_WC + colour.R_WC @ self.p_CD
        return ViewCamera(size[1], size[0], *self.depth_K, R_WD, p_WD)

    def other_unit(self, colour: tuple[float, float, float, float]) -> list[str]:
        """Return what is said of a place that may be told in metres, beside a colour camera (fx, fy, cx, cy).

        Raises:
            FramesError: it is so, unless one sensor sees both.
        """
        long = 0.0 if self.p_CD is None else float(np.linalg.norm(self.p_CD))
        if self.R_CD is None or not METRES[0] < long < METRES[1]:
            return []
        said = f"{self.file}: depth_camera: t_CD is {1000 * long:.3g} mm long; is it in metres? It "
        turned = np.arccos(np.clip((np.trace(self.R_CD) - 1.0) / 2.0, -1.0, 1.0))
        fx, fy, cx, cy = np.divide(self.depth_K, np.maximum(colour, 1e-9))
        lenses = np.abs(np.divide([fx, fy], np.maximum([cx, cy], 1e-9)) - 1.0)  # whatever the pictures' sizes
        if turned > ONE_LENS[0] or lenses.max() > ONE_LENS[1]:
            raise FramesError(f"{said}must be in mm")
        return [f"{said}counts as mm"]

    def straight(self, image: npt.NDArray[np.uint8], camera: ViewCamera) -> npt.NDArray[np.uint8]:
        """Return an image, or a mask, as the camera would have taken it without distortion.

        Raises:
            FramesError: the distortion is none that a lens has.
        """
        places = self._places(camera, self.distortion, self.fisheyes[0])
        how = cv2.INTER_LINEAR if image.ndim == 3 else cv2.INTER_NEAREST
        return image if places is None else np.asarray(cv2.remap(image, *places, how), np.uint8)

    def straight_depth(self, depth: npt.NDArray[np.float32], camera: ViewCamera) -> npt.NDArray[np.float32]:
        """Return depth without distortion: each pixel that of the surface there, never a mean across an edge.

        Raises:
            FramesError: as of `straight`.
        """
        distortion = self.depth_distortion if self.depth_apart else self.distortion
        places = self._places(camera, distortion, self.fisheyes[1 if self.depth_apart else 0])
        return depth if places is None else depth_between(depth, *places)

    def _places(self, camera: ViewCamera, distortion: Array, fisheye: bool) -> tuple[Map, Map] | None:
        """Return where a camera shows what it would show straight; None where it bends nothing, which no fisheye does.

        Raises:
            FramesError: it would show some place twice.
        """
        if not fisheye and not distortion.any():
            return None
        bending = tuple(map(float, distortion))
        own = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        if fisheye or len(bending) > 5:
            places = _opencv_places(Lens(*own), bending, fisheye)
            folded = min(np.diff(places[0], axis=1).min(), np.diff(places[1], axis=0).min()) < LENSES.folded
        else:
            lens = Lens(*own, (*bending, 0.0)[:5])
            folded = folds(lens)
            places = straightening(lens)
        if folded:
            told = ", ".join(f"{k:g}" for k in distortion)
            raise FramesError(f"{self.file}: distortion {told} folds the picture over")
        return places


@lru_cache(maxsize=8)
def _opencv_places(straight: Lens, distortion: tuple[float, ...], fisheye: bool) -> tuple[Map, Map]:
    """Return what `straightening` does, of a rational lens or of a fisheye."""
    K = np.array([[straight.fx, 0.0, straight.cx], [0.0, straight.fy, straight.cy], [0.0, 0.0, 1.0]])
    told = np.array(distortion or (0.0,) * 4)
    make = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
    u, v = make(K, told, np.eye(3), K, (straight.width, straight.height), cv2.CV_32FC1)
    return np.asarray(u, np.float32), np.asarray(v, np.float32)


def read_extra(folder: Path) -> ExtraCamera:
    """Return what `folder / camera_extra.json` says; no distortion and one camera where there is none.

    Raises:
        FramesError: a value is not of its kind; the message names it.
    """
    if not (folder / "camera_extra.json").exists():
        return ExtraCamera(np.zeros(0), np.zeros(0))
    path = in_folder(folder, "camera_extra.json")
    raw = read_json(path)
    own = raw.get("depth_camera") if isinstance(raw, dict) else None
    if not isinstance(raw, dict) or not (own is None or isinstance(own, dict)):
        raise FramesError(f"{path}: must hold an object with distortion and depth_camera")
    unread = _others(raw, _KEYS, path)
    distortion, fisheye = _distortion(raw, path)
    calibration = _calibration(raw, path)
    if own is None:
        return ExtraCamera(
            distortion, distortion, calibration=calibration, file=path, fisheyes=(fisheye, fisheye), unread=unread
        )
    unread += _others(own, _DEPTH_KEYS, path)
    K = _list(own, "cam_K", (9,), path).reshape(3, 3)
    if not np.allclose(K[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]], [0, 0, 0, 0, 1], atol=1e-6):
        raise FramesError(f"{path}: depth_camera: cam_K must be [fx 0 cx 0 fy cy 0 0 1], not {K.ravel().tolist()}")
    R = _list(own, "R_CD", (9,), path).reshape(3, 3) if "R_CD" in own else np.eye(3)
    if np.abs(R @ R.T - np.eye(3)).max() > 2e-3 or np.linalg.det(R) < 0 or min(K[0, 0], K[1, 1]) <= 0:
        raise FramesError(f"{path}: depth_camera: R_CD must be a rotation and cam_K have positive focal lengths")
    p = _list(own, "t_CD", (3,), path) / 1000.0 if "t_CD" in own else np.zeros(3)
    intrinsics = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    scale = float(_list(own, "depth_scale", (1,), path)[0]) if "depth_scale" in own else None
    if scale is not None and scale <= 0:
        raise FramesError(f"{path}: depth_camera: depth_scale is {scale:g}, must be positive [mm]")
    bent, other = _distortion(own, path)
    return ExtraCamera(distortion, bent, True, intrinsics, R, p, scale, calibration, path, (fisheye, other), unread)


_KEYS = ("distortion", "lens", "depth_camera", "calibration_std")
"""What is read of the file, …"""
_DEPTH_KEYS = ("cam_K", "distortion", "lens", "R_CD", "t_CD", "depth_scale")
"""… and of the depth camera in it."""


_OTHER_LENS = re.compile(r"dist(?!anc)|coeff|d$|[kp][1-6]$", re.IGNORECASE)
"""Names that other programs give to distortion, or to its numbers."""


def _others(told: dict[str, Any], known: tuple[str, ...], path: Path) -> tuple[str, ...]:
    """Return what is not read, such as a camera's name.

    Raises:
        FramesError: one is nearly a name that is read, or tells a lens by another name: it would count as done.
    """
    others = [key for key in told if key not in known]
    for key in others:
        if "model" in key or _OTHER_LENS.match(key) or get_close_matches(key, known, 1):
            where = path if known is _KEYS else f"{path}: depth_camera"
            raise FramesError(f"{where}: {key} is not read; what is: {', '.join(known)}")
    return tuple(others)


_COEFFICIENTS = {"brown": (0, 4, 5, 8), "fisheye": (4,)}
"""Of each kind of lens, how many there may be."""


def _distortion(told: dict[str, Any], path: Path) -> tuple[Array, bool]:
    """Return a camera's distortion, and whether it is a fisheye's."""
    kind = told.get("lens", "brown")
    if not isinstance(kind, str) or kind not in _COEFFICIENTS:
        raise FramesError(f"{path}: lens is {kind!r}; must be {' or '.join(_COEFFICIENTS)}")
    return _list(told, "distortion", _COEFFICIENTS[kind], path), kind == "fisheye"


_STD = ("position", "rotation", "focal", "centre", "depth_scale")
"""Names in `calibration_std`, in the order of `CalibrationError`."""


def _calibration(raw: dict[str, Any], path: Path) -> CalibrationError | None:
    """Return the RMS errors of a calibration, what is not named being exact."""
    if "calibration_std" not in raw:
        return None
    told = raw["calibration_std"]
    if not isinstance(told, dict) or set(told) - set(_STD):
        raise FramesError(f"{path}: calibration_std must hold {', '.join(_STD)}, not {told}")
    values = [float(_list(told, key, (1,), path)[0]) if key in told else 0.0 for key in _STD]
    if min(values) < 0.0:
        raise FramesError(f"{path}: calibration_std: {_STD[values.index(min(values))]} is negative: {min(values):g}")
    return CalibrationError(values[0] / 1000.0, *values[1:])


def _list(raw: dict[str, Any], key: str, counts: tuple[int, ...], path: Path) -> Array:
    try:
        values = np.array(raw.get(key, []), dtype=float).reshape(-1)
    except (TypeError, ValueError):
        values = np.array([np.nan])
    if len(values) not in counts or not np.isfinite(values).all():
        raise FramesError(f"{path}: {key} must be {' or '.join(map(str, counts))} finite numbers, not {raw.get(key)}")
    return values
