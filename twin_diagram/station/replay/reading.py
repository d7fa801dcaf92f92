"""Reads what the replay station plays: the messages and frames of a recording, or a measured log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from twin_diagram import logs
from twin_diagram.errors import LogError, ScenarioError, StationError
from twin_diagram.logs.prefixes import under_names_of
from twin_diagram.logs.torque_constants import torque_constants
from twin_diagram.scenario import Camera
from twin_diagram.signals.arrays import Array
from twin_diagram.station.ports import SENSOR_SIZE
from twin_diagram.station.replay.recording_folder import (
    FRAMES,
    GRIPPER,
    LOG,
    MESSAGES,
    SCANS,
    UNFINISHED,
    Manifest,
    depth_file,
    read_manifest,
    rgb_file,
    sensor_file,
)

PICTURES: Final = ("index", "capture", "delivery")
"""Columns that tell of a recording's pictures or scans: number in the files' names, when taken and when shown [s]."""


@dataclass(frozen=True)
class Messages:
    """An arm's messages, one per row.

    Attributes:
        time: (N,) of the measurements [s].
        delivery: (N,) when each came to stand on the ports [s], rising.
        position, velocity, torque: (N, n) [rad, rad/s, N·m].
        gripper: (N, 2g) positions then speeds [m, m/s], or None.
    """

    time: Array
    delivery: Array
    position: Array
    velocity: Array
    torque: Array
    gripper: Array | None = None


@dataclass(frozen=True)
class Frames:
    """A camera's images, which stay in their files.

    Attributes:
        folder: where they are.
        index: (F,) numbers in their names.
        capture: (F,) when each was taken [s].
        delivery: (F,) when each came to stand on the ports [s], rising.
        width, height: of the colour images [pixel].
        depth_size: width and height of the depth images [pixel].
        depth_unit: [m].
    """

    folder: Path
    index: npt.NDArray[np.int64]
    capture: Array
    delivery: Array
    width: int
    height: int
    depth_size: tuple[int, int]
    depth_unit: float


def read_columns(path: Path, cut: bool = False) -> tuple[list[str], Array]:
    """Return header and (N, columns) numbers of a CSV file, floats to the bit.

    Args:
        path: of the file.
        cut: whether its last line may be half a one, which is then left out.

    Raises:
        StationError: missing, or not such a table.
    """
    try:
        with path.open(encoding="utf-8") as file:
            names = file.readline().rstrip("\r\n").split(",")
            rows = file.readlines()
        if cut and rows and not rows[-1].endswith("\n"):
            rows.pop()
        values = np.loadtxt(rows, delimiter=",", ndmin=2) if rows else np.zeros((0, len(names)))
    except OSError as error:
        raise StationError(f"{path}: {error.strerror}") from error
    except ValueError as error:
        raise StationError(f"{path}: not a table of numbers: {error}") from error
    if values.shape[1] != len(names):
        raise StationError(f"{path}: {len(names)} names for {values.shape[1]} columns")
    return names, values


def read_table(path: Path, names: Sequence[str], cut: bool = False) -> Array:
    """Return (N, columns) numbers of a table whose columns are told.

    Args:
        path: of the file.
        names: of the columns that it must have, and no others.
        cut: as of `read_columns`.

    Raises:
        StationError: missing, or not such a table.
    """
    found, values = read_columns(path, cut)
    if found != list(names):
        raise StationError(f"{path}: needs the columns {', '.join(names)}; it has {', '.join(found)}")
    return values


def newest(delivery: Array, time: float) -> int:
    """Return the index of the newest entry that stands on the ports at `time`; -1 before the first.

    What is delivered at a time is seen by events after it, not by those at the same time, as it was while it was
    recorded.

    Args:
        delivery: (N,) rising [s].
        time: [s].
    """
    return int(np.searchsorted(delivery, time, side="left")) - 1


def rising(path: Path, delivery: Array) -> None:
    """Check a table's delivery times.

    Raises:
        StationError: they go back.
    """
    if not np.all(np.isfinite(delivery)) or np.any(np.diff(delivery) < 0):
        row = int(np.argmax(~np.isfinite(delivery) | np.r_[False, np.diff(delivery) < 0]))
        raise StationError(f"{path}: delivery times go back at row {row + 2}")


def read_recording(folder: Path, manifest: Manifest, joints: Sequence[str], fingers: Sequence[str]) -> Messages:
    """Return the messages of a recording.

    Args:
        folder: of the recording.
        manifest: its own.
        joints: of the twin's arm.
        fingers: of the twin's gripper.

    Raises:
        StationError: another arm's, or damaged.
    """
    if list(joints) != manifest.joints:
        raise StationError(f"{folder}: recorded joints {manifest.joints}; the twin's arm has {list(joints)}")
    cut = folder.name == UNFINISHED
    names, values = read_columns(folder / LOG, cut)
    deliveries = read_table(folder / MESSAGES, ("time", "delivery"), cut)
    fingers = fingers if list(fingers) == manifest.gripper_joints else ()
    _, table = read_columns(folder / GRIPPER, cut) if fingers else ([], np.zeros((len(values), 0)))
    if cut:  # a message is written table by table
        whole = min(len(values), len(deliveries), len(table))
        values, deliveries, table = values[:whole], deliveries[:whole], table[:whole]
    if not len(values):
        raise StationError(f"{folder / LOG}: no message in it")
    if len(deliveries) != len(values):
        raise StationError(f"{folder}: {LOG} has {len(values)} rows, {MESSAGES} {len(deliveries)}")
    rising(folder / MESSAGES, deliveries[:, 1])

    if "time" not in names:
        raise StationError(f"{folder / LOG}: no column time")

    def signal(name: str) -> Array:
        try:
            return values[:, [names.index(f"{name}.{joint}") for joint in joints]]
        except ValueError as error:
            raise StationError(f"{folder / LOG}: no column {name} for each of {', '.join(joints)}") from error

    gripper = None
    if fingers:
        if table.shape != (len(values), 1 + 2 * len(fingers)):
            raise StationError(
                f"{folder / GRIPPER}: {table.shape[0]} rows of {table.shape[1]} columns do not fit {LOG}"
            )
        gripper = table[:, 1:]
    return Messages(
        values[:, names.index("time")],
        deliveries[:, 1],
        signal("position_measured"),
        signal("velocity_estimated"),
        signal("torque_measured"),
        gripper,
    )


def read_frames(folder: Path, manifest: Manifest | None, camera: Camera | None) -> Frames:
    """Return the images of a recording; none where it has none.

    Args:
        folder: of the recording.
        manifest: its own; None: there is none.
        camera: that the twin was told of.

    Raises:
        ScenarioError: the twin was told of another camera.
        StationError: an image is missing.
    """
    none = np.zeros(0)
    recorded = manifest.camera if manifest is not None else None
    if camera is None or recorded is None:
        (width, height), depth = ((camera.width, camera.height), camera.depth_size) if camera else ((1, 1), (1, 1))
        return Frames(folder, none.astype(np.int64), none, none, width, height, depth, 1.0)
    for name in ("name", "width", "height"):
        if getattr(camera, name) != getattr(recorded, name):
            raise ScenarioError(
                f"twin.camera.{name}", f"{getattr(camera, name)}; recorded was {getattr(recorded, name)}"
            )
    if camera.depth_size != recorded.depth_size:
        told, there = ("×".join(map(str, size)) for size in (camera.depth_size, recorded.depth_size))
        raise ScenarioError("twin.camera.depth", f"depth of {told} pixels; recorded was {there}")
    images = folder / recorded.name
    table = read_table(images / FRAMES, PICTURES, cut=folder.name == UNFINISHED)
    rising(images / FRAMES, table[:, 2])
    index = table[:, 0].astype(np.int64)
    for k in index:
        for name in (rgb_file(k), depth_file(k)):
            if not (images / name).is_file():
                raise StationError(f"{images / name}: missing from the recording")
    size = (recorded.width, recorded.height)
    return Frames(images, index, table[:, 1], table[:, 2], *size, camera.depth_size, recorded.depth_unit)


@dataclass(frozen=True)
class Readings:
    """Of one further sensor, one per row.

    Attributes:
        time: (N,) when they were taken [s].
        delivery: (N,) when each came to stand on the ports [s], rising.
        values: (N, 6).
    """

    time: Array
    delivery: Array
    values: Array


def read_sensors(folder: Path, manifest: Manifest) -> dict[str, Readings]:
    """Return the readings of a recording's further sensors, by their ports.

    Raises:
        StationError: a table is missing or damaged.
    """
    found = {}
    for k, name in enumerate(manifest.sensors):
        file = folder / sensor_file(k)
        _, table = read_columns(file, cut=folder.name == UNFINISHED)
        if table.shape[1] != 2 + SENSOR_SIZE:
            raise StationError(f"{file}: {table.shape[1]} columns; a sensor's table has {2 + SENSOR_SIZE}")
        rising(file, table[:, 1])
        found[name] = Readings(table[:, 0], table[:, 1], table[:, 2:])
    return found


def recorded_until(folder: Path) -> float:
    """Return when the last message of a recording, picture or scan came [s]; `folder`: as of `place_of`.

    Raises:
        StationError: it holds no message.
    """
    manifest = read_manifest(folder)
    tables = [folder / MESSAGES]
    if manifest.camera is not None:
        tables.append(folder / manifest.camera.name / FRAMES)
    if manifest.lidar is not None:
        tables.append(folder / manifest.lidar.folder / SCANS)
    ends = [table[-1, -1] for _, table in (read_columns(file, cut=True) for file in tables) if len(table)]
    if not ends:
        raise StationError(f"{folder / LOG}: no message in it")
    return float(max(ends))


def read_log(
    path: Path,
    joints: Sequence[str],
    revolute: npt.NDArray[np.bool_],
    columns: str = "",
    constants: Sequence[str] = (),
) -> Messages:
    """Return a measured log in the project's format, its times counted from its first sample.

    Angles go on where they jump by a turn. Of joints without `velocity_estimated`, that is the backward difference
    of positions.

    Args:
        path: CSV, .npz, a ROS bag or an LCM log.
        joints: of the twin's arm, all of which must be in it; n is their number.
        revolute: (n,) which of them turn.
        columns: what a foreign log's columns mean, as `twin_diagram.logs.read_log` takes it; empty: nothing to say.
        constants: of the motors, where the log holds currents, as `torque_constants` takes them; empty: it does not.

    Raises:
        LogError: see `twin_diagram.logs.read_log`; a joint or the torque is missing.
    """
    try:
        measured = under_names_of(joints, logs.read_log(path, columns or None))
        measured = torque_constants(constants).applied(measured, joints) if constants else measured
        log, _ = logs.unwrapped(measured.select(joints), revolute)
        torque = log.motor_torque
    except LogError as error:
        raise LogError(f"replay.log: {error}") from error
    time = log.time - log.time[0]
    steps = np.diff(log.position, axis=0) / np.diff(log.time)[:, None]
    velocity = np.vstack([np.zeros((1, len(joints))), steps])
    if log.velocity is not None:
        velocity = np.where(np.isnan(log.velocity), velocity, log.velocity)
    return Messages(time, time, log.position, velocity, torque)
