"""The command `twin-diagram track`: poses of a library's objects in each frame of a folder, written as files.

`poses.csv` holds BOP results (scene_id, im_id, obj_id, score, R, t [mm], time [s], camera frame), `objects.jsonl` a
line per frame, SI, in W.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from twin_diagram import scenario
from twin_diagram.assets import Asset, same_thing
from twin_diagram.assets.description import read_spec
from twin_diagram.assets.library import entries
from twin_diagram.errors import AssetError, FramesError
from twin_diagram.logs.frames import FrameFolder, RgbdFrame, ViewCamera
from twin_diagram.perception.alignment import DepthGrid
from twin_diagram.perception.depth_noise import DepthSigma, measured
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.registration.alternatives import PoseHypothesis
from twin_diagram.perception.registration.rotation import to_quaternion
from twin_diagram.perception.segmentation.learned import Segmenter, segment_with
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.runs.tracking.grown_assets import GrownAssets
from twin_diagram.runs.tracking.object_tracker import ObjectTracker, TrackedObject
from twin_diagram.runs.tracking.table_frame import TableFrame, table_frame
from twin_diagram.runtime import atomic_file
from twin_diagram.runtime.output_place import why_not
from twin_diagram.runtime.stages import Pace
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import CalibrationError, shared_covariances
from twin_diagram.signals.lens import Lens

PERCEPTION = scenario.Perception(workspace=[[-5.0, -5.0, -0.02], [5.0, 5.0, 5.0]])
"""Everything in view above the table counts: no workspace is told."""
CELLS = 160
"""Cells a row that an image has at least, where it has as many pixels: of 80 at 160 × 120 a thing of 8 cm, 0.8 m off,
covers 50, and 60 make a thing. Edges are told in cells, which at 320 are two pixels wide: smaller ones err by more."""
FARTHEST = 100.0
"""No depth camera sees farther [m]."""
REAL = CalibrationError(shift=0.005, turn=np.radians(0.5), focal=0.003, centre=1.0, depth_scale=0.01)
"""How well a depth camera is calibrated of which nothing is told, RMS: as good cameras on a hand-eye calibration are.
One whose noise is white, and not rounded by a disparity's steps, is a renderer's, and exact."""
NEAREST = 0.01
"""Nor is anything in its focus that is nearer [m]."""
LEAST_SHOWN = 0.002
"""Share of pixels with depth below which a frame shows neither table nor thing: cameras' first ones may be empty."""
COLUMNS = "scene_id,im_id,obj_id,score,R,t,time"
"""Of BOP results."""
FOCALS = (0.1, 50.0)
"""Focal lengths over the image's size: views of 157° and of 1°."""


def track_frames(
    library: Path,
    frames: Path,
    out: Path,
    init: Path | None = None,
    seed: int = 0,
    say: Callable[[str], None] = print,
    grow: Path | None = None,
    segmenter: Segmenter | None = None,
) -> None:
    """Track the objects of a library through a folder of frames; no frame is read before its turn.

    Args:
        library: folder of assets; corrupt ones are named and left out.
        frames: BOP scene folder; its first frames may lack depth.
        out: folder that gets `poses.csv` and `objects.jsonl`.
        init: poses of the first frame's objects, in the layout of `poses.csv`; others are searched for.
        seed: of what is drawn; at present nothing is.
        say: told what goes on.
        grow: folder that gets assets of unknown things which frames show from enough sides: those are followed under
            their names from then on. `library` may be empty then.
        segmenter: says which thing each pixel shows, in the place of the project's own segmentation.

    Raises:
        AssetError, FramesError: names file and value; nothing is written.
        KeyboardInterrupt: it was stopped; what the frames before told is written.
    """
    _check_told(out, grow, seed)
    folder = FrameFolder(frames, masked=False)
    for note in folder.notes:
        say(f"note: {note}")
    assets, numbers = _library(library, say, grow)
    told = [] if init is None else _first_poses(init, folder.numbers[0], numbers)
    tracker = ObjectTracker(assets, PERCEPTION, grows=grow is not None)
    grown = None if grow is None else GrownAssets(grow, tracker, assets, numbers, say)
    done: list[tuple[list[list[str]], str]] = []
    pace = Pace(len(folder), say)
    try:
        for one in _tracked(folder, tracker, told, numbers, say, segmenter):
            done.append(one)
            if grown is not None:
                grown.poll(folder.numbers[len(done) - 1])
            pace(len(done))
        if grown is not None:
            grown.close()
    except KeyboardInterrupt:
        if done:
            _write(out, done)
            say(f"{out}: the first {len(done)} of {len(folder)} frames")
        raise
    _write(out, done)
    say(f"{out}: {sum(len(rows) for rows, _ in done)} poses in {len(done)} frames")


def _tracked(
    folder: FrameFolder,
    tracker: ObjectTracker,
    told: list[tuple[str, Array, Array]],
    numbers: Mapping[str, int],
    say: Callable[[str], None],
    segmenter: Segmenter | None,
) -> Iterator[tuple[list[list[str]], str]]:
    """Yield of each frame its rows of `poses.csv` and its line of `objects.jsonl`."""
    apart = partial(segment, in_a_room=True) if segmenter is None else partial(segment_with, segmenter)
    seen_by: dict[int, ViewCamera] = {}
    zero = min(0.0, folder.times[0])  # to the tracker, what was before 0 was never
    base: TableFrame | None = None
    first: Pinhole | None = None
    noise, doubt = DepthSigma(), CalibrationError()
    for index in range(len(folder)):
        frame = folder.read(index)
        _check(frame, folder.folder)
        depth = _on_colours_grid(frame)
        camera = _pinhole(frame.colour, frame.colour.R_WC, frame.colour.p_WC, noise)
        if base is None:
            first = first or camera
            if np.count_nonzero(frame.depth) < LEAST_SHOWN * frame.depth.size:
                yield [], json.dumps({"frame": frame.number, "time": frame.time, "objects": []})
                continue
            base, noise, doubt = _begun(folder, frame, depth, camera, say)
            _start(tracker, told, base.camera(first), frame.time - zero - 1e-3)
        told_by = replace(PERCEPTION, stride=stride_of(camera.width))
        grid = Grid.of(_pinhole(frame.colour, *base.camera(camera), noise), told_by.stride)
        rgb, time = _rgb_of(frame), frame.time - zero
        found = tracker.observe(apart(rgb, depth, time, grid, told_by))
        seen_by |= {one.track: frame.colour for one in found if one.found}
        rows = [_row(frame, one, numbers, camera, base) for one in found if one.asset is not None and one.found]
        yield rows, json.dumps(_line(frame, found, base, doubt, seen_by))
    if base is None:
        say("note: no frame has depth")


def stride_of(width: int) -> int:
    """Return which of an image's pixels are looked at: every so many-th, by its width [px]."""
    return min(PERCEPTION.stride, max(1, width // CELLS))


def _begun(
    folder: FrameFolder, frame: RgbdFrame, depth: Any, camera: Pinhole, say: Callable[[str], None]
) -> tuple[TableFrame, DepthSigma, CalibrationError]:
    """Return what the first frame that has depth tells: the table, depth's noise, and how far off the camera may be."""
    if not folder.timed and len(folder) > 1:
        say("note: no times.json: frames count as 1 s apart; its times [s] tell how fast things move")
    if not folder.coloured:
        left = "gray/ is read: shades alone tell" if frame.rgb is not None else "nor gray/: shape alone tells"
        say(f"note: no rgb/, {left} things apart")
    if frame.number != folder.numbers[0]:
        say(f"note: tracking begins at frame {frame.number}: there is no depth before it")
    noise = measured(frame.depth)
    base = table_frame(depth, replace(camera, depth_noise=noise))
    if not base.found:
        say("note: no table in view; all that is seen counts as standing")
    return base, noise, _doubt(folder, noise)


def _rgb_of(frame: RgbdFrame) -> npt.NDArray[np.uint8]:
    """Return a frame's colours (h, w, 3), grey where it has none."""
    if frame.rgb is not None:
        return frame.rgb
    return np.full((frame.colour.height, frame.colour.width, 3), 128, dtype=np.uint8)


def _check_told(out: Path, grow: Path | None, seed: int) -> None:
    """Refuse folders that cannot be written to, and a seed that is none."""
    for option, place in (("--out", out), ("--grow", grow)):
        if place is not None and (why := why_not(place, folder=True)) is not None:
            raise FramesError(f"{option} {place}: {why}")
    if seed < 0:
        raise FramesError(f"--seed {seed}: must not be negative")


def _start(
    tracker: ObjectTracker, told: list[tuple[str, Array, Array]], X_TC: tuple[Array, Array], time: float
) -> None:
    """Tell the tracker where objects are before the first frame."""
    R_TC, p_TC = X_TC
    for name, R_CO, p_CO in told:
        tracker.start(name, R_TC @ R_CO, R_TC @ p_CO + p_TC, time)


def _write(out: Path, done: list[tuple[list[list[str]], str]]) -> None:
    table = [COLUMNS, *(",".join(row) for rows, _ in done for row in rows)]
    atomic_file.write(out / "poses.csv", "".join(line + "\n" for line in table))
    atomic_file.write(out / "objects.jsonl", "".join(line + "\n" for _, line in done))


def _library(library: Path, say: Callable[[str], None], grow: Path | None) -> tuple[dict[str, Asset], dict[str, int]]:
    """Return the whole assets by name, and their BOP numbers: `obj_id` in `asset.yaml`, else the place in it.

    There may be none where some are to `grow`, for which there must be room.
    """
    assets: dict[str, Asset] = {}
    numbers: dict[str, int] = {}
    for place, one in enumerate(entries(library), start=1):
        if one.asset is None:
            say(f"warning: {one.name} is corrupt and left out: {one.wrong}")
            continue
        assets[one.name] = one.asset
        own = read_spec(one.asset.folder).obj_id
        numbers[one.name] = place if own is None else own
    if not assets and grow is None:
        itself = (Path(library) / "asset.yaml").is_file()
        hint = "; it is an asset itself: name the folder that holds it" if itself else ""
        raise AssetError(f"{library}: no whole asset in this library{hint}")
    slots = scenario.Slots()
    if grow is not None and not slots.further(len(assets)):
        raise AssetError(
            f"--grow {grow}: no room for what grows: {slots.instances} objects are followed at most, and {library} "
            f"holds {len(assets)}"
        )
    if len(set(numbers.values())) < len(numbers):
        raise AssetError(f"{library}: two assets have one obj_id: {numbers}")
    for line in same_thing.told(assets):
        say(line)
    return assets, numbers


def _first_poses(path: Path, first: int, numbers: Mapping[str, int]) -> list[tuple[str, Array, Array]]:
    """Read X_CO of the first frame's objects from BOP results, the best first; of alikes each has a row."""
    names = {number: name for name, number in numbers.items()}
    told: list[tuple[float, str, Array, Array]] = []
    try:
        rows = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))
    except (OSError, UnicodeDecodeError) as error:
        raise FramesError(f"{path}: cannot be read: {error}") from None
    if rows and "im_id" not in rows[0]:
        raise FramesError(f"{path}: no BOP result: its first line must name the columns: {COLUMNS}")
    for number, row in enumerate(rows, start=2):
        try:
            image, which, score = int(row["im_id"]), int(row["obj_id"]), float(row.get("score") or 1.0)
            R, t = (np.array(row[key].split(), dtype=float) for key in ("R", "t"))
        except (KeyError, TypeError, ValueError, AttributeError):
            raise FramesError(f"{path}: line {number} is no BOP result: {dict(row)}") from None
        if len(R) != 9 or len(t) != 3 or not np.isfinite([*R, *t, score]).all():
            raise FramesError(f"{path}: line {number}: R needs nine finite numbers, t three, score one")
        R = R.reshape(3, 3)
        if np.abs(R @ R.T - np.eye(3)).max() > 2e-3 or np.linalg.det(R) < 0:
            raise FramesError(f"{path}: line {number}: R is no rotation")
        if image != first:
            continue
        if not NEAREST < t[2] / 1000.0 < FARTHEST or np.abs(t / 1000.0).max() > FARTHEST:
            said = " ".join(f"{x:g}" for x in t)
            where = f"not before the camera, {NEAREST:g} to {FARTHEST:g} m away"
            raise FramesError(f"{path}: line {number}: t is {said} mm: {where}; is it in another unit?")
        if which not in names:
            raise FramesError(f"{path}: line {number}: obj_id {which} is none of the library's {sorted(names)}")
        told.append((score, names[which], R, t / 1000.0))
    if not told:
        raise FramesError(f"{path}: no pose of the first frame, im_id {first}")
    return [(name, R, p) for _, name, R, p in sorted(told, key=lambda one: -one[0])]


def _doubt(folder: FrameFolder, noise: DepthSigma) -> CalibrationError:
    """Return how far off the camera may be: as is told, or as cameras with such noise are."""
    error = folder.calibration or (REAL if noise.correlated + noise.lasting > 0.0 else CalibrationError())
    # Where no poses are told W is the camera's own frame.
    return error if folder.posed else replace(error, shift=0.0, turn=0.0)


def _check(frame: RgbdFrame, frames: Path) -> None:
    """Refuse views and depths that are no camera's: their figures are of another unit or another image."""
    for which, camera in (("cam_K", frame.colour), ("the depth camera's cam_K", frame.camera)):
        for name, focal, size in (("fx", camera.fx, camera.width), ("fy", camera.fy, camera.height)):
            if not FOCALS[0] * size < focal < FOCALS[1] * size:
                raise FramesError(
                    f"{frames}: frame {frame.number}: {which}: {name} is {focal:g} for {size} pixels; must be "
                    f"{FOCALS[0]:g} to {FOCALS[1]:g} times as much [px]"
                )
    if (there := frame.depth[frame.depth > 0]).size:
        usual = float(np.median(there))
        if not NEAREST < usual < FARTHEST:
            raise FramesError(
                f"{frames}: frame {frame.number}: depth is {usual:.3g} m (median), must be {NEAREST:g} to "
                f"{FARTHEST:g} m; is depth_scale in another unit (mm per step)?"
            )


def _pinhole(camera: ViewCamera, R: Array, p: Array, noise: DepthSigma) -> Pinhole:
    """Return a view's camera at another pose."""
    lens = Lens(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    return Pinhole(camera.width, camera.height, 0.5 * (camera.fx + camera.fy), R, p, lens, noise)


def _on_colours_grid(frame: RgbdFrame) -> Any:
    """Return depth (h, w) [m] on the grid of the colours."""
    if frame.camera is frame.colour:
        return frame.depth
    own, colour = frame.camera, frame.colour
    R_CD, p_CD = colour.R_WC.T @ own.R_WC, colour.R_WC.T @ (own.p_WC - colour.p_WC)
    lenses = [Lens(c.width, c.height, c.fx, c.fy, c.cx, c.cy) for c in (own, colour)]
    return DepthGrid.of(lenses[0], R_CD, p_CD, lenses[1]).warped(frame.depth)


def _row(
    frame: RgbdFrame, one: TrackedObject, numbers: Mapping[str, int], camera: Pinhole, base: TableFrame
) -> list[str]:
    """Return a BOP result of an object in the camera's frame."""
    R_TC, p_TC = base.camera(camera)
    R, t = R_TC.T @ one.R, R_TC.T @ (one.p - p_TC) * 1000.0
    assert one.asset is not None
    said = [" ".join(f"{x:.9g}" for x in values) for values in (R.ravel(), t)]
    time = f"{frame.time:.9f}".rstrip("0").rstrip(".")  # of a clock that counts from 1970, too
    return ["0", str(frame.number), str(numbers[one.asset]), f"{one.probability:.6g}", *said, time]


def _hypothesis(one: PoseHypothesis, base: TableFrame, probability: float) -> dict[str, Any]:
    """Return a pose that a frame allows, in W; `probability` is that of the object."""
    R, p = base.R_WT @ one.R, base.R_WT @ one.p + base.p_WT
    return {"p_WO": p.tolist(), "q_WO": to_quaternion(R).tolist(), "probability": probability * one.probability}


def _line(
    frame: RgbdFrame,
    found: list[TrackedObject],
    base: TableFrame,
    doubt: CalibrationError,
    seen_by: Mapping[int, ViewCamera],
) -> dict[str, Any]:
    """Return a frame's line of `objects.jsonl`; in each covariance is the doubt of the camera that saw it last."""
    turn = np.kron(np.eye(2), base.R_WT)
    objects = []
    for one in found:
        camera = seen_by.get(one.track, frame.colour)
        R, p = base.R_WT @ one.R, base.R_WT @ one.p + base.p_WT
        p_C = ((p - camera.p_WC) @ camera.R_WC)[None]
        shared = shared_covariances(doubt, p_C, camera.R_WC, camera.fx, camera.fy)[0]
        pose = {"p_WO": p.tolist(), "q_WO": to_quaternion(R).tolist()}
        objects.append(
            {
                "track": one.track,
                "asset": one.asset,
                "status": one.status,
                "probability": one.probability,
                "visible": one.visible,
                **pose,
                "covariance": (turn @ one.covariance @ turn.T + shared).tolist(),
                "free": np.eye(3)[list(one.free)].tolist(),
                "named": one.named,
                "by_shape": one.by_shape,
                "hypotheses": [_hypothesis(other, base, one.probability) for other in one.hypotheses],
                "pieces": [(piece @ base.R_WT.T + base.p_WT).tolist() for piece in one.pieces],
            }
        )
    return {"frame": frame.number, "time": frame.time, "objects": objects}
