"""The command `twin-diagram track`: poses of a library's objects in each frame of a folder, written as files.

`poses.csv` holds BOP results (scene_id, im_id, obj_id, score, R, t [mm], time [s], camera frame), `objects.jsonl` a
line per frame, SI, in W.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
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
from twin_diagram.perception.segmentation.learned import Segmenter, segment_with
from twin_diagram.perception.segmentation.segmentation import Grid, segment
from twin_diagram.runs.tracking.first_poses import FARTHEST, NEAREST, first_poses
from twin_diagram.runs.tracking.grown_assets import GrownAssets
from twin_diagram.runs.tracking.object_tracker import ObjectTracker
from twin_diagram.runs.tracking.picture_content import PictureContent
from twin_diagram.runs.tracking.results import OBJECTS, POSES, Results, bop_row, frame_line
from twin_diagram.runs.tracking.room import slots_for
from twin_diagram.runs.tracking.table_frame import TUNING as SHOWN
from twin_diagram.runs.tracking.table_frame import TableFrame, table_frame
from twin_diagram.runs.tracking.tracked_object import TrackedObject
from twin_diagram.runtime import atomic_file
from twin_diagram.runtime.output_place import why_not
from twin_diagram.runtime.stages import Pace
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.calibration_error import CalibrationError
from twin_diagram.signals.lens import Lens

PERCEPTION = scenario.Perception(workspace=[[-5.0, -5.0, -0.02], [5.0, 5.0, 5.0]])
"""Everything in view above the table counts: no workspace is told."""
CELLS = 160
"""Cells a row that an image has at least, where it has as many pixels: of 80 at 160 × 120 a thing of 8 cm, 0.8 m off,
covers 50, and 60 make a thing. Edges are told in cells, which at 320 are two pixels wide: smaller ones err by more."""
REAL = CalibrationError(shift=0.005, turn=np.radians(0.5), focal=0.003, centre=1.0, depth_scale=0.01)
"""How well a depth camera is calibrated of which nothing is told, RMS: as good cameras on a hand-eye calibration are.
One whose noise is white, and not rounded by a disparity's steps, is a renderer's, and exact."""
GREY = 0.005
"""Pictures whose red, green and blue differ by less than this share of how bright they are have no colours: an infrared
camera's, all three written alike. A white table has 0.03, by a colour camera's noise alone; a black picture tells not.
"""
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
    scene = scene_of(frames)
    told = [] if init is None else first_poses(init, folder.numbers[0], scene, numbers)
    row = partial(bop_row, scene or 0, numbers)
    tracker = ObjectTracker(assets, PERCEPTION, grows=grow is not None)
    grown = None if grow is None else GrownAssets(grow, tracker, assets, numbers, say)
    pace = Pace(len(folder), say)
    stopped = None
    with atomic_file.folder(out, (POSES, OBJECTS)) as aside, Results(aside) as results:
        try:
            for rows, line in _tracked(folder, tracker, told, row, say, segmenter):
                results.add(rows, line)
                if grown is not None:
                    grown.poll(line["frame"])
                pace(results.frames)
            if grown is not None:
                grown.close()
        except KeyboardInterrupt as error:
            if not results.frames:
                raise
            stopped = error
    if stopped is not None:
        say(f"{out}: the first {results.frames} of {len(folder)} frames")
        raise stopped
    say(f"{out}: {results.poses} poses in {results.frames} frames")


def _tracked(
    folder: FrameFolder,
    tracker: ObjectTracker,
    told: list[tuple[str, Array, Array]],
    row: Callable[[RgbdFrame, TrackedObject, Pinhole, TableFrame], list[str]],
    say: Callable[[str], None],
    segmenter: Segmenter | None,
) -> Iterator[tuple[list[list[str]], dict[str, Any]]]:
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
            if np.count_nonzero(frame.depth) < SHOWN.least_shown * frame.depth.size:
                yield [], {"frame": frame.number, "time": frame.time, "objects": []}
                continue
            base, noise, doubt = _begun(folder, frame, depth, camera, say)
            tracker.before_pictures_of(_shown(folder, frame, say))
            _start(tracker, told, base.camera(first), frame.time - zero - 1e-3)
        told_by = replace(PERCEPTION, stride=stride_of(camera.width))
        grid = Grid.of(_pinhole(frame.colour, *base.camera(camera), noise), told_by.stride)
        rgb, time = _rgb_of(frame), frame.time - zero
        found = tracker.observe(apart(rgb, base.told(depth, camera), time, grid, told_by))
        seen_by |= {one.track: frame.colour for one in found if one.found}
        rows = [row(frame, one, camera, base) for one in found if one.asset is not None and one.found]
        yield rows, frame_line(frame, found, base, doubt, seen_by)
    if base is None:
        say("note: no frame has depth")


def scene_of(frames: Path) -> int | None:
    """Return the scene that a folder of frames is named after, as BOP's are (`000048`); None: it has another name."""
    name = frames.absolute().name
    return int(name) if name.isascii() and name.isdecimal() else None


def stride_of(width: int) -> int:
    """Return which of an image's pixels are looked at: every so many-th, by its width [px]."""
    return min(PERCEPTION.stride, max(1, width // CELLS))


def _begun(
    folder: FrameFolder, frame: RgbdFrame, depth: Any, camera: Pinhole, say: Callable[[str], None]
) -> tuple[TableFrame, DepthSigma, CalibrationError]:
    """Return what the first frame that has depth tells: the table, depth's noise, and how far off the camera may be."""
    if not folder.timed and len(folder) > 1:
        say("note: no times.json: frames count as 1 s apart; its times [s] tell how fast things move")
    if frame.number != folder.numbers[0]:
        say(f"note: tracking begins at frame {frame.number}: there is no depth before it")
    noise = measured(frame.depth)
    base = table_frame(depth, replace(camera, depth_noise=noise))
    if not base.found:
        say("note: no table in view; all that is seen counts as standing")
    return base, noise, _doubt(folder, noise)


def _shown(folder: FrameFolder, frame: RgbdFrame, say: Callable[[str], None]) -> PictureContent:
    """Return whether pictures have colours, as the first frame that has depth shows; say where they have none."""
    if frame.rgb is None:
        say("note: no rgb/, nor gray/: shape alone tells things apart")
        return PictureContent.SHAPE
    low, high = frame.rgb.min(axis=2), frame.rgb.max(axis=2)
    if folder.coloured and not float(np.mean(high - low)) < GREY * float(np.mean(high)):
        return PictureContent.COLOURS
    where = "rgb/ has no colours" if folder.coloured else "no rgb/, gray/ is read"
    say(f"note: {where}: shades alone tell things apart")
    return PictureContent.SHADES


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
    slots = slots_for(len(assets))
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
    if (there := frame.depth[frame.depth > 0]).size >= max(1.0, SHOWN.least_shown * frame.depth.size):
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
