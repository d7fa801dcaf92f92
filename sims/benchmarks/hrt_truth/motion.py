"""Pick and place: smooth moves between random places above a table, with short rests."""

from __future__ import annotations

import numpy as np
from filter_truth import HOME

from hrt_truth.streams import Array

REACH = np.array([0.9, 0.35, 0.45, 0.5, 0.5, 0.9])
"""How far a place lies from home, by joint [rad]."""


def pick_and_place(
    seed: int, duration: float, dt: float = 1e-3, still: float = 0.5, busy: bool = False
) -> tuple[Array, Array]:
    """What the drive is told: positions [rad] and speeds [rad/s], each (K + 1, n), K = duration / dt.

    Args:
        seed: of the places.
        duration: [s].
        dt: [s].
        still: rest at the start [s].
        busy: hardly a rest in between.
    """
    rng = np.random.default_rng([seed, 42])
    count = round(duration / dt) + 1
    q, v = np.empty((count, len(HOME))), np.zeros((count, len(HOME)))
    here, at = HOME.copy(), round(still / dt)
    q[: min(at, count)] = here
    while at < count:
        there = HOME + rng.uniform(-1.0, 1.0, len(HOME)) * REACH
        steps = round(rng.uniform(1.0, 1.8) / dt)
        s = np.arange(1, steps + 1) / steps
        shape = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        rate = 30.0 * s**2 * (1.0 - s) ** 2 / (steps * dt)
        end = min(at + steps, count)
        q[at:end] = (here + shape[:, None] * (there - here))[: end - at]
        v[at:end] = (rate[:, None] * (there - here))[: end - at]
        rest = round(rng.uniform(0.05, 0.15 if busy else 0.5) / dt)
        q[end : end + rest] = there
        at, here = end + rest, there
    return q, v
