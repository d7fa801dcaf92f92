"""Has the arm's driver bear the weight of what is held, of which it does not know.

It holds the arm by the arm's own gravity and follows by a spring, which 1.4 kg in the hand bend by 6 mm: what is set
down comes down too early, and fingers that open touch what it is set upon.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform

from twin_diagram.estimation.weighing.held import Held
from twin_diagram.model.model import Model
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, with their units and what set them."""

    fade: float = 0.2
    """In which what is borne comes and goes [s]: an arm that is told at once springs up by what it hung down."""


TUNING = Tuning()
Hold = Callable[[Array], Array]
"""Tells of joint angles (n,) [rad] the torques (n,) that bear what is held there [N·m]."""


def holding(model: Model, mass: float, centre_T: Array) -> Hold:
    """Return the torques that bear a mass [kg] with its centre at a place (3,) in the tool's frame [m]."""
    held = Held.in_tool(model, RigidTransform(np.asarray(centre_T, dtype=float)))  # once, not at each tick of the cell
    place, weight = np.asarray(held.X_MO.translation()), mass * model.tree.gravity

    def torque(q: Array) -> Array:
        found = np.zeros_like(q)
        found[held.rows] = -model.tree.pushed(q[None], held.body, place, weight, np.zeros(3))[0, held.rows]
        return found

    return torque


class Borne:
    """What the driver is told to bear, moment by moment."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self._hold: Hold | None = None
        self._before: Array | float = 0.0
        self._last: Array | float = 0.0
        self._since = -np.inf

    def tell(self, hold: Hold | None, now: float) -> None:
        """Bear something else from a time on [s]; None: nothing."""
        if hold is not None or self._hold is not None:
            self._hold, self._before, self._since = hold, self._last, now

    def torque(self, q: Array, now: float) -> Array:
        """Return the torques (n,) at joint angles (n,) [rad] and a time [s]."""
        share = float(np.clip((now - self._since) / TUNING.fade, 0.0, 1.0))
        held = 0.0 if self._hold is None else self._hold(q)
        self._last = np.zeros_like(q) + share * np.asarray(held) + (1.0 - share) * np.asarray(self._before)
        return self._last
