"""What `track` writes: BOP results, and a line of JSON for each frame; both grow on the disk, not in memory."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from twin_diagram.logs.frames import RgbdFrame, ViewCamera
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.perception.registration.alternatives import PoseHypothesis
from twin_diagram.perception.registration.rotation import to_quaternion
from twin_diagram.runs.tracking.table_frame import TableFrame
from twin_diagram.runs.tracking.tracked_object import TrackedObject
from twin_diagram.signals.calibration_error import CalibrationError, shared_covariances

COLUMNS = "scene_id,im_id,obj_id,score,R,t,time"
"""Of BOP results."""
POSES, OBJECTS = "poses.csv", "objects.jsonl"
"""Names of the files."""


class Results:
    """Writes both files frame by frame, in a folder that is there.

    Attributes:
        frames: how many were written.
        poses: rows of BOP results that were written.
    """

    def __init__(self, folder: Path) -> None:
        """Begin both files."""
        self.frames = self.poses = 0
        self._open = ExitStack()
        self._rows, self._lines = (
            self._open.enter_context((folder / name).open("w", encoding="utf-8")) for name in (POSES, OBJECTS)
        )
        self._rows.write(COLUMNS + "\n")

    def __enter__(self) -> Results:
        """Return it."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close both files."""
        self._open.close()

    def add(self, rows: list[list[str]], line: dict[str, Any]) -> None:
        """Write what a frame showed."""
        self._rows.writelines(",".join(row) + "\n" for row in rows)
        self._lines.write(json.dumps(line) + "\n")
        self.frames += 1
        self.poses += len(rows)


def bop_row(
    scene: int, numbers: Mapping[str, int], frame: RgbdFrame, one: TrackedObject, camera: Pinhole, base: TableFrame
) -> list[str]:
    """Return a BOP result of an object of the library in the camera's frame; `numbers` are the `obj_id` by name."""
    R_TC, p_TC = base.camera(camera)
    R, t = R_TC.T @ one.R, R_TC.T @ (one.p - p_TC) * 1000.0
    assert one.asset is not None
    said = [" ".join(f"{x:.9g}" for x in values) for values in (R.ravel(), t)]
    time = f"{frame.time:.9f}".rstrip("0").rstrip(".")  # of a clock that counts from 1970, too
    return [str(scene), str(frame.number), str(numbers[one.asset]), f"{one.probability:.6g}", *said, time]


def _hypothesis(one: PoseHypothesis, base: TableFrame, probability: float) -> dict[str, Any]:
    """Return a pose that a frame allows, in W; `probability` is that of the object."""
    R, p = base.R_WT @ one.R, base.R_WT @ one.p + base.p_WT
    return {"p_WO": p.tolist(), "q_WO": to_quaternion(R).tolist(), "probability": probability * one.probability}


def frame_line(
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
