"""Random numbers that depend on seed, sensor and message number alone.

A counter-based generator needs no state that would have to be stored in a Context: two contexts, a reset and a run that
starts in the middle all draw the same noise for the same message.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    mask: int = (1 << 64) - 1
    """Keys of a generator are of 64 bits."""


TUNING = Tuning()


class Stream(IntEnum):
    """Which sensor the numbers are for."""

    ARM = 1
    CAMERA = 2
    CAMERA_TABLE = 3
    LINK = 4
    LIDAR = 5
    CAMERA_RUN = 6
    CAMERA_NOISE = 7
    CAMERA_EDGES = 8
    CAMERA_TRUTH = 9


class MessageStreams:
    """Draws what `generator` does for one message of a sensor after the other, in a tenth of the time."""

    def __init__(self, seed: int, stream: Stream) -> None:
        """Take the seed of the scenario and the sensor."""
        self._numbers = generator(seed, stream, 0)
        self._fresh: Any = self._numbers.bit_generator.state

    def of(self, tick: int) -> np.random.Generator:
        """Return the generator of a message by its number, which is also that of the next: draw at once."""
        self._fresh["state"]["counter"][3] = tick & TUNING.mask
        self._numbers.bit_generator.state = self._fresh
        return self._numbers


def generator(seed: int, stream: Stream, tick: int) -> np.random.Generator:
    """Return a generator of its own for one message of one sensor (Philox, Salmon et al., SC 2011).

    Args:
        seed: of the scenario.
        stream: the sensor.
        tick: number of the message.
    """
    key = np.array([seed & TUNING.mask, int(stream)], dtype=np.uint64)
    counter = np.array([0, 0, 0, tick & TUNING.mask], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=counter))
