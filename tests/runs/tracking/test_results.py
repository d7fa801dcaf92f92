"""What `track` writes: rows that BOP's tools read, and no more memory for more frames."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from twin_diagram.logs.frames import RgbdFrame, ViewCamera
from twin_diagram.perception.pinhole import Pinhole
from twin_diagram.runs.tracking.results import COLUMNS, OBJECTS, POSES, Results, bop_row
from twin_diagram.runs.tracking.table_frame import TableFrame
from twin_diagram.runs.tracking.tracked_object import TrackedObject


def test_a_row_is_of_the_scene_and_in_the_cameras_frame() -> None:
    view = ViewCamera(64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(3), np.array([0.0, 0.0, -0.7]))
    frame = RgbdFrame(12, 1785240000.25, None, np.zeros((48, 64), np.float32), None, view, view)
    camera = Pinhole(64, 48, 60.0, view.R_WC, view.p_WC)
    base = TableFrame(np.eye(3), np.array([0.1, 0.0, 0.0]), True)
    none = np.eye(6), (), (), True
    one = TrackedObject(0, "can", "tracked", 0.875, 1.0, np.eye(3), np.array([-0.1, 0.02, 0.0]), *none)
    row = dict(zip(COLUMNS.split(","), bop_row(48, {"can": 7}, frame, one, camera, base), strict=True))
    assert (row["scene_id"], row["im_id"], row["obj_id"], row["score"]) == ("48", "12", "7", "0.875")
    assert [float(x) for x in row["t"].split()] == pytest.approx([0.0, 20.0, 700.0])
    assert float(row["time"]) == 1785240000.25


def test_what_is_written_is_not_kept(tmp_path: Path) -> None:
    """Ten minutes of pieces were some 200 MB before the first byte was on the disk."""
    tracemalloc.start()
    with Results(tmp_path) as results:
        for k in range(2000):
            results.add([["0", str(k), "1"]], {"frame": k, "objects": ["x" * 10_000]})
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2e6, peak
    assert (results.frames, results.poses) == (2000, 2000)
    assert len((tmp_path / OBJECTS).read_text().splitlines()) == 2000
    assert len((tmp_path / POSES).read_text().splitlines()) == 2001
