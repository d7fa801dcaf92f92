"""Records what a station's ports show while a run goes on, so that the replay station can show it again to the bit.

A recording is a folder:

- ``manifest.yaml``: version, joints, camera, depth unit;
- ``log.csv``: the arm's messages, in the project's log format, floats written so that they read back to the bit;
- ``messages.csv``: when each of them came to stand on the ports;
- ``gripper.csv``: the fingers' positions and speeds, where the robot has a gripper;
- ``sensor_<k>.csv``: readings of the k-th further sensor of the manifest, with measurement and delivery times;
- ``<lidar>.lidar/``: ``scan_<k>.npz`` (ranges, to the bit) and ``scans.csv`` (capture and delivery times);
- ``<camera>/``: ``rgb_<k>.png``, ``depth_<k>.png`` (16 bit, in depth units) and ``frames.csv`` (capture and delivery
times).

It is written under a temporary name beside its own and renamed once it is whole.
"""

from __future__ import annotations

import shutil
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Final, TextIO

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from twin_diagram.errors import StationError
from twin_diagram.runtime import atomic_file
from twin_diagram.station import ports
from twin_diagram.station.depth_units import depth_to_units
from twin_diagram.station.ports import SENSOR_SIZE


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    version: int = 1
    """Of the folder's layout; a reader refuses another."""

    pending: int = 8
    """Images and scans that may wait to be written."""


TUNING = Tuning()
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


def _row(values: Sequence[float] | npt.NDArray[np.float64]) -> str:
    return ",".join(map(repr, map(float, values))) + "\n"


class RecordingWriter:
    """Writes one recording; a context manager that keeps it where the run ended well and drops it otherwise."""

    def __init__(self, folder: str | Path, manifest: Manifest) -> None:
        """Open a recording.

        Args:
            folder: where it goes; may exist as an earlier recording, which is replaced in the end.
            manifest: what will be in it.

        Raises:
            StationError: `folder` holds something else, or cannot be written.
        """
        self._folder = Path(folder).expanduser().absolute()
        self.manifest = manifest
        if self._folder.exists() and not (self._folder / MANIFEST).is_file():
            if not self._folder.is_dir() or any(self._folder.iterdir()):
                raise StationError(f"{self._folder}: there is something that is no recording; name another folder")
        self._made = [parent for parent in self._folder.parents if not parent.exists()]
        try:
            self._staging = atomic_file.make_aside(self._folder)
        except OSError as error:
            raise StationError(f"{self._folder}: cannot be written: {error.strerror}") from error
        data = asdict(manifest)
        (self._staging / MANIFEST).write_text(yaml.safe_dump(data, sort_keys=False))
        joints = manifest.joints
        signals = ("position_measured", "velocity_estimated", "torque_measured", "position_commanded")
        self._files: list[TextIO] = []
        self._log = self._open(LOG, ["time", *(f"{signal}.{joint}" for signal in signals for joint in joints)])
        self._messages = self._open(MESSAGES, ["time", "delivery"])
        self._gripper = None
        if manifest.gripper_joints:
            columns = [f"{s}.{j}" for s in ("position_measured", "velocity_estimated") for j in manifest.gripper_joints]
            self._gripper = self._open(GRIPPER, ["time", *columns])
        columns = ["time", "delivery", *(str(i) for i in range(SENSOR_SIZE))]
        self._sensors = {name: self._open(sensor_file(k), columns) for k, name in enumerate(manifest.sensors)}
        self._frames = None
        self._count = 0
        if manifest.camera is not None:
            (self._staging / manifest.camera.name).mkdir()
            self._frames = self._open(f"{manifest.camera.name}/{FRAMES}", ["index", "capture", "delivery"])
        self._scans = None
        self._scan_count = 0
        if manifest.lidar is not None:
            (self._staging / manifest.lidar.folder).mkdir()
            self._scans = self._open(f"{manifest.lidar.folder}/{SCANS}", ["index", "capture", "delivery"])
        self._pool = ThreadPoolExecutor(1, "image-writer")
        self._pending: deque[Future[None]] = deque()
        self._open_still = True

    def _open(self, name: str, columns: Sequence[str]) -> TextIO:
        file = (self._staging / name).open("w", encoding="utf-8", newline="")
        file.write(",".join(columns) + "\n")
        self._files.append(file)
        return file

    def attach(self, name: str, text: str) -> None:
        """Put a text file into the recording, e.g. the scenario that was run."""
        (self._staging / name).write_text(text, encoding="utf-8")

    def message(self, time: float, delivery: float, signals: Mapping[str, npt.NDArray[np.float64]]) -> None:
        """Write one message of the arm.

        Args:
            time: of the measurement [s].
            delivery: when it came to stand on the ports [s].
            signals: (n,) each of position_measured, velocity_estimated, torque_measured and position_commanded; (2g) of
                gripper, where there is one.
        """
        order = ("position_measured", "velocity_estimated", "torque_measured", "position_commanded")
        self._log.write(_row(np.concatenate([[time], *(signals[name] for name in order)])))
        self._messages.write(_row([time, delivery]))
        if self._gripper is not None:
            self._gripper.write(_row(np.concatenate([[time], signals["gripper"]])))

    def reading(self, sensor: str, time: float, delivery: float, values: npt.NDArray[np.float64]) -> None:
        """Write one reading (6,) of a further sensor, by its port's name; times as of `message`."""
        self._sensors[sensor].write(_row([time, delivery, *values]))

    def image(
        self, capture: float, delivery: float, rgb: npt.NDArray[np.uint8], depth: npt.NDArray[np.float32]
    ) -> None:
        """Write one image in the background; waits where too many are on their way.

        Args:
            capture: when it was taken [s].
            delivery: when it came to stand on the ports [s].
            rgb: (H, W, 4); copied.
            depth: (H, W) [m]; copied.
        """
        assert self.manifest.camera is not None and self._frames is not None
        folder = self._staging / self.manifest.camera.name
        k = self._count
        self._count += 1
        colour = np.ascontiguousarray(rgb[..., 2::-1])
        counts = depth_to_units(depth, self.manifest.camera.depth_unit)
        self._submit(_write_images, folder, k, colour, counts)
        self._frames.write(f"{k},{capture!r},{delivery!r}\n")

    def scan(self, capture: float, delivery: float, ranges: npt.NDArray[np.float64]) -> None:
        """Write one scan (rows · columns,) [m] in the background, as `image`; copied."""
        assert self.manifest.lidar is not None and self._scans is not None
        k = self._scan_count
        self._scan_count += 1
        self._submit(_write_scan, self._staging / self.manifest.lidar.folder / scan_file(k), np.array(ranges))
        self._scans.write(f"{k},{capture!r},{delivery!r}\n")

    def _submit(self, write: Callable[..., None], *what: Any) -> None:
        while len(self._pending) >= TUNING.pending or (self._pending and self._pending[0].done()):
            self._pending.popleft().result()
        self._pending.append(self._pool.submit(write, *what))

    def close(self) -> None:
        """Finish the recording and gives it its name; no more than once has an effect.

        Raises:
            StationError: it could not be written whole.
        """
        if not self._open_still:
            return
        try:
            while self._pending:
                self._pending.popleft().result()
            self._shut()
            atomic_file.put_in_place(self._staging, self._folder)
        except OSError as error:
            self.abort()
            raise StationError(f"{self._folder}: cannot be written: {error.strerror}") from error

    def abort(self) -> None:
        """Drop the recording, and the folders above it that were made for it."""
        self._shut()
        shutil.rmtree(self._staging, ignore_errors=True)
        with suppress(OSError):  # somebody else uses them by now
            for parent in self._made:
                parent.rmdir()

    def _shut(self) -> None:
        self._open_still = False
        self._pool.shutdown(wait=True, cancel_futures=True)
        for file in self._files:
            file.close()

    def __enter__(self) -> RecordingWriter:
        """Itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Keep the recording where no exception ended it."""
        if kind is None:
            self.close()
        else:
            self.abort()


def _write_images(folder: Path, k: int, colour: npt.NDArray[np.uint8], counts: npt.NDArray[np.uint16]) -> None:
    fast = [cv2.IMWRITE_PNG_COMPRESSION, 1]
    for name, image in ((rgb_file(k), colour), (depth_file(k), counts)):
        if not cv2.imwrite(str(folder / name), image, fast):
            raise OSError(0, f"{name} could not be written", str(folder / name))


def _write_scan(file: Path, ranges: npt.NDArray[np.float64]) -> None:
    np.savez_compressed(file, ranges=ranges)


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
    return manifest
