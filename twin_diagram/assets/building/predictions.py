"""VGGT's `predictions.npz` as frames: depth along each pixel from its point and its camera, scaled by a cube.

The file holds `world_points` (S, H, W, 3), `world_points_conf` (S, H, W), `extrinsic` (S, 3, 4), or whole (S, 4, 4),
world-to-camera, `intrinsic` (S, 3, 3) and `images` (S, 3, H, W) or (S, H, W, 3), in [0, 1] or whole numbers up to 255;
its unit is arbitrary. A batch's axis of length 1 may come before. Pickles in it are never opened.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from twin_diagram.assets.building.cube_faces import fit_cube
from twin_diagram.assets.building.cube_scale import Cube, is_green, rough_cubes
from twin_diagram.assets.building.depth_view import DepthView, Map, make_view, view_points
from twin_diagram.assets.building.levelling import LevelViews, levelled, surfaces_agree
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

    least_points: int = 100
    """Fewer points tell nothing of a lens."""

    projected: float = 1.5
    """How far from its pixel the median point may be projected by what is told of a camera [pixel]; networks' points
    and cameras agree to less."""

    held: float = 1.06
    """How much larger than it is the cube is taken to be: what is in there is none of the object's, …"""

    held_green: float = 1.4
    """… nor what is green in there."""

    first_depth: float = 0.6
    """What the median depth is taken for until the cube tells [m]."""

    nearest: float = 0.02
    """Depth below which there is none, as a share of the median one: what a network leaves out may lie at its lens."""

    bright: float = 0.5
    """How far beyond [0, 1] images of real numbers may reach: resizing overshoots at edges by less than half; what is
    in another unit, such as 0 to 255, by more."""

    rotation: float = 0.02
    """How far R Rᵀ of a predicted pose may be off the identity."""

    elsewhere: float = 0.015
    """Where half of the points lie farther from their pixels than this share of the width, whatever the lens,
    poses may be told another way: …"""

    clearly: float = 0.25
    """… that is so if they lie nearer by this factor then."""

    thin: int = 400
    """Points of a view that are projected for that."""


TUNING = Tuning()
_NAMES = {"world_points": 4, "world_points_conf": 3, "extrinsic": 3, "intrinsic": 3, "images": 4}
"""What the file must hold, and how many axes each has."""


@dataclass(frozen=True)
class PredictedFrames:
    """Frames of a prediction, in its own unit until `scaled`.

    Attributes:
        frames: with depth where the network is sure of it.
        unsure: of each frame (h, w), depth where it is not, else 0: no surface is taken from it, but rays pass as far.
    """

    frames: tuple[RgbdFrame, ...]
    unsure: tuple[Map, ...]

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
        masked = tuple(replace(f, mask=read_mask(files[f.number], f.depth.shape)) for f in self.frames)
        return replace(self, frames=masked)

    def scaled(self, factor: float) -> PredictedFrames:
        """Return the same with lengths times `factor`."""
        made = []
        for f in self.frames:
            camera = f.camera.moved(f.camera.R_WC, f.camera.p_WC * factor)
            made.append(replace(f, depth=(f.depth * factor).astype(np.float32), colour=camera, camera=camera))
        return PredictedFrames(tuple(made), tuple((one * factor).astype(np.float32) for one in self.unsure))

    def without(self, cube: Cube) -> PredictedFrames:
        """Return the same with it said where the cube is seen."""
        return replace(self, frames=tuple(replace(f, no_surface=_shows(f, cube)) for f in self.frames))

    def looked_through(self) -> PredictedFrames:
        """Return the same with depth where the network is not sure, too, and with it said that no surface is there."""
        made = []
        for f, unsure in zip(self.frames, self.unsure, strict=True):
            blank = unsure > 0
            none = blank if f.no_surface is None else blank | f.no_surface
            made.append(replace(f, depth=np.where(blank, unsure, f.depth), no_surface=none))
        return PredictedFrames(tuple(made), tuple(np.zeros_like(one) for one in self.unsure))


def _shows(frame: RgbdFrame, cube: Cube) -> npt.NDArray[np.bool_]:
    """Return (h, w), where a frame shows a cube: what is green near it, and all that is in it."""
    c = frame.camera
    points = (c.rays() * frame.depth[..., None] @ c.R_WC.T + c.p_WC).reshape(-1, 3)
    green = np.zeros(len(points), bool) if frame.rgb is None else is_green(frame.rgb.reshape(-1, 3) / 255.0)
    own = cube.holds(points, TUNING.held) | (green & cube.holds(points, TUNING.held_green))
    return own.reshape(frame.depth.shape)


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
            told = (_without_ones(np.asarray(data[name]), due) for name, due in _NAMES.items())
            points, sure, extrinsic, intrinsic, images = told
            sure, extrinsic = _finite(sure), _without_last_row(extrinsic)
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
    _refuse_other_ways(path, points, sure, extrinsic.astype(float))
    rgb = _bytes(path, images)
    depths, unsure = _depths(points, sure, extrinsic)
    frames = []
    for k, depth in enumerate(depths):
        camera = _camera(path, k, extrinsic[k].astype(float), intrinsic[k].astype(float), (height, width))
        lens = _lens(camera, points[k].astype(float), depth)
        frames.append(RgbdFrame(k, float(k), rgb[k], depth, None, lens, lens))
    return PredictedFrames(tuple(frames), tuple(unsure))


def _finite(sure: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return confidences, infinite ones at the greatest number there is: in half precision exponentials overflow."""
    if sure.dtype.kind != "f":
        return sure
    return np.where(sure == np.inf, np.finfo(sure.dtype).max, sure).astype(sure.dtype)


def _without_last_row(extrinsic: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return poses (S, 3, 4) of such, or of whole ones (S, 4, 4), whose last row says nothing; others as they are."""
    whole = extrinsic.shape[1:] == (4, 4) and extrinsic.dtype.kind in "fui"
    return extrinsic[:, :3] if whole and (extrinsic[:, 3] == (0, 0, 0, 1)).all() else extrinsic


def _without_ones(array: npt.NDArray[Any], due: int) -> npt.NDArray[Any]:
    """Return an array without axes of length 1 in front and behind, such as of a batch, beyond the `due` number."""
    while array.ndim > due and array.shape[0] == 1:
        array = array[0]
    while array.ndim > due and array.shape[-1] == 1:
        array = array[..., 0]
    return array


def _bytes(path: Path, images: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Return images (S, H, W, 3) as bytes; refuse such as are neither whole numbers 0 to 255 nor within [0, 1]."""
    low, high = float(images.min()), float(images.max())
    whole = images.dtype.kind in "ui"
    least, most = (0.0, 255.0) if whole else (-TUNING.bright, 1.0 + TUNING.bright)
    if low < least or high > most:
        due = "0 to 255" if whole else "0 to 1"
        raise FramesError(f"{path}: images of {images.dtype} hold {low:g} to {high:g}, must be {due}")
    return images.astype(np.uint8) if whole else np.round(255 * np.clip(images, 0, 1)).astype(np.uint8)


def _depths(points: Array, sure: Array, extrinsic: Array) -> tuple[list[Map], list[Map]]:
    """Return each view's depth (h, w) where the network is sure, and where it is not; else 0, and at its lens."""
    # NumPy before 2.3 counts places in the array's own precision: of half, past 65,504 there are none.
    floor = np.quantile(sure.astype(float), TUNING.doubtful)
    if floor <= sure.min() < sure.max():  # more is not sure at all than is left out
        floor = sure[sure > sure.min()].min()
    raw = [p.astype(float) @ X[2, :3].astype(float) + float(X[2, 3]) for p, X in zip(points, extrinsic, strict=True)]
    good = [(one > 0) & (own >= floor) for one, own in zip(raw, sure, strict=True)]
    all_good = np.concatenate([one[own] for one, own in zip(raw, good, strict=True)])
    least = TUNING.nearest * float(np.median(all_good)) if len(all_good) else 0.0
    known, unsure = [], []
    for one, own in zip(raw, good, strict=True):
        there = one > least
        known.append(np.where(own & there, one, 0).astype(np.float32))
        unsure.append(np.where(~own & there, one, 0).astype(np.float32))
    return known, unsure


def _refuse_other_ways(path: Path, points: Array, sure: Array, extrinsic: Array) -> None:
    """Refuse poses (S, 3, 4) that are told camera-to-world or with a renderer's axes, as points' pixels show."""
    axes = np.diag([1.0, -1.0, -1.0])
    back = np.concatenate([extrinsic[:, :, :3].mT, -extrinsic[:, :, :3].mT @ extrinsic[:, :, 3:]], axis=2)
    of_renderer = "with OpenGL's axes (y up, z behind)"
    ways = {
        "": extrinsic,
        "camera-to-world": back,
        of_renderer: axes @ extrinsic,
        f"camera-to-world {of_renderer}": axes @ back,
    }
    off = {
        name: float(np.median([_off_pixels(p, c, X) for p, c, X in zip(points, sure, all_X, strict=True)]))
        for name, all_X in ways.items()
    }
    best = min(off, key=lambda name: off[name])
    if off[""] > TUNING.elsewhere and off[best] < TUNING.clearly * off[""]:
        raise FramesError(
            f"{path}: extrinsic is {best}, as the points show; must be world-to-camera, x right, y down, z ahead"
        )


def _off_pixels(points: Array, sure: Array, X: Array) -> float:
    """Return how far a view's points (h, w, 3) lie from their pixels, by its pose X (3, 4) and the lens that fits best.

    Of a median point, as a share of the width; 1 where most are behind the camera.
    """
    order = np.argsort(-sure.ravel(), kind="stable")[: sure.size // 2]
    chosen = order[:: max(1, len(order) // TUNING.thin)]
    p = points.reshape(-1, 3)[chosen].astype(float) @ X[:, :3].T + X[:, 3]
    ahead = p[:, 2] > 0.0
    if ahead.mean() < 0.5:
        return 1.0
    off = []
    for axis, at in enumerate(np.divmod(chosen[ahead], sure.shape[1])[::-1]):
        slope = p[ahead, axis] / p[ahead, 2]
        A = np.stack([slope, np.ones_like(slope)], axis=1)
        focal, centre = np.linalg.lstsq(A, at, rcond=None)[0]
        off.append(np.abs(at - max(focal, 0.0) * slope - centre))
    return float(np.median(np.hypot(*off))) / sure.shape[1]


def _camera(path: Path, k: int, X: Array, K: Array, size: tuple[int, int]) -> ViewCamera:
    """Return the camera of view `k`: world-to-camera X (3, 4), K (3, 3), size (h, w)."""
    R, t = X[:, :3], X[:, 3]
    if np.abs(R @ R.T - np.eye(3)).max() > TUNING.rotation or np.linalg.det(R) < 0:
        raise FramesError(f"{path}: extrinsic {k} is no rotation")
    u, _, vt = np.linalg.svd(R)
    R = u @ vt
    if min(K[0, 0], K[1, 1]) <= 0:
        raise FramesError(f"{path}: intrinsic {k} has no positive focal length")
    return ViewCamera(size[1], size[0], float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]), R.T, -R.T @ t)


def _lens(camera: ViewCamera, points: Array, depth: Map) -> ViewCamera:
    """Return a camera whose focal lengths and centre are the points' own, where those told project them elsewhere.

    A network predicts its points beside its cameras; a pixel u shows its point where u = fx x/z + cx.
    """
    rows, columns = np.nonzero(depth > 0)
    if len(rows) < TUNING.least_points:
        return camera
    p = (points[rows, columns] - camera.p_WC) @ camera.R_WC
    told = [(camera.fx, camera.cx), (camera.fy, camera.cy)]
    found = []
    for axis, (at, (focal, centre)) in enumerate(zip((columns, rows), told, strict=True)):
        slope = p[:, axis] / p[:, 2]
        off = np.abs(at - focal * slope - centre)
        if np.median(off) > TUNING.projected and np.ptp(slope) > 0.05:
            fitted = np.array([focal, centre])
            for _ in range(5):  # least absolute distances, by weights
                w = 1.0 / np.maximum(np.abs(at - fitted[0] * slope - fitted[1]), 0.1)
                A = np.stack([slope, np.ones_like(slope)], axis=1)
                fitted = np.linalg.solve((A.T * w) @ A, (A.T * w) @ at)
            if fitted[0] > 0:
                focal, centre = float(fitted[0]), float(fitted[1])
        found.append((focal, centre))
    (fx, cx), (fy, cy) = found
    return replace(camera, fx=fx, fy=fy, cx=cx, cy=cy)


def metric(predicted: PredictedFrames, cube_edge: float, where: str) -> tuple[PredictedFrames, Cube, float]:
    """Return frames in metres, the cube of known edge [m] in them, and the factor that made them so.

    Their poses and scales of depth are made to agree beforehand: see `twin_diagram.assets.building.levelling`.

    Raises:
        FramesError: no support or no green cube.
    """
    # Judged in units of the scene's depth, since nothing is known of its own.
    depths = [f.depth[f.depth > 0][::50] for f in predicted.frames]
    unit = float(np.median(np.concatenate(depths))) if any(len(one) for one in depths) else 0.0
    if not unit > 0:
        raise FramesError(f"{where}: no depth")
    factor = TUNING.first_depth / unit
    scene = predicted.scaled(factor)
    views = [make_view(f.camera, f.depth, None, f.rgb) for f in scene.frames]
    level = levelled(views, _support(views, where))
    wrong: FramesError | None = None
    for candidate in rough_cubes(*_coloured(level.views), level.plane, where):
        try:
            views, cube, rough = _measured(level, candidate, cube_edge, where)
            break
        except FramesError as error:
            wrong = wrong or error
    else:
        raise wrong or FramesError(f"{where}: no green cube")
    last = cube_edge / cube.edge
    frames, unsure = [], []
    for f, blank, view in zip(predicted.frames, predicted.unsure, views, strict=True):
        frames.append(replace(f, depth=view.depth, camera=view.camera, colour=view.camera))
        there = f.depth > 0
        scale = np.median(view.depth[there] / f.depth[there]) if there.any() else 0.0  # each view's was found
        unsure.append((blank * scale).astype(np.float32))
    cube = replace(cube, edge=cube_edge, centre=cube.centre * last)
    made = PredictedFrames(tuple(frames), tuple(unsure)).scaled(last).without(cube)
    return made.looked_through(), cube, factor * rough * last


def _measured(level: LevelViews, candidate: Cube, edge: float, where: str) -> tuple[list[DepthView], Cube, float]:
    """Return views in metres but for a few percent, that agree; the cube in them; and the factor that made them so."""
    rough = edge / candidate.edge
    again = levelled([_scaled(view, rough) for view in level.views], level.plane * [1, 1, 1, rough])
    views, plane = surfaces_agree(replace(again, scale=max(again.scale, level.scale)))
    found = rough_cubes(*_coloured(views), plane, where)
    nearest = min(found, key=lambda one: float(np.linalg.norm(one.centre - candidate.centre * rough)))
    return views, fit_cube(views, nearest, plane, where), rough


def _support(views: list[DepthView], where: str) -> Array:
    samples = [view_points(view, 2, None) for view in views]
    points, normals = (np.concatenate([sample[k] for sample in samples]) for k in range(2))
    above = np.mean([view.camera.p_WC for view in views], axis=0)
    rng = np.random.default_rng(0)
    some = rng.permutation(np.flatnonzero(np.linalg.norm(normals, axis=1) > 0.5))[:6000]
    plane = find_plane(points[some], normals[some], above)
    if plane is None:
        raise FramesError(f"{where}: no plane on which cube and object stand")
    return plane


def _scaled(view: DepthView, factor: float) -> DepthView:
    """Return a view of the same scene, `factor` times as large."""
    camera = view.camera.moved(view.camera.R_WC, view.camera.p_WC * factor)
    return make_view(camera, (view.depth * np.float32(factor)).astype(np.float32), view.mask, view.rgb)


def _coloured(views: list[DepthView]) -> tuple[Array, Array]:
    """Return points (N, 3) in W of all views and their colours in [0, 1]."""
    found = [(view_points(view, 2, None), view.rgb) for view in views]
    points = np.concatenate([sample[0] for sample, _ in found])
    colours = [rgb[at[:, 0], at[:, 1]] / 255.0 for (_, _, at), rgb in found if rgb is not None]
    return points, np.concatenate(colours)
