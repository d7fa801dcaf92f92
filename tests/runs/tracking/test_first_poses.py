"""Poses of the first frame, as others write them: of several scenes, by a spreadsheet, with few digits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin_diagram.errors import FramesError
from twin_diagram.runs.tracking.first_poses import first_poses
from twin_diagram.runs.tracking.track_frames import scene_of

HEAD = "scene_id,im_id,obj_id,score,R,t,time\n"
NUMBERS = {"mug": 1, "can": 2}


def written(folder: Path, *rows: tuple[int, int, int, float], head: str = HEAD) -> Path:
    """Write rows of scene, frame, object and depth [mm]."""
    turn = "0.866 -0.5 0 0.5 0.866 0 0 0 1"
    lines = [f"{scene},{frame},{number},0.5,{turn},0 0 {z},-1\n" for scene, frame, number, z in rows]
    path = folder / "poses.csv"
    path.write_text(head + "".join(lines), encoding="utf-8")
    return path


def test_of_several_scenes_the_folders_own_counts(tmp_path: Path) -> None:
    """Results of a whole data set: poses of the other scenes' first frames were taken for this one's."""
    path = written(tmp_path, (1, 0, 1, 700), (48, 0, 2, 800), (48, 3, 1, 900))
    ((name, R, p),) = first_poses(path, 0, 48, NUMBERS)
    assert name == "can" and p[2] == pytest.approx(0.8)
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-12
    with pytest.raises(FramesError, match="scene_id 1 and 48"):
        first_poses(path, 0, None, NUMBERS)
    with pytest.raises(FramesError, match="scene_id 1 and 48"):
        first_poses(path, 0, 7, NUMBERS)


def test_one_scene_alone_counts_whatever_its_number_is(tmp_path: Path) -> None:
    path = written(tmp_path, (48, 0, 2, 800), (1, 5, 9, 700))
    for scene in (None, 0, 48):
        assert [name for name, _, _ in first_poses(path, 0, scene, NUMBERS)] == ["can"]


def test_a_spreadsheets_byte_order_mark_is_no_part_of_a_columns_name(tmp_path: Path) -> None:
    """It stands before the first column's name, which then was another one: all rows were of scene 0."""
    path = written(tmp_path, (1, 0, 1, 700), (48, 0, 2, 800), head="\ufeff" + HEAD)
    assert [name for name, _, _ in first_poses(path, 0, 48, NUMBERS)] == ["can"]


def test_spaces_after_commas_are_no_part_of_columns(tmp_path: Path) -> None:
    rows = tmp_path / "poses.csv"
    rows.write_text("im_id, scene_id, obj_id, time, t, R, score\n3, 0, 7, -1, 10 20 700, 1 0 0 0 1 0 0 0 1, 0.9\n")
    ((name, _, p),) = first_poses(rows, 3, None, {"box": 7})
    assert name == "box" and p.tolist() == [0.01, 0.02, 0.7]


def test_rows_that_lack_a_column_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, (0, 0, 1, 700), head=HEAD.replace(",t,", ",shift,"))
    with pytest.raises(FramesError, match="line 2 is no BOP result"):
        first_poses(path, 0, None, NUMBERS)


@pytest.mark.parametrize(("name", "scene"), [("000048", 48), ("0", 0), ("frames", None), ("scene_3", None)])
def test_a_folder_that_is_named_by_a_number_is_that_scene(name: str, scene: int | None, tmp_path: Path) -> None:
    assert scene_of(tmp_path / name) == scene
