"""What goes over the wires between systems: the layouts of vector-valued ports.

Vectors, not objects, carry estimates: they copy cheaply, log with `VectorLogSink` and make state comparable to the bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from twin_diagram.signals.arrays import Array

NEVER: Final = -1.0
"""Value of a time port before the first message: a time port is valid when it is >= 0."""

POSE_SIZE: Final = 7
"""A pose as (qw, qx, qy, qz, px, py, pz)."""

MEASUREMENT_SIZE: Final = 1 + 1 + POSE_SIZE + 36
"""A `PoseMeasurement`: quality, time, pose, covariance."""
TRACK_SIZE: Final = 1 + 1 + POSE_SIZE + 6 + 36
"""A `Track`: status, time, pose, velocity, covariance."""
ALARM_SIZE: Final = 4
"""An alarm as the drift monitor's port holds it."""


@dataclass(frozen=True)
class PoseMeasurement:
    """One object's pose as registration found it in one image.

    Attributes:
        quality: 0 where the object was not found in this image, else the share of its visible surface that fits.
        time: capture time of the image [s].
        pose: X_WO as (qw, qx, qy, qz, px, py, pz).
        covariance: (6, 6), rotation [rad] then translation [m]: a left perturbation in W about the object's origin.
    """

    quality: float
    time: float
    pose: Array
    covariance: Array

    def pack(self) -> Array:
        """Return it as a vector of `MEASUREMENT_SIZE`."""
        return np.concatenate([[self.quality, self.time], self.pose, self.covariance.ravel()])

    @staticmethod
    def unpack(vector: Array) -> PoseMeasurement:
        """Return the inverse of `pack`; copies."""
        return PoseMeasurement(
            float(vector[0]), float(vector[1]), vector[2:9].copy(), vector[9:45].reshape(6, 6).copy()
        )


class ObjectStatus(IntEnum):
    """An object's life, as the scene-graph updater sees it."""

    UNSEEN = 0
    TRACKED = 1
    MOVING = 2
    STALE = 3
    LOST = 4
    HELD = 5
    GONE = 6


@dataclass(frozen=True)
class Track:
    """What the twin believes about one object now.

    Attributes:
        status: see `ObjectStatus`.
        last_seen: capture time of the last image that showed it [s], `NEVER` if none did.
        pose: X_WO now, (qw, qx, qy, qz, px, py, pz).
        velocity: V_WO: angular [rad/s] then linear [m/s], in W.
        covariance: of the pose now, as in `PoseMeasurement`.
    """

    status: ObjectStatus
    last_seen: float
    pose: Array
    velocity: Array
    covariance: Array

    def pack(self) -> Array:
        """Return it as a vector of `TRACK_SIZE`."""
        return np.concatenate([[float(self.status), self.last_seen], self.pose, self.velocity, self.covariance.ravel()])

    @staticmethod
    def unpack(vector: Array) -> Track:
        """Return the inverse of `pack`; copies."""
        return Track(
            ObjectStatus(int(vector[0])),
            float(vector[1]),
            vector[2:9].copy(),
            vector[9:15].copy(),
            vector[15:51].reshape(6, 6).copy(),
        )


class AlarmKind(IntEnum):
    """What the drift monitor says."""

    NONE = 0
    INNOVATION = 1
    """Joint innovations left their band (sensor rate)."""
    ROLLOUT = 2
    """A short rollout of the model left its band."""
    SENSOR = 3
    """A further sensor parts ways with the rest."""


ALARM_LOG_FIELDS: Final = 3
"""A row of the alarm ring: time [s] (`NEVER` where empty), `AlarmKind`, statistic over threshold."""
