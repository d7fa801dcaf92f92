"""How an arm leaves a shape that is only a guess: it is inside of it, so the guess is wrong there, and it goes slowly.

What an image does not show of a thing is guessed, and now and then the guess reaches to where the arm already is. The
nearest ways out of it differ from link to link and contradict one another; up, whence the tool came, is one for all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.planning.collision.collision_scene import Scene
from twin_diagram.planning.paths.situation import INSIDE, Situation
from twin_diagram.planning.paths.time_optimal import SpeedProfile, profile
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    speed: float = 0.05
    """The tool goes no faster on its way out [m/s]: what is really there is pushed gently, if it is met."""

    lifts: tuple[float, ...] = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4)
    """Heights that are tried, the least that is free is taken [m]."""

    free: float = 0.003
    """Up there this much is left to everything [m]."""

    ignored: float = -1.0
    """Stands for no margin at all [m]."""


TUNING = Tuning()


def proved_wrong(now: Situation) -> npt.NDArray[np.bool_]:
    """Return (B,) bool: unknown things that the arm is deep inside of; what is known has a shape that is no guess."""
    return now.guessed & (now.here[:-1] < -INSIDE)


def way_out(scene: Scene, lift: Callable[[Array, float], Array], now: Situation, speed: Array) -> SpeedProfile | None:
    """Return the slow way up, out of what the arm is inside of; None where it is in nothing, or nothing up is free.

    Args:
        scene: shapes.
        lift: gives joint angles (n,) near others with the tool so much higher [m].
        now: the situation.
        speed: (n,) the joints' limits [rad/s].
    """
    if not proved_wrong(now).any():
        return None
    q = np.array([lift(now.q, height) for height in TUNING.lifts])
    around = scene.around(now.forecast, np.zeros(len(q)))
    distance = scene.clearance.distances(q, around, 2 * TUNING.free)
    free = np.flatnonzero((distance >= TUNING.free).all(axis=1))
    if not len(free):
        return None
    k = int(free[0])
    took = TUNING.lifts[k] / TUNING.speed
    return profile(np.stack([now.q, q[k]]), np.clip(np.abs(q[k] - now.q) / took, 1e-3, speed), speed)


def without(margins: Array, wrong: npt.NDArray[np.bool_]) -> Array:
    """Return margins (M, B + 1) [m] that ask nothing of some of the bodies, (B,)."""
    return np.where(np.append(wrong, False), TUNING.ignored, margins)
