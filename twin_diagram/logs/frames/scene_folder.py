"""Reads BOP scene folders: `rgb/` or `gray/`, `depth/`, `scene_camera.json`; masks and times where there are some.

The format is that of the BOP benchmark (https://github.com/thodan/bop_toolkit, docs/bop_datasets_format.md): `cam_K` by
rows [pixel], `depth_scale` (times a 16-bit pixel: mm), `cam_R_w2c` by rows and `cam_t_w2c` [mm]. Beside it stand
`times.json` (a list, or an object by frame number) [s] and `camera_extra.json`: see
`twin_diagram.logs.frames.extra_camera`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.errors import FramesError
from twin_diagram.logs.frames.extra_camera import ExtraCamera, read_extra
from twin_diagram.logs.frames.folder_files import below, depth_in_metres, in_folder, numbered, read_image, read_json
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.signals.arrays import Array

Image = npt.NDArray[np.uint8]
DepthMap = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Tuning:
    """What is taken for a slip of writing and what for an error."""

    rotation: float = 2e-3
    """How far R Rᵀ may be off the identity: printed with three digits it still passes, a wrong matrix does not."""

    nearest_world: float = 10.0
    """Cameras that are no farther from W's origin were told in metres, or all stand there [mm]."""

    longest_step: float = 10.0
    """Frames that are farther apart were told in ms, or are a time lapse's [s]."""

    most_masked: float = 0.5
    """A mask of a larger share of the picture, and of its four corners, is the background's: it is inverted."""


TUNING = Tuning()


@dataclass(frozen=True)
class RgbdFrame:
    """One frame.

    Attributes:
        number: as in the file names.
        time: [s]; the frame's place in the folder where there is no `times.json`.
        rgb: (h, w, 3), without distortion; of `gray/`, where there is no `rgb/`, three times the same; or None.
        depth: (h', w') along the optical axis [m]; 0 where there is none.
        mask: (h, w) where the object shows, or None.
        colour: the camera of `rgb` and `mask`.
        camera: that of `depth`; the same one where there is no `camera_extra.json`.
        no_surface: (h', w') where depth shows none of the object's surface, but rays pass as far: it is of something
            known, or nobody is sure of it; or None.
    """

    number: int
    time: float
    rgb: Image | None
    depth: DepthMap
    mask: Mask | None
    colour: ViewCamera
    camera: ViewCamera
    no_surface: Mask | None = None


class FrameFolder:
    """A folder of frames, checked as far as names and numbers go; a frame's images are read when its turn comes.

    Args:
        folder: the BOP scene.
        masks: folder of masks; None: its `mask_visib/`, where it has one.
        masked: whether masks are wanted: without, those of several objects, or of none, are passed over.

    Attributes:
        numbers: of the frames, ascending.
        times: of the frames, rising [s].
        timed: whether times are told.
        coloured: whether there is an `rgb/`.
        posed: whether the frames say where their cameras were; else W is the first camera's frame, and the camera
            stands.
        calibration: RMS errors of what is told of the cameras; None where that is not told.
        notes: what is said of the cameras and not read.
        has_masks: whether there are masks.

    Raises:
        FramesError: a file is missing, leads out of the folder, or says what cannot be; the message names file and
            value.
    """

    def __init__(self, folder: str | Path, masks: str | Path | None = None, *, masked: bool = True) -> None:
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise FramesError(f"{self.folder}: no such folder of frames")
        self._file = in_folder(self.folder, "scene_camera.json")
        self._cameras = _by_number(read_json(self._file), self._file)
        self.numbers = sorted(self._cameras)
        self._depth = self._files(below(self.folder, "depth"))
        rgb, own = below(self.folder, "rgb"), below(self.folder, "mask_visib")
        self.coloured = rgb.is_dir()
        pictures = rgb if self.coloured else below(self.folder, "gray")
        self._rgb = self._files(pictures) if pictures.is_dir() else {}
        chosen = Path(masks) if masks is not None else own if masked and own.is_dir() else None
        self._masks = {} if chosen is None else self._files(chosen, of_objects=True)
        self.has_masks = chosen is not None
        posed = {number for number, entry in self._cameras.items() if "cam_R_w2c" in entry or "cam_t_w2c" in entry}
        if posed and len(posed) < len(self.numbers):
            odd = next(number for number in self.numbers if number not in posed)
            raise FramesError(f"{self._file}: frame {odd} has no cam_R_w2c and cam_t_w2c, others have")
        self.posed = bool(posed)
        self._poses = {number: self._pose(number) for number in self.numbers}
        self._intrinsics = {number: self._matrix(number) for number in self.numbers}
        self.times = self._read_times()
        self._extra = read_extra(self.folder)
        told = self._extra.depth_scale
        self._scales = {number: self._scale(number) if told is None else told for number in self.numbers}
        self.calibration = self._extra.calibration
        self.notes = [f"{self._extra.file}: {name} is not read" for name in self._extra.unread] + self._other_units()
        self.notes += self._extra.other_unit(self._intrinsics[self.numbers[0]])
        self._sizes: dict[str, tuple[int, ...]] = {}

    def __len__(self) -> int:
        return len(self.numbers)

    def read(self, index: int) -> RgbdFrame:
        """Read the frame at a place in `numbers`.

        Raises:
            FramesError: an image cannot be read, has another size than those before it, or a mask is empty.
        """
        number = self.numbers[index]
        depth = self._depth_map(number)
        rgb = self._colour(number)
        mask = self._mask(number)
        sizes = {"depth": depth.shape}
        sizes |= {} if rgb is None else {"rgb": rgb.shape[:2]}
        sizes |= {} if mask is None else {"mask": mask.shape}
        for what, size in sizes.items():
            usual = self._sizes.setdefault(what, size)
            if size != usual:
                raise FramesError(
                    f"{self.folder}: frame {number}: {what} is {_said(size)}, before it was {_said(usual)}"
                )
        height, width = (depth if rgb is None else rgb).shape[:2]
        if mask is not None and mask.shape != (height, width):
            raise FramesError(f"{self._masks[number]}: {_said(mask.shape)}, the picture is {_said((height, width))}")
        if not self._extra.depth_apart and depth.shape != (height, width):
            raise FramesError(
                f"{self._depth[number]}: {_said(depth.shape)}, the picture is {_said((height, width))}; a depth "
                f"camera of "
                "its own is told in camera_extra.json"
            )
        fx, fy, cx, cy = self._intrinsics[number]
        colour = ViewCamera(width, height, fx, fy, cx, cy, *self._poses[number])
        extra: ExtraCamera = self._extra
        time = self.times[index]
        camera = extra.depth_camera(colour, depth.shape)
        return RgbdFrame(
            number,
            time,
            None if rgb is None else extra.straight(rgb, colour),
            extra.straight_depth(depth, camera),
            None if mask is None else extra.straight(mask.astype(np.uint8), colour) > 0,
            colour,
            camera,
        )

    def _files(self, folder: Path, of_objects: bool = False) -> dict[int, Path]:
        found = numbered(folder, of_objects)
        missing = [number for number in self.numbers if number not in found]
        beyond = [number for number in found if number not in self._cameras]
        if missing or beyond:
            odd = f"frame {missing[0]} is missing" if missing else f"frame {beyond[0]} is not in {self._file.name}"
            raise FramesError(f"{folder}: {len(found)} files, {self._file.name} has {len(self.numbers)}: {odd}")
        return found

    def _numbers(self, number: int, key: str, count: int) -> Array:
        entry = self._cameras[number]
        if key not in entry:
            raise FramesError(f"{self._file}: frame {number} has no {key}")
        try:
            values = np.array(entry[key], dtype=float).reshape(-1)
            if isinstance(entry[key], bool):
                raise TypeError
        except (TypeError, ValueError):
            raise FramesError(f"{self._file}: frame {number}: {key} is {entry[key]!r}, not numbers") from None
        if len(values) != count or not np.isfinite(values).all():
            raise FramesError(f"{self._file}: frame {number}: {key} must be {count} finite numbers, not {entry[key]}")
        return values

    def _matrix(self, number: int) -> tuple[float, float, float, float]:
        K = self._numbers(number, "cam_K", 9).reshape(3, 3)
        plain = np.allclose(K[[0, 1, 2, 2], [1, 0, 0, 1]], 0, atol=1e-6) and abs(K[2, 2] - 1) < 1e-6
        if not plain or K[0, 0] <= 0 or K[1, 1] <= 0:
            raise FramesError(
                f"{self._file}: frame {number}: cam_K must be [fx 0 cx 0 fy cy 0 0 1], not {K.ravel().tolist()}"
            )
        return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])

    def _scale(self, number: int) -> float:
        value = float(self._numbers(number, "depth_scale", 1)[0])
        if value <= 0:
            raise FramesError(f"{self._file}: frame {number}: depth_scale is {value:g}, must be positive [mm]")
        return value

    def _pose(self, number: int) -> tuple[Array, Array]:
        if not self.posed:
            return np.eye(3), np.zeros(3)
        R = self._numbers(number, "cam_R_w2c", 9).reshape(3, 3)
        off = float(np.abs(R @ R.T - np.eye(3)).max())
        if off > TUNING.rotation or np.linalg.det(R) < 0:
            why = f"R Rᵀ is {off:.3g} off the identity" if off > TUNING.rotation else "it is a reflection"
            raise FramesError(f"{self._file}: frame {number}: cam_R_w2c is no rotation: {why}")
        u, _, vt = np.linalg.svd(R)
        R = u @ vt
        return R.T, -R.T @ (self._numbers(number, "cam_t_w2c", 3) / 1000.0)

    def _read_times(self) -> list[float]:
        self.timed = (self.folder / "times.json").exists()
        if not self.timed:
            return [float(k) for k in range(len(self.numbers))]
        path = in_folder(self.folder, "times.json")
        raw: Any = read_json(path)
        if isinstance(raw, list):
            raw = dict(zip(map(str, self.numbers), raw, strict=False)) if len(raw) == len(self.numbers) else {}
        try:
            times = [float(raw[str(number)]) for number in self.numbers]
        except (KeyError, TypeError, ValueError) as error:
            odd = f": frame {error.args[0]} has none" if raw and isinstance(error, KeyError) else ""
            raise FramesError(f"{path}: must hold a time [s] for each of the {len(self.numbers)} frames{odd}") from None
        for number, before, time in zip(self.numbers, [-np.inf, *times], times, strict=False):
            if not before < time < np.inf:
                last = "" if before == -np.inf else f", the one before it at {before:g} s"
                raise FramesError(
                    f"{path}: frame {number} is at {time:g} s{last}: times must be finite and rise from frame to frame"
                )
        return times

    def _other_units(self) -> list[str]:
        """Return what is said of numbers that may be told in metres, or in milliseconds."""
        said: list[str] = []
        far = 1000.0 * max(float(np.linalg.norm(p)) for _, p in self._poses.values())
        if 0.0 < far < TUNING.nearest_world:
            said.append(f"{self._file}: cam_t_w2c is {far:.3g} mm long at most; is it in metres? It counts as mm")
        steps = np.diff(self.times)
        if self.timed and len(steps) and (usual := float(np.median(steps))) > TUNING.longest_step:
            said.append(f"{self.folder / 'times.json'}: frames are {usual:.3g} s apart; is it in ms? It counts as s")
        return said

    def _depth_map(self, number: int) -> DepthMap:
        path = self._depth[number]
        image = read_image(path, cv2.IMREAD_UNCHANGED)
        if image.dtype != np.uint16 or image.ndim != 2:
            raise FramesError(f"{path}: depth must be one channel of 16 bits, not {image.dtype} of shape {image.shape}")
        return depth_in_metres(image, self._scales[number] / 1000.0)

    def _colour(self, number: int) -> Image | None:
        if number not in self._rgb:
            return None
        return np.asarray(
            cv2.cvtColor(read_image(self._rgb[number], cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB), dtype=np.uint8
        )

    def _mask(self, number: int) -> Mask | None:
        return read_mask(self._masks[number]) if number in self._masks else None


def read_mask(path: Path, size: tuple[int, ...] | None = None) -> Mask:
    """Return (h, w), where an image is not black; of one that is cut out, where that is not transparent.

    Raises:
        FramesError: not readable, empty, full, inverted, or not of `size` (h, w) where one is told.
    """
    image = read_image(path, cv2.IMREAD_UNCHANGED)
    layers = image.reshape(*image.shape[:2], -1)
    if layers.shape[2] == 4 and np.ptp(layers[..., 3]) == 0:  # opaque all over
        layers = layers[..., :3]
    mask = layers.max(axis=-1) > 0
    if not mask.any():
        raise FramesError(f"{path}: the mask is empty; leave out frames that do not show the object")
    if mask.all():
        raise FramesError(f"{path}: the mask holds the whole picture; it must be black where the object is not")
    if mask[[0, 0, -1, -1], [0, -1, 0, -1]].all() and mask.mean() > TUNING.most_masked:
        raise FramesError(
            f"{path}: the mask holds {100 * mask.mean():.0f} % of the picture and its four corners; is it inverted? It "
            "must be black where the object is not"
        )
    if size is not None and mask.shape != size:
        raise FramesError(f"{path}: {_said(mask.shape)}, the picture is {_said(size)}")
    return np.asarray(mask)


def _said(size: tuple[int, ...]) -> str:
    return f"{size[1]} × {size[0]}"


def _by_number(raw: Any, path: Path) -> dict[int, dict[str, Any]]:
    good = isinstance(raw, dict) and raw and all(k.isdecimal() and isinstance(v, dict) for k, v in raw.items())
    if not good:
        raise FramesError(f"{path}: must hold an object per frame, by the frame's number")
    twice = [key for key in raw if key != str(int(key)) and str(int(key)) in raw]
    if twice:
        raise FramesError(f"{path}: frame {int(twice[0])} is there twice, as {twice[0]!r} too")
    return {int(key): value for key, value in raw.items()}
