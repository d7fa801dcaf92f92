"""Turns what filter and drift monitor say into alarms with a name."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from hrt_bench.estimate import Array
from twin_diagram.estimation.belief import Entry, Track
from twin_diagram.estimation.drift import Monitor
from twin_diagram.estimation.ekf import Ekf, Update
from twin_diagram.scenario import Drift

REFUSALS = 3
"""Readings refused in a row that are no outliers any more."""
FALSE_RATE = 1e-10
"""Probability that a sensor's mean innovation is this far off while it agrees with the rest."""
QUIET = 0.5
"""An alarm that stands is not raised again within this time [s]."""


class Watch:
    """Collects alarms: of the drift monitor, and of sensors that part ways with the rest."""

    def __init__(self, ekf: Ekf) -> None:
        self.alarms: list[tuple[float, str]] = []
        self._ekf = ekf
        self._monitor = Monitor(ekf.terms, Drift(), ekf.params)
        self._active = False
        self._raised: dict[str, float] = {}
        self._settled = 2.0

    def _alarm(self, t: float, what: str) -> None:
        if t - self._raised.get(what, -np.inf) > QUIET:
            self.alarms.append((t, what))
        self._raised[what] = t

    def reading(self, name: str, result: Update, t: float) -> None:
        """After each further sensor's reading."""
        ekf = self._ekf
        if ekf.belief.time < self._settled:
            return
        track = ekf.declared.track(ekf.belief, ekf.declared.sensors[name])
        assert track is not None
        if track[Track.STREAK] >= REFUSALS:
            self._alarm(ekf.belief.time, f"{name} refused")
        if track[Track.RUN] > chi2.ppf(1.0 - FALSE_RATE, len(result.innovation)):
            self._alarm(ekf.belief.time, f"{name} biased")

    def message(self, q: Array, tau: Array, t: float) -> None:
        """After each message of the arm."""
        belief = self._ekf.belief
        monitor = self._monitor
        state = np.concatenate([belief.q, belief.v])
        nis = float(belief.header[Entry.NIS])
        monitor.observe(state, belief.theta, nis, q, tau, t, belief.time, belief.innovation)
        if monitor.active and not self._active:
            self._alarm(t, "drift")
        self._active = monitor.active
