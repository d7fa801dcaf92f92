"""Where the tool was at the time of an image, and how it moved there. Pure functions on arrays."""

from __future__ import annotations

from typing import Final

import numpy as np

from twin_diagram.signals import rotations
from twin_diagram.signals.arrays import Array
from twin_diagram.signals.layouts import NEVER, POSE_SIZE

KEPT: Final = 64
"""So many ticks are remembered …"""
APART: Final = 0.009
"""… at least so far apart [s]: over half a second of them, whatever the planner's rate. A camera of 5 images a second
that is 0.1 s late, and looked at until the next image comes, shows what was 0.3 s ago."""
_ROW: Final = 1 + POSE_SIZE
"""Numbers of a tick: its time and X_WT."""
PAST_SIZE: Final = KEPT * _ROW
"""Numbers of a past: times [s] (`NEVER` where empty) and poses X_WT, newest last."""


def no_past() -> Array:
    """Return a past (PAST_SIZE) of which nothing is known."""
    return np.tile([NEVER, 1.0, *[0.0] * 6], KEPT)


def remembering(past: Array, now: float, X_WT: Array) -> Array:
    """Return the past (PAST_SIZE) with the tool at X_WT (7) now [s]; the oldest goes, or the newest if it is so new."""
    newest, before = past[-_ROW], past[-2 * _ROW]
    too_near = before >= 0.0 and newest - before < APART
    return np.concatenate([past[:-_ROW] if too_near else past[_ROW:], [now], X_WT])


def tool_at(past: Array, time: float) -> tuple[Array, Array] | None:
    """Return X_WT (7) and the tool's velocity (6), angular then linear, at a time [s]; None where it is not known."""
    rows = past.reshape(KEPT, _ROW)
    times = rows[:, 0]
    k = int(np.searchsorted(times, time, side="right"))
    k = min(k, KEPT - 1) if time <= times[-1] else k
    if k == KEPT or k == 0 or times[k - 1] < 0.0:
        return None
    before, after, span = rows[k - 1, 1:], rows[k, 1:], times[k] - times[k - 1]
    turn, step = rotations.difference(after[:4], before[:4]), after[4:] - before[4:]
    share = (time - times[k - 1]) / span
    q = rotations.normalized(rotations.multiply(rotations.exp(share * turn), before[:4]))
    return np.concatenate([q, before[4:] + share * step]), np.concatenate([turn, step]) / span
