"""Parameters of named effects, refined by output error (multiple shooting).

Short rollouts from measured states under measured torques are held against the measured positions; each joint's
starting position and speed in each window are free. Dry friction, play and springs are integrated as they are, so that
it needs no velocities and no smooth laws. Torque noise drives the rollouts, though, so that it is seldom the surer way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from twin_diagram.errors import ModelError
from twin_diagram.gap.correction.equation_error import Hypothesis
from twin_diagram.gap.correction.gauss_newton import Solution, minimise
from twin_diagram.logs import fingerprint
from twin_diagram.logs.differentiation import Motion
from twin_diagram.model.model import Model
from twin_diagram.model.prediction import twists
from twin_diagram.model.rollout import trajectory
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand; `make gap-benchmark ARGS="--suite training"` shows what they do."""

    window: float = 0.25
    """Length of a rollout [s]."""

    observed: float = 0.0125
    """Between looks at a rollout [s]."""

    most_windows: int = 160
    """Of all runs together; more than these are thinned."""

    ridge: float = 0.05
    """Share of their mean that is added to all variances of a rollout's errors."""


TUNING = Tuning()


def output_error(
    hypothesis: Hypothesis, motions: Sequence[Motion], worth: Callable[[Array], bool] | None = None
) -> Solution:
    """Fit parameters to the logged positions; see the module.

    Args:
        hypothesis: with its rough values.
        motions: of the fitted logs.
        worth: see `minimise`: each step takes as many rollouts as there are coordinates.
    """
    shots = [_Shots.of(smooth, len(motions)) for smooth in motions]
    start = hypothesis.start()

    def errors(vector: Array) -> list[Array]:
        """Return those of runs that look at their rollouts equally often, put together: each (windows, looks, n)."""
        model = hypothesis.model(vector)
        each = [shot.errors(model) for shot in shots]
        return [
            np.concatenate([e for e in each if e.shape[1] == looks]) for looks in sorted({e.shape[1] for e in each})
        ]

    first = errors(start)
    W = [_whiteners(part) for part in first]
    size = sum(part.size for part in first)

    def residual(vector: Array) -> Array:
        try:
            parts = zip(W, errors(vector), strict=True)
            return np.concatenate([np.einsum("jab,wbj->wja", white, part).ravel() for white, part in parts])
        except ModelError:
            return np.full(size, np.inf)

    windows = np.cumsum([0, *(len(part) for part in first)])
    clusters = [np.repeat(np.arange(len(e)) + k, e[0].size) for e, k in zip(first, windows[:-1], strict=True)]
    whole, prior = np.concatenate(clusters), hypothesis.prior()
    return minimise(residual, start, hypothesis.steps(), whole, prior, rounds=4, worth=worth)


def _whiteners(errors: Array) -> Array:
    """Return (n, looks, looks) of each joint's errors (windows, looks, n) along a rollout."""
    windows, looks, n = errors.shape
    whiteners = []
    for j in range(n):
        covariance = errors[:, :, j].T @ errors[:, :, j] / windows
        values, vectors = np.linalg.eigh(covariance + TUNING.ridge * np.trace(covariance) / looks * np.eye(looks))
        whiteners.append((vectors / np.sqrt(np.maximum(values, 1e-30))) @ vectors.T)
    return np.stack(whiteners)


@dataclass(frozen=True)
class _Shots:
    """Rollouts of one run."""

    smooth: Motion
    mark: str
    starts: npt.NDArray[np.int64]
    steps: int
    every: int

    @staticmethod
    def of(smooth: Motion, count: int) -> _Shots:
        regular = smooth.log
        period = regular.period
        steps = max(4, round(TUNING.window / period))
        first, last = int(np.ceil(0.3 / period)), len(regular) - int(np.ceil(0.3 / period)) - steps - 1
        starts = np.arange(first, last, steps)
        most = max(20, TUNING.most_windows // count)
        if len(starts) > most:
            starts = starts[np.linspace(0, len(starts) - 1, most).astype(int)]
        return _Shots(smooth, fingerprint(regular), starts, steps, max(1, round(TUNING.observed / period)))

    def errors(self, model: Model) -> Array:
        """Return (windows, looks, n) measured less rolled-out positions, less what start and speed explain [rad]."""
        smooth, regular = self.smooth, self.smooth.log
        model = model.for_run(self.mark)
        period = (regular.time[-1] - regular.time[0]) / (len(regular) - 1)
        tau = model.applied(regular.motor_torque, regular.time)
        angles, rates = twists(model, smooth)
        at = self.starts
        torques = np.stack([tau[at + k] for k in range(self.steps + 1)])
        begin = (regular.position[at], smooth.velocity[at], torques, period, regular.time[at], (angles[at], rates[at]))
        looks, times = [], []
        for k, position in enumerate(trajectory(model, *begin, arrived=True), start=1):
            if k % self.every == 0:
                looks.append(regular.position[at + k] - position)
                times.append(k * period)
        error = np.stack(looks, axis=1)
        basis, _ = np.linalg.qr(np.stack([np.ones(len(times)), np.array(times)], axis=1))
        return np.asarray(error - np.einsum("ab,wbj->waj", basis @ basis.T, error))
