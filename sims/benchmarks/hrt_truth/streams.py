"""What a run leaves behind: sensor streams for the methods, and the truth for the scorer alone."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Table = TypeVar("Table", "Streams", "Truth")


@dataclass(frozen=True)
class Streams:
    """All that a twin may read. Row k of a group belongs to its time k; `…_arrives` is when it is delivered [s].

    Attributes:
        time: (N,) of the arm's messages [s].
        q: (N, n) measured [rad].
        v: (N, n) measured [rad/s].
        tau: (N, n) motor torque from currents, mean since the message before [N·m].
        asked, asked_rate: (N, n) what the drive was told [rad], [rad/s].
        camera_time, camera_arrives: (C,) [s].
        camera: (C, 7) hand pose in W, quaternion wxyz and position [m].
        camera_look: (C, 2) share of the hand that is covered, mean brightness of its image (0 to 1).
        imu_time: (I,) [s].
        imu: (I, 6) angular velocity, specific force, in the hand's frame.
        wrench_time: (F,) [s].
        wrench: (F, 6) moment, force, in the last link's frame.
        lidar_time, lidar_arrives: (L,) [s].
        lidar: (L, 7) hand pose in W after registration.
        lidar_range: (L,) distance of the hand from the lidar [m].
    """

    time: Array
    q: Array
    v: Array
    tau: Array
    asked: Array
    asked_rate: Array
    camera_time: Array
    camera_arrives: Array
    camera: Array
    camera_look: Array
    imu_time: Array
    imu: Array
    wrench_time: Array
    wrench: Array
    lidar_time: Array
    lidar_arrives: Array
    lidar: Array
    lidar_range: Array


@dataclass(frozen=True)
class Truth:
    """What was true, at the times of the arm's messages.

    Attributes:
        time: (N,) [s].
        q: (N, n) [rad].
        v: (N, n) [rad/s].
        hand: (N, 7) pose of the hand in W.
        hand_speed: (N, 3) [m/s].
        mass: (N,) payload [kg].
        friction: (N, n) level of dry friction [N·m].
        torque_error: (n,) measured less given [N·m].
        fault: (2,) when a fault began and ended [s]; NaN where there is none.
        outliers: (C,) 1 where the camera saw something else.
    """

    time: Array
    q: Array
    v: Array
    hand: Array
    hand_speed: Array
    mass: Array
    friction: Array
    torque_error: Array
    fault: Array
    outliers: Array


def save(path: Path, table: Streams | Truth) -> None:
    """Writes to a temporary name and renames it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part.npz")
    np.savez_compressed(part, **{f.name: getattr(table, f.name) for f in fields(table)})
    part.replace(path)


def load(path: Path, kind: type[Table]) -> Table:
    """Reads what `save` wrote."""
    with np.load(path, allow_pickle=False) as data:
        return kind(**{f.name: data[f.name] for f in fields(kind)})
