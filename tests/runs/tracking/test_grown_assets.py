"""`twin-diagram track --grow`: a camera that goes around an unknown thing makes an asset of it, and follows it."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.assets.building.pictured import Shots, shots
from tests.runs.tracking.test_track_frames import body, folder_of, lines, track
from twin_diagram.assets.building.from_mesh import AssetPlace
from twin_diagram.assets.library import check
from twin_diagram.assets.procedural import write_box
from twin_diagram.errors import AssetError
from twin_diagram.logs.frames import ViewCamera
from twin_diagram.runs.tracking.grown_assets import GrownAssets
from twin_diagram.scenario import Slots
from twin_diagram.scenario.resources import models_dir
from twin_diagram.signals import rotations

EDGES = (0.11, 0.05, 0.08)
PLACE = (-0.02, 0.03)
YAW = 0.3


def around(angle: float, height: float = 0.7, distance: float = 0.6) -> ViewCamera:
    """A camera that looks at the middle of the table from an angle about z and so far up [rad]."""
    away = np.array([np.cos(height) * np.cos(angle), np.cos(height) * np.sin(angle), np.sin(height)])
    x = np.cross(-away, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(-away, x), -away], axis=1)
    return ViewCamera(320, 240, 400.0, 400.0, 159.5, 119.5, R, away * distance + [0, 0, 0.03])


def pictures(angles: np.ndarray, turning: bool = False) -> Shots:
    """A box that no library knows; `turning`: it turns under a camera that stands, else the camera goes around it."""
    frames = []
    for k, angle in enumerate(angles):
        view = around(0.0 if turning else angle)
        (one,) = shots([body(EDGES, *PLACE, YAW + (angle if turning else 0.0))], [view]).frames
        frames.append(replace(one, number=k, time=k / 15.0))
    return Shots(frames)


def seen_whole(shown: Shots, folder: Path) -> tuple[list[dict[str, Any]], Path]:
    (folder / "none").mkdir()
    frames = folder_of(shown, folder / "frames")
    grown = folder / "grown"
    assert track(folder / "none", frames, folder / "out", "--grow", str(grown)) == 0
    return lines(folder / "out"), grown


def held_to(found: list[dict[str, Any]], grown: Path, yaw: float) -> None:
    """One thing all the time, of one track: first unknown, then the asset, where the box truly is."""
    assert all(len(line["objects"]) == 1 for line in found[1:])
    told = [line["objects"][0] for line in found[1:]]
    assert {one["track"] for one in told} == {told[0]["track"]}
    names = [one["asset"] for one in told]
    assert names[0] is None and names[-1] == "thing_1"
    assert names == [None] * names.count(None) + ["thing_1"] * names.count("thing_1")
    asset, _ = check(grown / "thing_1")
    last = told[-1]
    R, p = rotations.matrix(np.array(last["q_WO"])[None])[0], np.array(last["p_WO"])
    c, s = np.cos(yaw), np.sin(yaw)
    in_box = (asset.points_O @ R.T + p - [*PLACE, EDGES[2] / 2]) @ np.array([[c, -s, 0.0], [s, c, 0.0], [0, 0, 1.0]])
    off = np.abs(in_box) - np.array(EDGES) / 2
    assert np.abs(np.max(off, axis=1)).mean() < 0.003  # its surface is the box's
    np.testing.assert_allclose(np.abs(in_box).max(axis=0), np.array(EDGES) / 2, atol=0.008)


@pytest.mark.long
def test_a_camera_that_goes_around_a_thing_makes_an_asset_of_it(tmp_path: Path) -> None:
    found, grown = seen_whole(pictures(np.arange(0.0, 5.6, 0.08)), tmp_path)
    held_to(found, grown, YAW)
    rows = (tmp_path / "out" / "poses.csv").read_text().splitlines()[1:]
    assert rows and {row.split(",")[2] for row in rows} == {"1"}


@pytest.mark.slow
def test_a_thing_that_turns_before_a_camera_does_too_and_the_same_again(tmp_path: Path) -> None:
    angles = np.arange(0.0, 6.0, 0.06)
    for name in "ab":
        (tmp_path / name).mkdir()
        found, grown = seen_whole(pictures(angles, turning=True), tmp_path / name)
        held_to(found, grown, YAW + angles[-1])
    first, again = ((tmp_path / name / "out" / "objects.jsonl").read_bytes() for name in "ab")
    assert first == again


@pytest.mark.long
def test_from_one_side_it_stays_partial_and_hides_nothing(tmp_path: Path) -> None:
    found, grown = seen_whole(pictures(np.arange(0.0, 0.5, 0.08)), tmp_path)
    assert all(one["asset"] is None for line in found for one in line["objects"])
    assert [path.name for path in grown.iterdir()] == ["unknown_1.partial.npz"]
    with np.load(grown / "unknown_1.partial.npz") as data:
        assert bool(data["partial"]) and 0.2 < float(data["seen"]) < 0.6
        behind = np.array([-1.0, 0.0, 0.0])  # as the camera, which stood at x > 0, could not see
        assert (data["normals"] @ behind).max() < 0.9


def test_bad_frames_leave_nothing_behind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = folder_of(pictures(np.array([0.0, 0.1])), tmp_path / "frames")
    told = json.loads((frames / "scene_camera.json").read_text())
    told["1"]["cam_K"][0] = 4e6
    (frames / "scene_camera.json").write_text(json.dumps(told))
    (tmp_path / "none").mkdir()
    assert track(tmp_path / "none", frames, tmp_path / "out", "--grow", str(tmp_path / "grown")) == 2
    assert "frame 1" in capsys.readouterr().err
    assert not (tmp_path / "grown").exists() and not (tmp_path / "out").exists()
    assert track(tmp_path / "none", frames, tmp_path / "out") == 2
    assert "no whole asset in this library" in capsys.readouterr().err


def test_a_library_that_leaves_no_room_is_refused_before_a_frame_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = folder_of(pictures(np.array([0.0])), tmp_path / "frames")
    library = models_dir() / "objects"
    monkeypatch.setattr(Slots, "further", lambda slots, objects: 0)
    assert track(library, frames, tmp_path / "out", "--grow", str(tmp_path / "grown")) == 2
    assert "--grow" in (said := capsys.readouterr().err) and "no room for what grows" in said
    assert not (tmp_path / "grown").exists() and not (tmp_path / "out").exists()


class Whole:
    """A box that was seen from all sides."""

    ready = True

    def grown(self, place: AssetPlace) -> SimpleNamespace:
        folder = write_box(Path(place.library) / place.name, place.name, EDGES)
        return SimpleNamespace(built=SimpleNamespace(folder=folder), R_TO=np.eye(3), p_TO=np.zeros(3))


def watched(library: Path) -> GrownAssets:
    growing = {1: SimpleNamespace(growth=Whole())}
    tracker: Any = SimpleNamespace(growing=growing, take_in=lambda identity, *_: growing.pop(identity))
    return GrownAssets(library, tracker, {}, {}, lambda text: None)


def test_what_another_command_has_grown_meanwhile_is_not_written_over(tmp_path: Path) -> None:
    """Two commands that grow into one library at a time may find the same name free."""
    library = tmp_path / "grown"

    first, second = watched(library), watched(library)
    first.poll(0)
    second.poll(0)
    first.close()
    before = check(library / "thing_1")[0].points_O
    with pytest.raises(AssetError, match="another command has put thing_1 there"):
        second.close()
    np.testing.assert_array_equal(check(library / "thing_1")[0].points_O, before)
    assert [path.name for path in library.iterdir()] == ["thing_1"]


def test_a_command_that_is_stopped_while_it_writes_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = tmp_path / "grown"
    grown = watched(library)
    grown.poll(0)
    copy = shutil.copytree

    def stopped(*given: Any, **named: Any) -> None:
        copy(*given, **named)
        raise KeyboardInterrupt

    monkeypatch.setattr(shutil, "copytree", stopped)
    with pytest.raises(KeyboardInterrupt):
        grown.close()
    assert not list(library.iterdir())


def test_where_nothing_grows_it_is_said_what_that_takes(tmp_path: Path) -> None:
    said: list[str] = []
    GrownAssets(tmp_path / "grown", cast(Any, SimpleNamespace(growing={})), {}, {}, said.append).close()
    assert len(said) == 1 and "no unknown thing is followed; one must cover 200 of the pixels" in said[0]
