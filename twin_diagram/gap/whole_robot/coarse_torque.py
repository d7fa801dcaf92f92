"""Whether torques are logged in steps so coarse that the steps would pass for effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_diagram.logs import Log


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand on logs of an arm of seven joints with torques of 4 to 10 bits."""

    held: float = 0.5
    """Share of samples with the very value of the one before, from which on a torque is logged in steps."""

    step: float = 0.5
    """Over the torque's deviation: such steps are not noise, as they follow from the torque itself."""

    joints: float = 0.5
    """Share of joints of which that holds, from which on it holds of the robot."""


TUNING = Tuning()


def in_coarse_steps(logs: Sequence[Log]) -> bool:
    """Return whether most joints' torques are logged in steps as large as a good part of what the torque does.

    What rounding leaves is then no noise that grows less over time: torque that stands still looks like a limit, and
    torque that jumps like play or a spring.
    """
    coarse = [held_in_steps(log) for log in logs]
    return bool(np.mean(coarse) >= TUNING.joints)


def held_in_steps(log: Log) -> list[bool]:
    """Return per joint whether a log's torque stands still most of the time, and jumps by a good part of its size."""
    jumps = np.abs(np.diff(log.motor_torque, axis=0))
    held = np.mean(jumps == 0.0, axis=0)
    deviation = np.std(log.motor_torque, axis=0)
    usual = [float(np.median(jump[jump > 0.0])) if np.any(jump > 0.0) else np.inf for jump in jumps.T]
    return [bool(h > TUNING.held and u > TUNING.step * d) for h, u, d in zip(held, usual, deviation, strict=True)]
