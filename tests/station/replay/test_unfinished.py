"""Recordings whose process was killed, wherever it was, and what stays in a folder that is recorded into again."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from twin_diagram.errors import StationError
from twin_diagram.runtime import written_files
from twin_diagram.station.replay.reading import Frames, Messages, read_frames, read_recording, recorded_until
from twin_diagram.station.replay.recording import RecordingWriter
from twin_diagram.station.replay.recording_folder import (
    FILES,
    UNFINISHED,
    Manifest,
    RecordedCamera,
    place_of,
    read_manifest,
)
from twin_diagram.station.replay.scan_player import read_scans

EYE = RecordedCamera("eye", 4, 3, 15.0, 0.01, 0.001)
SIGNALS = ("position_measured", "velocity_estimated", "torque_measured", "position_commanded", "gripper")


def write(folder: Path, count: int = 10, first: int = 0, rows: object = None) -> RecordingWriter:
    """Begins a recording of an arm with a finger and a camera: `count` messages, a picture with every other one."""
    writer = RecordingWriter(folder, Manifest(["a"], ["f"], EYE), rows)  # type: ignore[arg-type]
    for k in range(first, first + count):
        values = {name: np.full(2 if name == "gripper" else 1, 0.1 * k) for name in SIGNALS}
        writer.message(0.1 * k, 0.1 * k + 0.01, values)
        if k % 2 == 0:
            rgb, depth = np.full((3, 4, 4), k, np.uint8), np.full((3, 4), 0.01 * k, np.float32)
            writer.image(0.1 * k, 0.1 * k + 0.02, rgb, depth)
    return writer


def written(writer: RecordingWriter) -> None:
    """Waits until what is under way has been written."""
    for future in writer._pending:
        future.result()


def read(folder: Path) -> tuple[Messages, Frames]:
    place = place_of(folder)
    manifest = read_manifest(place)
    camera = manifest.camera
    return read_recording(place, manifest, ["a"], ["f"]), read_frames(place, manifest, camera)  # type: ignore[arg-type]


def killed(folder: Path, to: Path) -> Path:
    """What a killed process would have left."""
    return Path(shutil.copytree(folder, to))


def test_what_was_recorded_is_there_at_once(tmp_path: Path) -> None:
    writer = write(tmp_path / "r")
    written(writer)
    messages, frames = read(killed(tmp_path / "r", tmp_path / "k"))
    assert len(messages.time) == 10 and list(frames.index) == [0, 1, 2, 3, 4]
    assert recorded_until(place_of(tmp_path / "k")) == pytest.approx(0.91)
    assert messages.gripper is not None and messages.gripper[-1] == pytest.approx([0.9, 0.9])
    writer.abort()
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize("name", ["log.csv", "messages.csv", "gripper.csv"])
@pytest.mark.parametrize("cut", [1, 5, 30])
def test_half_a_line_is_none(name: str, cut: int, tmp_path: Path) -> None:
    """Each table may be behind the others; what is whole in all of them counts, where the recording was cut off."""
    writer = write(tmp_path / "r")
    written(writer)
    file = killed(tmp_path / "r", tmp_path / "k") / UNFINISHED / name
    text = file.read_text()
    file.write_text(text[:-cut])
    whole = text[:-cut].count("\n") - 1
    messages, _ = read(tmp_path / "k")
    assert len(messages.time) == len(messages.position) == len(messages.gripper) == whole < 10  # type: ignore[arg-type]
    assert messages.position[-1, 0] == pytest.approx(0.1 * (whole - 1))
    writer.close()
    file = tmp_path / "r" / name
    file.write_text(file.read_text()[:-cut])
    if cut > 1:  # in one that was closed, that is damage
        with pytest.raises(StationError):
            read(tmp_path / "r")


def test_a_row_tells_of_no_picture_that_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from twin_diagram.station.replay import recording

    seen = []

    def slow(folder: Path, k: int, *images: object) -> None:
        seen.append((folder / "frames.csv").read_text().count("\n") - 1)
        real(folder, k, *images)

    real = recording._write_images
    monkeypatch.setattr(recording, "_write_images", slow)
    writer = write(tmp_path / "r")
    writer.close()
    assert seen == [0, 1, 2, 3, 4]
    frames = tmp_path / "r" / "eye" / "frames.csv"
    assert frames.read_text().count("\n") == 6


@pytest.mark.parametrize("step", range(7))
def test_killed_while_its_files_move_up(step: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "r", 4).close()
    replace, moved = os.replace, []

    class Killed(BaseException):
        pass

    def until(source: Path, target: Path) -> None:
        if len(moved) == step:
            raise Killed
        moved.append(source)
        replace(source, target)

    writer = write(tmp_path / "r", 10)
    writer.attach("scenario.yaml", "the newest")
    monkeypatch.setattr(written_files.os, "replace", until)
    with pytest.raises(Killed):
        writer.close()
    monkeypatch.undo()
    messages, frames = read(tmp_path / "r")
    assert len(messages.time) == 10 and len(frames.index) == 5
    assert (place_of(tmp_path / "r") / "scenario.yaml").read_text() == "the newest"
    write(tmp_path / "r", 3).close()  # and the next one takes its place
    assert len(read(tmp_path / "r")[0].time) == 3
    assert not (tmp_path / "r" / UNFINISHED).exists()


def test_one_killed_before_its_first_message_leaves_the_one_before(tmp_path: Path) -> None:
    write(tmp_path / "r", 4).close()
    RecordingWriter(tmp_path / "r", Manifest(["a"], ["f"], EYE))
    assert len(read(tmp_path / "r")[0].time) == 4
    with pytest.raises(StationError, match="no message"):
        RecordingWriter(tmp_path / "new", Manifest(["a"], ["f"], EYE))
        read(tmp_path / "new")


def test_a_newer_one_that_was_killed_comes_first(tmp_path: Path) -> None:
    write(tmp_path / "r", 4).close()
    written(write(tmp_path / "r", 7))
    assert len(read(tmp_path / "r")[0].time) == 7


@pytest.mark.parametrize("listed", [True, False], ids=["", "of a version without lists"])
def test_what_else_is_in_the_folder_stays(listed: bool, tmp_path: Path) -> None:
    write(tmp_path / "r", 10).close()
    if not listed:
        (tmp_path / "r" / FILES).unlink()
    mine = {"notes.txt", "eye/mine.png", "eye/rgb_000004_marked.png", "plots/a.pdf", "log.csv.bak"}
    for name in mine:
        (tmp_path / "r" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "r" / name).write_text("mine")
    write(tmp_path / "r", 4).close()
    left = set(written_files.files_of(tmp_path / "r"))
    assert mine < left and all((tmp_path / "r" / name).read_text() == "mine" for name in mine)
    assert left - mine == {*written_files.listed(tmp_path / "r", FILES), FILES}
    assert len(list((tmp_path / "r" / "eye").glob("rgb_??????.png"))) == 2, "pictures of the first are gone"


def test_ctrl_c_keeps_what_was_recorded(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), write(tmp_path / "r", 3):
        raise KeyboardInterrupt
    assert len(read(tmp_path / "r")[0].time) == 3 and not (tmp_path / "r" / UNFINISHED).exists()
    with pytest.raises(KeyboardInterrupt), write(tmp_path / "empty", 0):
        raise KeyboardInterrupt
    assert not (tmp_path / "empty").exists()


def test_a_full_disk_is_said_and_what_was_recorded_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(StationError, match=r"No space left on device.*replays from .*unfinished"):
        with write(tmp_path / "r", 5) as writer:
            written(writer)
            monkeypatch.setattr("twin_diagram.station.replay.recording._row", full)
            values = {name: np.zeros(2 if name == "gripper" else 1) for name in SIGNALS}
            writer.message(1.0, 1.0, values)
    assert len(read(tmp_path / "r")[0].time) == 5


def test_a_disk_that_is_full_at_the_last_picture_costs_no_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    writer = write(tmp_path / "r", 5)
    written(writer)
    monkeypatch.setattr("twin_diagram.station.replay.recording._write_images", full)
    writer.image(1.0, 1.0, np.zeros((3, 4, 4), np.uint8), np.zeros((3, 4), np.float32))
    with pytest.raises(StationError, match=r"No space left on device.*replays from .*unfinished"):
        writer.close()
    assert len(read(tmp_path / "r")[0].time) == 5


def test_rows_come_as_numbers_too(tmp_path: Path) -> None:
    with (tmp_path / "rows").open("w+b") as rows:
        write(tmp_path / "r", 6, rows=rows).close()
        rows.seek(0)
        table = np.frombuffer(rows.read()).reshape(6, 5)
    assert np.array_equal(table, np.loadtxt(tmp_path / "r" / "log.csv", delimiter=",", skiprows=1))


def test_scans_follow_the_same_way(tmp_path: Path) -> None:
    from twin_diagram.scenario import Lidar
    from twin_diagram.station.replay.recording_folder import RecordedLidar

    lidar = RecordedLidar("room", 3, 2)
    writer = RecordingWriter(tmp_path / "r", Manifest(["a"], lidar=lidar))
    writer.message(0.0, 0.0, {name: np.zeros(1) for name in SIGNALS})
    for k in range(3):
        writer.scan(0.1 * k, 0.1 * k + 0.3, np.full(6, float(k)))
    written(writer)
    assert recorded_until(place_of(tmp_path / "r")) == pytest.approx(0.5)
    table = tmp_path / "r" / UNFINISHED / lidar.folder / "scans.csv"
    table.write_text(table.read_text()[:-1])
    place = place_of(tmp_path / "r")
    scans = read_scans(place, read_manifest(place), Lidar(name="room", columns=3, rows=2))
    assert scans is not None and list(scans.index) == [0, 1]
