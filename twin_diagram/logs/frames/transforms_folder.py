"""Reads and writes Nerfstudio's folders of posed frames: `transforms.json`, pictures, depth and masks.

(https://docs.nerf.studio/quickstart/data_conventions.html) Poses are camera to world with OpenGL's axes: x right, y up,
z backwards; here C is x right, y down, z forwards. There a pixel's centre lies at (u + 0.5, v + 0.5), here at (u, v).
Depth is 16 bits (0 and 65535: none) or floating point, also as `.npy`; its unit is `depth_unit_scale_factor` [m], a
millimetre where the file does not say. Where it has fewer pixels than its picture, as a telephone's lidar has, picture,
mask and lens come to its grid. What a lens bends (k1, k2, k3, p1, p2) is taken out. What was done to the poses after
they were measured (`applied_transform`, 3 × 4 or 4 × 4, and `applied_scale`) is undone: depth is in metres.

`hand_boxes` is this project's own: of each grasp, where the hand's frame was (`transform_matrix`, among the cameras'
poses) and the lowest and highest corners of boxes that the hand filled, in its frame [m].
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from twin_diagram.errors import FramesError
from twin_diagram.logs.frames.folder_files import depth_in_metres, in_folder, read_image, read_json
from twin_diagram.logs.frames.hand_boxes import Boxes
from twin_diagram.logs.frames.scene_folder import RgbdFrame, read_mask
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.runtime import atomic_file
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.between_pixels import depth_between
from twin_diagram.signals.lens import Lens, folds, straightening

FILE: Final = "transforms.json"
"""That makes a folder one of Nerfstudio's."""
UNIT: Final = 1e-4
"""Of the depth that is written [m]: a tenth of a millimetre, 6.5 m at the most."""
_BENDING: Final = ("k1", "k2", "p1", "p2", "k3")
"""Coefficients of distortion, in OpenCV's order; zero: the lens bends nothing."""
_LENSES: Final = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
"""Kinds of camera that these tell of."""
_SQUARE: Final = 0.01
"""Share by which a grid's two scales may differ where depth has another number of pixels than its picture."""
_FLIP: Final = np.diag([1.0, -1.0, -1.0])
"""Takes OpenGL's axes to those of C, and back."""


class TransformsFolder:
    """Posed frames as Nerfstudio has them, read one at a time.

    Attributes:
        has_masks: whether every frame has one.
        posed: they always are.
        hands: boxes that a hand filled, a grasp each; none where the file tells of none.

    Raises:
        FramesError: a file is missing, leads out of the folder, or says what cannot be; the message names it.
    """

    posed: Final = True

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self._file = in_folder(self.folder, FILE)
        self._all = read_json(self._file)
        if not isinstance(self._all, dict) or not isinstance(self._all.get("frames"), list) or not self._all["frames"]:
            raise FramesError(f"{self._file}: has no list of frames")
        self._frames: list[dict[str, Any]] = self._all["frames"]
        for k, frame in enumerate(self._frames):
            if not isinstance(frame, dict) or "depth_file_path" not in frame:
                raise FramesError(f"{self._file}: frame {k} has no depth_file_path: meshing needs depth")
        self.has_masks = self._check_masks()
        self._check_files()
        self._refuse_other_lenses()
        self._unit = self._number({}, "depth_unit_scale_factor", 1e-3)
        if not self._unit > 0.0:
            raise FramesError(f"{self._file}: depth_unit_scale_factor is {self._unit:g} m, not positive")
        self._undone = self._applied()
        self._poses = [self._pose(k) for k in range(len(self._frames))]
        self.hands = self._hand_boxes()

    def __len__(self) -> int:
        return len(self._frames)

    def read(self, index: int) -> RgbdFrame:
        """Read the frame at a place in the list.

        Raises:
            FramesError: an image cannot be read or has another size.
        """
        frame = self._frames[index]
        depth = self._depth(self.folder / str(frame["depth_file_path"]))
        size = depth.shape
        rgb = None
        if "file_path" in frame:
            picture = read_image(self.folder / str(frame["file_path"]), cv2.IMREAD_COLOR)
            rgb = _on_grid(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), size, cv2.INTER_AREA)
            if rgb is None:
                raise FramesError(f"{self.folder}: frame {index}: depth is of another size than its picture")
        mask = self._mask(self.folder / str(frame["mask_path"]), size) if self.has_masks else None
        lens = self._lens_on(index, size, size if rgb is None else picture.shape[:2])
        if lens.distortion:
            self._refuse_folded(lens, index)
            u, v = straightening(lens)
            depth = depth_between(depth, u, v)
            rgb = None if rgb is None else cv2.remap(rgb, u, v, cv2.INTER_LINEAR)
            mask = None if mask is None else cv2.remap(mask.astype(np.uint8), u, v, cv2.INTER_NEAREST) > 0
        camera = ViewCamera(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, *self._poses[index])
        colours = None if rgb is None else np.asarray(rgb, dtype=np.uint8)
        return RgbdFrame(index, float(index), colours, depth, mask, camera, camera)

    def _depth(self, path: Path) -> npt.NDArray[np.float32]:
        """Return depth (h, w) [m], 0 where there is none."""
        try:
            raw = np.load(path) if path.suffix == ".npy" else read_image(path, cv2.IMREAD_UNCHANGED)
        except (ValueError, OSError, EOFError):
            raise FramesError(f"{path}: not a readable array") from None
        if raw.ndim == 3 and raw.shape[2] == 1:
            raw = raw[..., 0]
        if raw.ndim != 2 or not (raw.dtype == np.uint16 or raw.dtype.kind == "f") or raw.size == 0:
            raise FramesError(f"{path}: depth must be one channel of 16 bits or of floating point")
        return depth_in_metres(raw, self._unit)

    def _mask(self, path: Path, size: tuple[int, ...]) -> npt.NDArray[np.bool_]:
        """Return a mask on depth's grid (h, w)."""
        mask = _on_grid(read_mask(path).astype(np.uint8), size, cv2.INTER_NEAREST)
        if mask is None:
            raise FramesError(f"{path}: the mask is of another size than depth")
        return mask > 0

    def _lens_on(self, index: int, size: tuple[int, ...], usual: tuple[int, ...]) -> Lens:
        """Return a frame's lens on depth's grid (h, w); `usual`: the size that it is told for where w and h are not."""
        frame, (height, width) = self._frames[index], size
        w, h = self._number(frame, "w", usual[1]), self._number(frame, "h", usual[0])
        if not (w > 0.0 and h > 0.0) or abs(width * h / (w * height) - 1.0) > _SQUARE:
            told = f"{width} × {height} pixels, w × h are {w:g} × {h:g}"
            raise FramesError(f"{self._file}: frame {index}: its depth has {told}")
        (fx, fy, cx, cy), (x, y) = self._lens(index), (width / w, height / h)
        bending = tuple(self._number(frame, key, 0.0) for key in _BENDING)
        return Lens(width, height, x * fx, y * fy, x * cx - 0.5, y * cy - 0.5, bending if any(bending) else ())

    def _check_masks(self) -> bool:
        """Return whether there are masks; raises FramesError where some frames have one, and others do not."""
        lacking = [k for k, frame in enumerate(self._frames) if "mask_path" not in frame]
        if 0 < len(lacking) < len(self._frames):
            raise FramesError(f"{self._file}: frame {lacking[0]} has no mask_path, others have")
        return not lacking

    def _check_files(self) -> None:
        """Raise FramesError where a file that is named is not there; before anything long is begun."""
        for k, frame in enumerate(self._frames):
            for key in ("depth_file_path", "file_path", "mask_path"):
                if key in frame:
                    if not isinstance(frame[key], str):
                        raise FramesError(f"{self._file}: frame {k}: {key} is {frame[key]!r}, not a file's name")
                    in_folder(self.folder, frame[key])

    def _lens(self, number: int) -> tuple[float, float, float, float]:
        """Return focal lengths and principal point of a frame, as they stand in the file [pixel]."""
        frame = self._frames[number]
        fx, cx, cy = (self._number(frame, key) for key in ("fl_x", "cx", "cy"))
        fy = self._number(frame, "fl_y", fx)
        if not (fx > 0.0 and fy > 0.0):
            raise FramesError(f"{self._file}: frame {number}: fl_x and fl_y are {fx:g} and {fy:g}, not positive")
        return fx, fy, cx, cy

    def _applied(self) -> tuple[Array, float]:
        """Return the inverse (4, 4) of what was applied to the poses, and by what they were scaled."""
        scale = self._number({}, "applied_scale", 1.0)
        if not scale > 0.0:
            raise FramesError(f"{self._file}: applied_scale is {scale:g}, not positive")
        X = np.eye(4)
        if self._all.get("applied_transform") is not None:
            try:
                told = np.array(self._all["applied_transform"], dtype=float)
            except (TypeError, ValueError):
                told = np.zeros(0)
            if told.shape not in ((3, 4), (4, 4)):
                raise FramesError(f"{self._file}: applied_transform is not 3 × 4")
            X[: len(told)] = told
        if not _is_rigid(X):
            raise FramesError(f"{self._file}: applied_transform holds no rotation")
        return np.asarray(np.linalg.inv(X), dtype=float), scale

    def _refuse_other_lenses(self) -> None:
        """Raise FramesError where a frame, or what holds for all, tells of a lens that is not OpenCV's usual one."""
        for where, frame in [("", {}), *((f"frame {k}: ", frame) for k, frame in enumerate(self._frames))]:
            model = str(frame.get("camera_model", self._all.get("camera_model", "OPENCV")))
            for key in _BENDING:
                self._number(frame, key, 0.0)
            if model not in _LENSES or self._number(frame, "k4", 0.0) != 0.0:
                what = f"camera_model {model}" if model not in _LENSES else "distortion k4"
                raise FramesError(f"{self._file}: {where}{what}: only lenses with {', '.join(_BENDING)} are read")

    def _refuse_folded(self, lens: Lens, index: int) -> None:
        """Raise FramesError where a lens would show some place twice: no lens bends so much."""
        if folds(lens):
            told = ", ".join(f"{k:g}" for k in lens.distortion)
            raise FramesError(f"{self._file}: frame {index}: distortion {told} folds the picture over")

    def _number(self, frame: dict[str, Any], key: str, usual: float | None = None) -> float:
        value = frame.get(key, self._all.get(key, usual))
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < np.inf:
            raise FramesError(f"{self._file}: {key} is {value!r}, not a number")
        return float(value)

    def _pose(self, number: int) -> tuple[Array, Array]:
        X = self._metric(self._frames[number], f"frame {number}")
        self._lens(number)
        u, _, vt = np.linalg.svd(X[:3, :3] @ _FLIP)
        return u @ vt, X[:3, 3]

    def _metric(self, told: Any, what: str) -> Array:
        """Return the pose (4, 4) that something in the file tells, with what was applied to it undone."""
        try:
            X = np.array(told["transform_matrix"], dtype=float).reshape(4, 4)
        except (KeyError, TypeError, ValueError):
            raise FramesError(f"{self._file}: {what} has no transform_matrix of 4 × 4") from None
        if not _is_rigid(X):
            raise FramesError(f"{self._file}: {what}: transform_matrix holds no rotation")
        undo, scale = self._undone
        X[:3, 3] /= scale
        return np.asarray(undo @ X)

    def _hand_boxes(self) -> list[Boxes]:
        """Return the boxes that a hand filled, by grasps."""
        told, found = self._all.get("hand_boxes", []), []
        if not isinstance(told, list):
            raise FramesError(f"{self._file}: hand_boxes is no list")
        for k, one in enumerate(told):
            X = self._metric(one, f"hand_boxes {k}")
            try:
                low, high = (np.array(one[key], dtype=float).reshape(-1, 3) for key in ("low", "high"))
            except (KeyError, TypeError, ValueError):
                raise FramesError(f"{self._file}: hand_boxes {k} has no low and high of three numbers a box") from None
            if low.shape != high.shape or not np.isfinite([low, high]).all():
                raise FramesError(f"{self._file}: hand_boxes {k}: low and high are not corners of boxes")
            found.append(Boxes(X, low, high))
        return found


def _on_grid(image: npt.NDArray[Any], size: tuple[int, ...], how: int) -> npt.NDArray[Any] | None:
    """Return an image with the pixels (h, w) of a grid; None: it shows another part of the world than the grid does."""
    height, width = image.shape[:2]
    if (height, width) == size:
        return image
    if abs(width * size[0] / (height * size[1]) - 1.0) > _SQUARE:
        return None
    return np.asarray(cv2.resize(image, (size[1], size[0]), interpolation=how))


def _is_rigid(X: Array) -> bool:
    """Return whether a matrix (4, 4) turns and shifts, and does nothing else."""
    if not np.isfinite(X).all() or np.abs(X[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6:
        return False
    R = X[:3, :3]
    return bool(np.abs(R @ R.T - np.eye(3)).max() <= 2e-3 and np.linalg.det(R) > 0)


def write_transforms(
    folder: str | Path,
    frames: Sequence[RgbdFrame],
    hands: Sequence[npt.NDArray[np.bool_]] | None = None,
    boxes: Sequence[Boxes] = (),
) -> Path:
    """Write posed frames as Nerfstudio reads them, whole or not at all. Returns the folder.

    Args:
        folder: is replaced.
        frames: of one lens, with colours, without distortion; the grids of depth and colours are one.
        hands: (h, w) masks of the hand that holds the object, under `hand_mask_path`: what others leave out.
        boxes: that the hand filled, a grasp each.

    Raises:
        FramesError: frames without colours.
    """
    folder = Path(folder)
    first = frames[0].camera
    listed: list[dict[str, Any]] = []
    with atomic_file.folder(folder) as aside:
        for name in ("images", "depth", "masks", "hands"):
            (aside / name).mkdir()
        for k, frame in enumerate(frames):
            if frame.rgb is None:
                raise FramesError(f"frame {k} has no colours to write")
            one = {"file_path": f"images/{k:04d}.png", "depth_file_path": f"depth/{k:04d}.png"}
            _write(aside / one["file_path"], cv2.cvtColor(frame.rgb, cv2.COLOR_RGB2BGR))
            depth = np.where(np.isfinite(frame.depth), frame.depth, 0.0)
            _write(aside / one["depth_file_path"], np.clip(np.rint(depth / UNIT), 0, 65535).astype(np.uint16))
            if frame.mask is not None:
                one["mask_path"] = f"masks/{k:04d}.png"
                _write(aside / one["mask_path"], frame.mask.astype(np.uint8) * 255)
            if hands is not None:
                one["hand_mask_path"] = f"hands/{k:04d}.png"
                _write(aside / one["hand_mask_path"], hands[k].astype(np.uint8) * 255)
            X = np.eye(4)
            X[:3, :3], X[:3, 3] = frame.camera.R_WC @ _FLIP, frame.camera.p_WC
            listed.append({**one, "transform_matrix": X.tolist()})
        told = {
            "camera_model": "OPENCV",
            **{"w": first.width, "h": first.height, "fl_x": first.fx, "fl_y": first.fy},
            **{"cx": first.cx + 0.5, "cy": first.cy + 0.5, "depth_unit_scale_factor": UNIT},
            "frames": listed,
        }
        if boxes:
            told["hand_boxes"] = [
                {"transform_matrix": one.X_ST.tolist(), "low": one.low.tolist(), "high": one.high.tolist()}
                for one in boxes
            ]
        (aside / FILE).write_text(json.dumps(told, indent=1))
    return folder


def _write(path: Path, image: npt.NDArray[Any]) -> None:
    good, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    assert good
    path.write_bytes(data.tobytes())
