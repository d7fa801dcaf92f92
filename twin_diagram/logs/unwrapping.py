"""Encoders that count one turn only: their angles jump by a turn where the joint goes on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from twin_diagram.logs.checking import LogWarning
from twin_diagram.logs.fingerprint import fingerprint
from twin_diagram.logs.measured_log import Log
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    nearly: float = 0.1
    """A jump is a turn if it is this near to one [turns]; what else jumps is a fault of the log."""


TUNING = Tuning()


def unwrapped(log: Log, revolute: npt.NDArray[np.bool_]) -> tuple[Log, list[LogWarning]]:
    """Return the log with angles that go on where they jumped by a turn, and what was done; itself where none does.

    A step of nearly a whole turn from one sample to the next is no motion of an arm. Which turn a run begins in is not
    known, so it is the one that the log says.

    Args:
        log: checked, with the arm's joints in the arm's order.
        revolute: (n,) which of them turn.
    """
    jumps = np.any(_turns(log.position) != 0.0, axis=0) & revolute
    if not np.any(jumps):
        return log, []
    whole = replace(
        log,
        position=_unwrap(log.position, jumps),
        position_commanded=None if log.position_commanded is None else _unwrap(log.position_commanded, jumps),
        identity=fingerprint(log),
    )
    joints = [joint for joint, here in zip(log.joints, jumps, strict=True) if here]
    message = (
        f"{log.source}: the angle of {', '.join(joints)} jumps by a turn between two samples; it is taken to go on"
    )
    return whole, [LogWarning("wrapped", message, joints[0])]


def turns_of(steps: Array) -> Array:
    """Return how many whole turns each step from one sample to the next [rad] jumps; 0 where it is none."""
    turns = steps / (2.0 * np.pi)
    whole = np.round(turns)
    return np.where(np.abs(turns - whole) < TUNING.nearly, whole, 0.0)


def _turns(angles: Array) -> Array:
    """Return (N, n) turns by which each sample jumped from the one before it."""
    return turns_of(np.diff(angles, axis=0, prepend=angles[:1]))


def _unwrap(angles: Array, which: npt.NDArray[np.bool_]) -> Array:
    return np.where(which, angles - 2.0 * np.pi * np.cumsum(_turns(angles), axis=0), angles)
