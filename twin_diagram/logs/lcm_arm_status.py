"""What arms' status messages on an LCM bus say, by the log's signals and with its signs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from drake import lcmt_iiwa_status, lcmt_panda_status  # type: ignore[import-untyped]

from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Status:
    """An arm's status message.

    Attributes:
        utime: of the sender's clock [µs].
        position: (n,) measured [rad].
        velocity: (n,) [rad/s].
        torque: (n,) what moves the joints, gravity's part included, positive along the joint [N·m].
        commanded: (n,) position that the driver was asked for [rad].
    """

    utime: int
    position: Array
    velocity: Array
    torque: Array
    commanded: Array


def read_panda(message: lcmt_panda_status) -> Status:
    """Return a Franka arm's; its torque is libfranka's tau_J: joint sensors behind the gears, positive along them."""
    return Status(
        message.utime,
        np.array(message.joint_position),
        np.array(message.joint_velocity),
        np.array(message.joint_torque),
        np.array(message.joint_position_desired),
    )


def read_iiwa(message: lcmt_iiwa_status) -> Status:
    """Return a KUKA iiwa's.

    The Fast Robot Interface counts measured torques against the joint, and Drake's own simulated driver does alike.
    """
    return Status(
        message.utime,
        np.array(message.joint_position_measured),
        np.array(message.joint_velocity_estimated),
        -np.array(message.joint_torque_measured),
        np.array(message.joint_position_commanded),
    )


READERS: Final[dict[type, Callable[[Any], Status]]] = {lcmt_panda_status: read_panda, lcmt_iiwa_status: read_iiwa}
"""By the message's type."""
