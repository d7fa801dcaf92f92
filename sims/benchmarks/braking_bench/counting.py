"""Shares with their intervals, and whose a contact is."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

STANDING = 0.02
"""The arm counts as standing below this [rad/s] …"""
STOOD = 0.1
"""… for this long [s]."""


class ArmCame:
    """Tells of contacts whether the arm came, or the other thing to an arm that stood.

    The arm came where within the last `STOOD` it moved untouched, or was commanded to; that it is shoved is no motion
    of its own, nor how it swings back until it rests. Of commands their mean over that time counts: one tick's worth
    moves nothing.
    """

    def __init__(self, period: float, command: Array) -> None:
        """Begin at rest.

        Args:
            period: between two looks [s].
            command: (n,) what the arm is to follow [rad].
        """
        self._count = round(STOOD / period)
        self._commands = [np.array(command)]
        self._moved = 0.0
        self._shoved = False

    def look(self, now: float, touching: bool, v: Array, command: Array) -> bool:
        """Return whether it is the arm that comes, or came just before.

        Args:
            now: [s]
            touching: whether anything touches it now.
            v: (n,) its true speeds [rad/s].
            command: (n,) what it is to follow now [rad].
        """
        self._commands = [*self._commands, np.array(command)][-1 - self._count :]
        driven = np.abs(self._commands[-1] - self._commands[0]).max() > STANDING * STOOD
        moves = np.abs(v).max() > STANDING
        self._shoved = not driven and (touching or (self._shoved and moves))
        if driven or (moves and not self._shoved):
            self._moved = now
        return now - self._moved < STOOD


def wilson(hits: float, count: int, z: float = 1.96) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share of `count` trials; `hits` may be a weighted count."""
    if count == 0:
        return 0.0, 1.0
    p = hits / count
    middle = (p + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * math.sqrt(p * (1 - p) / count + z * z / (4 * count * count))
    return max(0.0, middle - half), min(1.0, middle + half)
