"""Records what a station's ports show while a run goes on, so that the replay station can show it again to the bit."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, NoReturn, TextIO

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from twin_diagram.errors import StationError
from twin_diagram.runtime import written_files
from twin_diagram.station.depth_units import depth_to_units
from twin_diagram.station.ports import SENSOR_SIZE
from twin_diagram.station.replay.recording_folder import (
    FILES,
    FRAMES,
    GRIPPER,
    LOG,
    MANIFEST,
    MESSAGES,
    SCANS,
    UNFINISHED,
    Manifest,
    depth_file,
    finish,
    rgb_file,
    scan_file,
    sensor_file,
    unlisted,
)


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    pending: int = 8
    """Images and scans that may wait to be written."""


TUNING = Tuning()


def _row(values: Sequence[float] | npt.NDArray[np.float64]) -> str:
    return ",".join(map(repr, map(float, values))) + "\n"


class RecordingWriter:
    """Writes one recording; a context manager that keeps it where the run ended well or was stopped, and drops it else.

    What was recorded until a disk was full is left `unfinished`.
    """

    def __init__(self, folder: str | Path, manifest: Manifest, rows: BinaryIO | None = None) -> None:
        """Open a recording.

        Args:
            folder: where it goes; may exist as an earlier recording, whose files are replaced in the end.
            manifest: what will be in it.
            rows: gets the log's rows as doubles, too, for those who cannot wait for its text to be read.

        Raises:
            StationError: `folder` holds something else, or cannot be written.
        """
        self._folder = Path(folder).expanduser().absolute()
        self.manifest = manifest
        self._staging = self._folder / UNFINISHED
        if self._folder.exists() and not any((at / MANIFEST).is_file() for at in (self._folder, self._staging)):
            if not self._folder.is_dir() or any(self._folder.iterdir()):
                raise StationError(f"{self._folder}: there is something that is no recording; name another folder")
        self._made = [place for place in (self._folder, *self._folder.parents) if not place.exists()]
        self._files: list[TextIO] = []
        self._rows, self._count, self._scan_count, self._messages_written = rows, 0, 0, 0
        self._pool = ThreadPoolExecutor(1, "image-writer")
        self._pending: deque[Future[None]] = deque()
        self._open_still, self._full = True, False
        try:
            finish(self._folder)
            written_files.remove(self._staging, FILES)  # of a run that was killed
            self._staging.mkdir(parents=True, exist_ok=True)
            self._begin(manifest)
        except OSError as error:
            self.abort()
            raise StationError(f"{self._folder}: cannot be written: {error.strerror}") from error

    def _begin(self, manifest: Manifest) -> None:
        """Write the manifest and open the tables."""
        self.attach(MANIFEST, yaml.safe_dump(asdict(manifest), sort_keys=False))
        joints = manifest.joints
        signals = ("position_measured", "velocity_estimated", "torque_measured", "position_commanded")
        self._log = self._open(LOG, ["time", *(f"{signal}.{joint}" for signal in signals for joint in joints)])
        self._messages = self._open(MESSAGES, ["time", "delivery"])
        self._gripper = None
        if manifest.gripper_joints:
            columns = [f"{s}.{j}" for s in ("position_measured", "velocity_estimated") for j in manifest.gripper_joints]
            self._gripper = self._open(GRIPPER, ["time", *columns])
        columns = ["time", "delivery", *(str(i) for i in range(SENSOR_SIZE))]
        self._sensors = {name: self._open(sensor_file(k), columns) for k, name in enumerate(manifest.sensors)}
        self._frames = None
        if manifest.camera is not None:
            (self._staging / manifest.camera.name).mkdir(exist_ok=True)
            self._frames = self._open(f"{manifest.camera.name}/{FRAMES}", ["index", "capture", "delivery"])
        self._scans = None
        if manifest.lidar is not None:
            (self._staging / manifest.lidar.folder).mkdir(exist_ok=True)
            self._scans = self._open(f"{manifest.lidar.folder}/{SCANS}", ["index", "capture", "delivery"])

    def _open(self, name: str, columns: Sequence[str]) -> TextIO:
        written_files.note(self._staging, FILES, [name])
        # By lines, so that what was recorded is there whenever the process is killed.
        file = (self._staging / name).open("w", encoding="utf-8", newline="", buffering=1)
        file.write(",".join(columns) + "\n")
        self._files.append(file)
        return file

    def attach(self, name: str, text: str) -> None:
        """Put a text file into the recording, e.g. the scenario that was run."""
        written_files.note(self._staging, FILES, [name])
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
        row = np.concatenate([[time], *(signals[name] for name in order)])
        try:
            self._log.write(_row(row))
            self._messages.write(_row([time, delivery]))
            if self._gripper is not None:
                self._gripper.write(_row(np.concatenate([[time], signals["gripper"]])))
            if self._rows is not None:
                self._rows.write(row.tobytes())
        except OSError as error:
            self._end_full(error)
        self._messages_written += 1

    def reading(self, sensor: str, time: float, delivery: float, values: npt.NDArray[np.float64]) -> None:
        """Write one reading (6,) of a further sensor, by its port's name; times as of `message`."""
        try:
            self._sensors[sensor].write(_row([time, delivery, *values]))
        except OSError as error:
            self._end_full(error)

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
        names = [f"{folder.name}/{name(k)}" for name in (rgb_file, depth_file)]
        colour = np.ascontiguousarray(rgb[..., 2::-1])
        counts = depth_to_units(depth, self.manifest.camera.depth_unit)
        write = partial(_write_images, folder, k, colour, counts)
        self._submit(names, write, self._frames, f"{k},{capture!r},{delivery!r}\n")

    def scan(self, capture: float, delivery: float, ranges: npt.NDArray[np.float64]) -> None:
        """Write one scan (rows · columns,) [m] in the background, as `image`; copied."""
        assert self.manifest.lidar is not None and self._scans is not None
        k = self._scan_count
        self._scan_count += 1
        name = f"{self.manifest.lidar.folder}/{scan_file(k)}"
        write = partial(_write_scan, self._staging / name, np.array(ranges))
        self._submit([name], write, self._scans, f"{k},{capture!r},{delivery!r}\n")

    def _submit(self, names: Sequence[str], write: Callable[[], None], table: TextIO, row: str) -> None:
        """Have files written, and then the row that tells of them."""
        try:
            while len(self._pending) >= TUNING.pending or (self._pending and self._pending[0].done()):
                self._pending.popleft().result()
            written_files.note(self._staging, FILES, names)
        except OSError as error:
            self._end_full(error)
        self._pending.append(self._pool.submit(_write_both, write, table, row))

    def _end_full(self, error: OSError) -> NoReturn:
        self._full = True
        kept = f"; what was recorded until then replays from {self._staging}" if self._messages_written else ""
        raise StationError(f"{self._folder}: cannot be written: {error.strerror or error}{kept}") from error

    def close(self) -> None:
        """Finish the recording, whose files take the place of an earlier one's; no more than once has an effect.

        Raises:
            StationError: it could not be written whole.
        """
        if not self._open_still:
            return
        try:
            while self._pending:
                self._pending.popleft().result()
            self._shut()
            written_files.remove(self._folder, FILES, unlisted(self._folder))
            written_files.move(self._staging, self._folder, first=MANIFEST, last=FILES)
        except OSError as error:
            self._full = True
            self.abort()
            self._end_full(error)

    def abort(self) -> None:
        """Drop the recording and the folders that were made for it; leave it where a full disk ended it."""
        with suppress(OSError):
            self._shut()
        if self._full and self._messages_written:
            return
        written_files.remove(self._staging, FILES)
        with suppress(OSError):  # somebody else uses them by now
            for place in (self._staging, *self._made):
                place.rmdir()

    def _shut(self) -> None:
        self._open_still = False
        self._pool.shutdown(wait=True, cancel_futures=True)
        for file in self._files:
            file.close()

    def __enter__(self) -> RecordingWriter:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Keep the recording where no exception ended it, and where the user did after its first message."""
        if kind is None or (issubclass(kind, KeyboardInterrupt) and self._messages_written):
            self.close()
        else:
            self.abort()


def _write_both(write: Callable[[], None], table: TextIO, row: str) -> None:
    write()
    table.write(row)


def _write_images(folder: Path, k: int, colour: npt.NDArray[np.uint8], counts: npt.NDArray[np.uint16]) -> None:
    fast = [cv2.IMWRITE_PNG_COMPRESSION, 1]
    for name, image in ((rgb_file(k), colour), (depth_file(k), counts)):
        if not cv2.imwrite(str(folder / name), image, fast):
            raise OSError(0, f"{name} could not be written", str(folder / name))


def _write_scan(file: Path, ranges: npt.NDArray[np.float64]) -> None:
    np.savez_compressed(file, ranges=ranges)
