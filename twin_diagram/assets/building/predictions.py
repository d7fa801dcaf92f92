"""VGGT's `predictions.npz` as frames: depth along each pixel from its point and its camera, scaled by a cube.

The file holds `world_points` (S, H, W, 3), `world_points_conf` (S, H, W), `extrinsic` (S, 3, 4) world-to-camera,
`intrinsic` (S, 3, 3) and `images` (S, 3, H, W) or (S, H, W, 3), in [0, 1] or bytes; its unit is arbitrary. Pickles in
it are never opened.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.building.cube_scale import Cube, measure_cube
from twin_diagram.assets.building.depth_view import make_view, view_points
from twin_diagram.assets.building.support_plane import find_plane
from twin_diagram.errors import FramesError
from twin_diagram.logs.frames.folder_files import numbered
from twin_diagram.logs.frames.scene_folder import RgbdFrame, read_mask
from twin_diagram.logs.frames.view_camera import ViewCamera
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of the reading."""

    doubtful: float = 0.15
    """Share of points, the least sure ones, that is left out."""

    rotation: float = 0.02
    """How far R Rᵀ of a predicted pose may be off the identity."""


TUNING = Tuning()
_NAMES = ("world_points", "world_points_conf", "extrinsic", "intrinsic", "images")
"""What the file must hold."""


@dataclass(frozen=True)
class PredictedFrames:
    """Frames of a prediction, in its own unit until `scaled`."""

    frames: tuple[RgbdFrame, ...]

    def __len__(self) -> int:
        return len(self.frames)

    def read(self, index: int) -> RgbdFrame:
        """Return a frame."""
        return self.frames[index]

    def masked(self, folder: str | Path) -> PredictedFrames:
        """Return the same with masks from a folder of images, one for each frame.

        Raises:
            FramesError: counts or sizes differ, or a mask is empty.
        """
        files = numbered(Path(folder), of_objects=True)
        if sorted(files) != list(range(len(self.frames))):
            raise FramesError(f"{folder}: {len(files)} masks, there are {len(self.frames)} frames, numbered from 0")
        return PredictedFrames(tuple(replace(f, mask=read_mask(files[f.number], f.depth.shape)) for f in self.frames))

    def scaled(self, factor: float, without: Cube | None = None) -> PredictedFrames:
        """Return the same with lengths times `factor`; `without` a cube, whose depth is left out."""
        made = []
        for f in self.frames:
            depth = f.depth if without is None else np.where(_held(f, without), 0, f.depth)
            camera = f.camera.moved(f.camera.R_WC, f.camera.p_WC * factor)
            made.append(RgbdFrame(f.number, f.time, f.rgb, (depth * factor).astype(np.float32), f.mask, camera, camera))
        return PredictedFrames(tuple(made))


def _held(frame: RgbdFrame, cube: Cube) -> npt.NDArray[np.bool_]:
    c = frame.camera
    points = c.rays() * frame.depth[..., None] @ c.R_WC.T + c.p_WC
    return cube.holds(points.reshape(-1, 3)).reshape(frame.depth.shape)


def read_predictions(path: str | Path) -> PredictedFrames:
    """Read a prediction.

    Raises:
        FramesError: no such file, a pickle, a name that is missing, or shapes or values that cannot be; the message
            names it.
    """
    path = Path(path)
    if not path.is_file():
        raise FramesError(f"{path}: no such file")
    try:
        with np.load(path, allow_pickle=False) as data:
            missing = [name for name in _NAMES if name not in data.files]
            if missing:
                raise FramesError(f"{path}: has no {missing[0]}")
            points, sure, extrinsic, intrinsic, images = (np.squeeze(np.asarray(data[name])) for name in _NAMES)
    except FramesError:
        raise
    except Exception as error:  # of zip files, of pickles, of headers
        raise FramesError(f"{path}: not readable as arrays ({error})") from None
    count, height, width = sure.shape if sure.ndim == 3 else (0, 0, 0)
    shapes = {"world_points": (points.shape, (count, height, width, 3)), "extrinsic": (extrinsic.shape, (count, 3, 4))}
    shapes |= {"intrinsic": (intrinsic.shape, (count, 3, 3))}
    for name, (now, due) in shapes.items():
        if now != due or not count:
            raise FramesError(f"{path}: {name} is {now}, with world_points_conf {sure.shape} it must be {due}")
    if images.shape == (count, 3, height, width):
        images = np.moveaxis(images, 1, -1)
    if images.shape != (count, height, width, 3):
        raise FramesError(f"{path}: images are {images.shape}, must be {(count, 3, height, width)}")
    for name, array in zip(_NAMES, (points, sure, extrinsic, intrinsic, images), strict=True):
        if array.dtype.kind not in "fui" or not np.isfinite(array).all():
            raise FramesError(f"{path}: {name} holds values that are no finite numbers")
    rgb = images if images.dtype == np.uint8 else np.round(255 * np.clip(images, 0, 1)).astype(np.uint8)
    floor = np.quantile(sure, TUNING.doubtful)
    frames = []
    for k in range(count):
        R, t = extrinsic[k, :, :3].astype(float), extrinsic[k, :, 3].astype(float)
        if np.abs(R @ R.T - np.eye(3)).max() > TUNING.rotation or np.linalg.det(R) < 0:
            raise FramesError(f"{path}: extrinsic {k} is no rotation")
        u, _, vt = np.linalg.svd(R)
        R = u @ vt
        K = intrinsic[k]
        if min(K[0, 0], K[1, 1]) <= 0:
            raise FramesError(f"{path}: intrinsic {k} has no positive focal length")
        camera = ViewCamera(
            width, height, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), R.T, -R.T @ t
        )
        depth = points[k].astype(float) @ R[2] + t[2]
        depth = np.where((sure[k] >= floor) & (depth > 0), depth, 0).astype(np.float32)
        frames.append(RgbdFrame(k, float(k), rgb[k], depth, None, camera, camera))
    return PredictedFrames(tuple(frames))


def metric(predicted: PredictedFrames, cube_edge: float, where: str) -> tuple[PredictedFrames, float]:
    """Return frames in metres without the cube of known edge [m], and the factor that made them so.

    Raises:
        FramesError: no support or no green cube.
    """
    # Judged in units of the scene's depth, since nothing is known of its own.
    unit = float(
        np.median(np.concatenate([f.depth[f.depth > 0][::50] for f in predicted.frames]) if len(predicted) else [0])
    )
    if not unit > 0:
        raise FramesError(f"{where}: no depth")
    about = predicted.scaled(0.6 / unit)
    points, normals, colours = scene_points(about)
    above = np.mean([f.camera.p_WC for f in about.frames], axis=0)
    rng = np.random.default_rng(0)
    some = rng.permutation(np.flatnonzero(np.linalg.norm(normals, axis=1) > 0.5))[:6000]
    plane = find_plane(points[some], normals[some], above)
    if plane is None:
        raise FramesError(f"{where}: no plane on which cube and object stand")
    cube = measure_cube(points, colours, plane, where)
    return about.scaled(cube_edge / cube.edge, cube), 0.6 / unit * cube_edge / cube.edge


def scene_points(frames: PredictedFrames) -> tuple[Array, Array, Array]:
    """Return points, normals and colours (N, 3) of all frames, in W."""
    found: list[tuple[Array, Array, Array]] = []
    for f in frames.frames:
        assert f.rgb is not None
        points, normals, pixels = view_points(make_view(f.camera, f.depth), 2, None)
        found.append((points, normals, f.rgb[pixels[:, 0], pixels[:, 1]] / 255.0))
    points, normals, colours = (np.concatenate([part[k] for part in found]) for k in range(3))
    return points, normals, colours
