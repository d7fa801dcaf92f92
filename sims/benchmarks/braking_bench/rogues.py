"""Planners that drive into things, freeze, jump or send what is no number, in the place of `Mpc`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from pydrake.systems.framework import BasicVector, Context, LeafSystem

Array = npt.NDArray[np.float64]

KINDS = ("drives", "freezes", "nan", "jumps")


class Rogue(LeafSystem):
    """Goes from target to target in joint space, whatever is in its way, and does something worse now and then.

    `drives` does nothing worse. `freezes` makes no new plan from `bad_from` on and goes on at the speed it has.
    `nan` sends no numbers for a while, `jumps` commands the next target at once, again and again.
    """

    def __init__(
        self, kind: str, start: Array, targets: Sequence[Array], speed: Array, bad_from: float, period: float = 1 / 15
    ) -> None:
        """Lay out the motion.

        Args:
            kind: of `KINDS`.
            start: (n,) where the arm is [rad].
            targets: (n,) each [rad].
            speed: (n,) greatest speeds [rad/s].
            bad_from: when it goes wrong [s].
            period: of its plans [s].
        """
        super().__init__()
        self._kind, self._bad, self._period = kind, bad_from, period
        self._points = [np.asarray(start, float), *(np.asarray(q, float) for q in targets)]
        # A cosine from rest to rest peaks at pi / 2 times its mean speed.
        legs = [np.max(np.abs(b - a) / speed) * np.pi / 2 for a, b in zip(self._points, self._points[1:], strict=False)]
        self._ends = 0.5 + np.concatenate([[0.0], np.cumsum(np.maximum(legs, 0.3))])
        n = len(start)
        now = {self.time_ticket()}
        self.DeclareVectorOutputPort("position_commanded", n, self._calc, prerequisites_of_calc=now)
        self.DeclareVectorOutputPort("plan_time", 1, self._calc_time, prerequisites_of_calc=now)

    def at(self, t: float) -> Array:
        """Return (n,) the motion at a time, before anything goes wrong."""
        k = int(np.searchsorted(self._ends, t, side="right")) - 1
        if k < 0:
            return self._points[0]
        if k >= len(self._points) - 1:
            return self._points[-1]
        s = (t - self._ends[k]) / (self._ends[k + 1] - self._ends[k])
        return np.asarray(self._points[k] + (self._points[k + 1] - self._points[k]) * (1 - np.cos(np.pi * s)) / 2)

    def _calc(self, context: Context, output: BasicVector) -> None:
        t, q = context.get_time(), self.at(context.get_time())
        bad = t - self._bad
        if bad >= 0.0:
            if self._kind == "freezes":
                rate = (self.at(self._bad) - self.at(self._bad - 1e-3)) / 1e-3
                q = self.at(self._bad) + rate * bad
            elif self._kind == "nan" and bad % 1.0 < 0.3:
                q = np.full(len(q), np.nan)
            elif self._kind == "jumps" and bad % 1.0 < 0.5:
                q = self._points[1 + int(bad) % (len(self._points) - 1)]
        output.SetFromVector(q)

    def _calc_time(self, context: Context, output: BasicVector) -> None:
        t = context.get_time()
        if self._kind == "freezes":
            t = min(t, self._bad)
        output[0] = self._period * np.floor(t / self._period + 1e-9)
