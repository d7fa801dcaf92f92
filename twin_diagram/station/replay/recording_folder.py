"""The folder of a recording: its files, its manifest, and where it is while it grows.

A recording is a folder:

- ``manifest.yaml``: version, joints, camera, depth unit;
- ``log.csv``: the arm's messages, in the project's log format, floats written so that they read back to the bit;
- ``messages.csv``: when each of them came to stand on the ports;
- ``gripper.csv``: the fingers' positions and speeds, where the robot has a gripper;
- ``sensor_<k>.csv``: readings of the k-th further sensor of the manifest, with measurement and delivery times;
- ``<lidar>.lidar/``: ``scan_<k>.npz`` (ranges, to the bit) and ``scans.csv`` (capture and delivery times);
- ``<camera>/``: ``rgb_<k>.png``, ``depth_<k>.png`` (16 bit, in depth units) and ``frames.csv`` (capture and delivery
times);
- ``recording_files.txt``: the names of all these, by which the next recording there removes them and nothing else.

It grows in ``unfinished/`` in its folder, line by line, and moves up once it is whole. Where the process was killed, it
stays there, and replays up to its last line; a row tells of no picture or scan that is not there.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from twin_diagram.errors import StationError
from twin_diagram.runtime import written_files
from twin_diagram.station import ports


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    version: int = 1
    """Of the folder's layout; a reader refuses another."""


TUNING = Tuning()
UNFINISHED: Final = "unfinished"
"""Folder in a recording's own, in which it grows."""
SCENARIO_FILE: Final = "scenario.yaml"
"""The scenario that was run."""
FILES: Final = "recording_files.txt"
"""Tells what else was written; see `written_files`."""
MANIFEST: Final = "manifest.yaml"
"""Tells the version, joints, camera and sensors."""
LOG: Final = "log.csv"
"""The measured log, as `logs` reads it."""
MESSAGES: Final = "messages.csv"
"""When each message was measured and delivered [s]."""
GRIPPER: Final = "gripper.csv"
"""The fingers' states by message."""
FRAMES: Final = "frames.csv"
"""When each picture was taken and delivered [s]."""
SCANS: Final = "scans.csv"
"""When each scan was taken and delivered [s]."""


@dataclass
class RecordedCamera:
    """What a recording says about its camera; see `scenario.Camera`."""

    name: str
    width: int
    height: int
    rate: float
    latency: float
    depth_unit: float
    """Depth images hold a whole number of these [m]."""
    depth_shape: list[int] | None = None
    """Width and height of the depth images [px]; none, as in recordings of earlier versions: those of the colours."""

    @property
    def depth_size(self) -> tuple[int, int]:
        """Width and height of the depth images [px]."""
        width, height = self.depth_shape or (self.width, self.height)
        return width, height


@dataclass
class RecordedLidar:
    """What a recording says about its lidar; see `scenario.Lidar`."""

    name: str
    columns: int
    rows: int

    @property
    def folder(self) -> str:
        """Where its scans are, in the recording; named as its port, so that it cannot be a camera's."""
        return ports.lidar(self.name)


@dataclass
class Manifest:
    """What a recording holds."""

    joints: list[str]
    gripper_joints: list[str] = field(default_factory=list)
    camera: RecordedCamera | None = None
    sensors: list[str] = field(default_factory=list)
    """Ports of further sensors."""
    lidar: RecordedLidar | None = None
    version: int = TUNING.version


def rgb_file(k: int) -> str:
    """Return the name of the k-th colour image."""
    return f"rgb_{k:06d}.png"


def depth_file(k: int) -> str:
    """Return the name of the k-th depth image."""
    return f"depth_{k:06d}.png"


def scan_file(k: int) -> str:
    """Return the name of the k-th scan."""
    return f"scan_{k:06d}.npz"


def sensor_file(k: int) -> str:
    """Return the name of the table of the k-th further sensor."""
    return f"sensor_{k}.csv"


def unlisted(folder: Path) -> list[str]:
    """Return the files of a recording of versions that left no list, as its manifest has them."""
    if not (folder / MANIFEST).is_file() or (folder / FILES).is_file():
        return []
    names = [MANIFEST, SCENARIO_FILE, LOG, MESSAGES, GRIPPER]
    try:
        manifest = read_manifest(folder)
    except StationError:
        return names
    names += map(sensor_file, range(len(manifest.sensors)))
    for place, table, files in (
        (manifest.camera and manifest.camera.name, FRAMES, (rgb_file, depth_file)),
        (manifest.lidar and manifest.lidar.folder, SCANS, (scan_file,)),
    ):
        if place and (folder / place / table).is_file():
            count = (folder / place / table).read_text(encoding="utf-8").count("\n")
            names += [f"{place}/{table}", *(f"{place}/{name(k)}" for k in range(count) for name in files)]
    return names


def finish(folder: Path) -> None:
    """Move a recording up whose process was killed while it did so: the manifest goes first."""
    unfinished = folder / UNFINISHED
    if (folder / MANIFEST).is_file() and (unfinished / FILES).is_file() and not (unfinished / MANIFEST).is_file():
        written_files.move(unfinished, folder, last=FILES)


def place_of(folder: Path) -> Path:
    """Return where the files of a recording are: in its folder, or below, where its process was killed.

    Raises:
        StationError: it was killed at its very end, and cannot be finished.
    """
    try:
        finish(folder)
        unfinished = folder / UNFINISHED
        if not (unfinished / MANIFEST).is_file():
            return folder
        with (unfinished / MESSAGES).open(encoding="utf-8") as file:
            begun = sum(line.endswith("\n") for _, line in zip(range(2), file, strict=False)) == 2
    except OSError as error:
        raise StationError(f"{folder}: {error.strerror}") from error
    return unfinished if begun or not (folder / MANIFEST).is_file() else folder


def read_manifest(folder: Path) -> Manifest:
    """Return what a recording's folder holds.

    Raises:
        StationError: no recording, or one of another version.
    """
    file = folder / MANIFEST
    if not file.is_file():
        raise StationError(f"replay.log: {folder} is no recording: no {MANIFEST} in it")
    try:
        data: Any = yaml.safe_load(file.read_text())
        camera, lidar = data.pop("camera"), data.pop("lidar", None)  # recordings of earlier versions name no lidar
        manifest = Manifest(
            **data,
            camera=RecordedCamera(**camera) if camera else None,
            lidar=RecordedLidar(**lidar) if lidar else None,
        )
    except (yaml.YAMLError, TypeError, KeyError, AttributeError, UnicodeDecodeError) as error:
        raise StationError(f"replay.log: {file} is not a recording's manifest: {error}") from error
    if manifest.version != TUNING.version:
        raise StationError(f"replay.log: {file}: version {manifest.version}; this program reads {TUNING.version}")
    _check(file, manifest)
    return manifest


def _check(file: Path, manifest: Manifest) -> None:
    """Refuse a manifest whose values are of other kinds than those that are written."""
    lists: dict[str, Any] = {name: getattr(manifest, name) for name in ("joints", "gripper_joints", "sensors")}
    for name, value in lists.items():
        if not (isinstance(value, list) and all(isinstance(each, str) for each in value)):
            raise StationError(f"replay.log: {file}: {name}: {value!r} is no list of names")
    camera, lidar = manifest.camera, manifest.lidar
    sizes: dict[str, Any] = {}
    if camera is not None:
        sizes |= {"camera.width": camera.width, "camera.height": camera.height}
        for k, size in enumerate(camera.depth_shape or []):
            sizes[f"camera.depth_shape[{k}]"] = size
        if camera.depth_shape is not None and len(sizes) != 4:
            raise StationError(
                f"replay.log: {file}: camera.depth_shape: {camera.depth_shape!r} is not width and height"
            )
        if not (isinstance(camera.depth_unit, (int, float)) and 0.0 < camera.depth_unit < np.inf):
            raise StationError(f"replay.log: {file}: camera.depth_unit: {camera.depth_unit!r} is not a length")
    if lidar is not None:
        sizes |= {"lidar.columns": lidar.columns, "lidar.rows": lidar.rows}
    for name, size in sizes.items():
        if not (isinstance(size, int) and size > 0):
            raise StationError(f"replay.log: {file}: {name}: {size!r} is no number of pixels or beams")
