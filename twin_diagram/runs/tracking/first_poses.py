"""Reads where objects are in the first frame: BOP results, laid out as `poses.csv`."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from twin_diagram.errors import FramesError
from twin_diagram.runs.tracking.results import COLUMNS
from twin_diagram.signals.arrays import Array

FARTHEST = 100.0
"""No depth camera sees farther [m]."""
NEAREST = 0.01
"""Nor is anything in its focus that is nearer [m]."""


class ToldPose(NamedTuple):
    """A row of BOP results: of which scene, frame and object, how sure, and X_CO as R (3, 3) and t (3,) [mm]."""

    line: int
    scene: int
    frame: int
    number: int
    score: float
    R: Array
    t: Array


def first_poses(
    path: Path, first: int, scene: int | None, numbers: Mapping[str, int]
) -> list[tuple[str, Array, Array]]:
    """Read X_CO of the first frame's objects from BOP results, the best first; of alikes each has a row.

    Args:
        path: the file.
        first: the first frame's number, `im_id`.
        scene: that the frames' folder is named after; None: it is not. Rows of other scenes than the folder's are
            passed over where some are of its own, and where there is but one scene, its rows count, whatever it is.
        numbers: `obj_id` of the library's objects, by name.

    Returns:
        Of each its name, R_CO (3, 3) and p_CO (3,) [m].

    Raises:
        FramesError: it cannot be read, a row is none, or is of another unit or object, or of no scene that is told.
    """
    names = {number: name for name, number in numbers.items()}
    told = [one for one in _rows(path) if one.frame == first]
    scenes = sorted({one.scene for one in told})
    if scene in scenes:
        told = [one for one in told if one.scene == scene]
    elif len(scenes) > 1:
        said = " and ".join(map(str, scenes[:2]))
        raise FramesError(
            f"{path}: poses of frame {first} in several scenes, scene_id {said}: keep the rows of one, or name the "
            "frames' folder after its scene"
        )
    for one in told:
        _check(path, one, names)
    if not told:
        raise FramesError(f"{path}: no pose of the first frame, im_id {first}")
    return [(names[one.number], one.R, one.t / 1000.0) for one in sorted(told, key=lambda one: -one.score)]


def _rows(path: Path) -> list[ToldPose]:
    """Return all rows of BOP results; of what has no score it is 1, and what has no scene_id is of scene 0."""
    try:
        rows = list(csv.DictReader(path.read_text(encoding="utf-8-sig").splitlines(), skipinitialspace=True))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FramesError(f"{path}: cannot be read: {error}") from None
    if rows and "im_id" not in rows[0]:
        raise FramesError(f"{path}: no BOP result: its first line must name the columns: {COLUMNS}")
    found = []
    for line, row in enumerate(rows, start=2):
        try:
            scene, frame, number = int(row.get("scene_id") or 0), int(row["im_id"]), int(row["obj_id"])
            score = float(row.get("score") or 1.0)
            R, t = (np.array(row[key].split(), dtype=float) for key in ("R", "t"))
        except (KeyError, TypeError, ValueError, AttributeError):
            raise FramesError(f"{path}: line {line} is no BOP result: {dict(row)}") from None
        if len(R) != 9 or len(t) != 3 or not np.isfinite([*R, *t, score]).all():
            raise FramesError(f"{path}: line {line}: R needs nine finite numbers, t three, score one")
        R = R.reshape(3, 3)
        if np.abs(R @ R.T - np.eye(3)).max() > 2e-3 or np.linalg.det(R) < 0:
            raise FramesError(f"{path}: line {line}: R is no rotation")
        u, _, vt = np.linalg.svd(R)
        found.append(ToldPose(line, scene, frame, number, score, u @ vt, t))
    return found


def _check(path: Path, one: ToldPose, names: Mapping[int, str]) -> None:
    """Refuse a pose that no camera could have seen, and one of an object that is not in the library."""
    if not NEAREST < one.t[2] / 1000.0 < FARTHEST or np.abs(one.t / 1000.0).max() > FARTHEST:
        said = " ".join(f"{x:g}" for x in one.t)
        where = f"not before the camera, {NEAREST:g} to {FARTHEST:g} m away"
        raise FramesError(f"{path}: line {one.line}: t is {said} mm: {where}; is it in another unit?")
    if one.number not in names:
        raise FramesError(f"{path}: line {one.line}: obj_id {one.number} is none of the library's {sorted(names)}")
