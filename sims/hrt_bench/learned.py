"""What is learnt from simulated arms: the domain-randomised estimator and the LSTM detector of the outline's tables.

Both are kept small and in numpy: fixed random features with a read-out by ridge regression. The detector's cell is an
LSTM whose gates are random and stay so (a reservoir), the read-out alone is trained.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from filter_truth import HOME
from hrt_truth.streams import Streams, Truth

from hrt_bench.estimate import AHEAD, STRIDE, Array, Estimate, Kinematics

WINDOW = (0, 1, 2, 4, 8, 16)
"""Messages back that the estimator sees."""
HIDDEN = 600
CELLS = 48
RIDGE = 1e-3


def _look(streams: Streams) -> Array:
    """(N, F) what the randomised estimator sees at each message."""
    count = len(streams.time)
    parts = []
    for back in WINDOW:
        k = np.maximum(np.arange(count) - back, 0)
        parts += [streams.q[k] - streams.q, streams.v[k], streams.tau[k] / 30.0, streams.asked[k] - streams.q]
    for horizon in (0.05, *AHEAD):
        k = np.minimum(np.arange(count) + round(horizon * 200), count - 1)
        parts += [streams.asked[k] - streams.q, streams.asked_rate[k]]
    return np.hstack([streams.q - HOME, *parts, streams.wrench / 10.0])


@dataclass
class Randomised:
    """A regressor from windows of readings to joint angles now and ahead, trained on randomised arms."""

    mean: Array
    scale: Array
    first: Array
    read: Array

    @staticmethod
    def train(runs: list[tuple[Streams, Truth]]) -> Randomised:
        """From runs with their truth: simulated ones are all that it ever sees."""
        X = np.vstack([_look(s)[40:-40] for s, _ in runs])
        Y = np.vstack([_targets(s, t)[40:-40] for s, t in runs])
        mean, scale = X.mean(axis=0), X.std(axis=0) + 1e-9
        rng = np.random.default_rng(0)
        first = rng.normal(size=(X.shape[1] + 1, HIDDEN)) * (0.7 / np.sqrt(X.shape[1]))
        made = Randomised(mean, scale, first, np.zeros(0))
        F = made._features(X)
        made.read = np.linalg.solve(F.T @ F + RIDGE * len(F) * np.eye(F.shape[1]), F.T @ Y)
        return made

    def _features(self, X: Array) -> Array:
        Z = np.clip((X - self.mean) / self.scale, -6.0, 6.0)
        Z = np.hstack([Z, np.ones((len(Z), 1))])
        return np.hstack([Z, np.tanh(Z @ self.first)])

    def run(self, streams: Streams, kinematics: Kinematics) -> Estimate:
        """On one run."""
        n, count = streams.q.shape[1], len(streams.time)
        found = self._features(_look(streams)) @ self.read
        q, v = streams.q + found[:, :n], found[:, n : 2 * n]
        ahead = {}
        for j, horizon in enumerate(AHEAD):
            part = found[::STRIDE, (2 + j) * n : (3 + j) * n]
            ahead[horizon] = kinematics.positions(streams.q[::STRIDE] + part)
        return Estimate(kinematics.poses(q), kinematics.speeds(q, v), ahead, np.full(count, np.nan))


def _targets(streams: Streams, truth: Truth) -> Array:
    count = len(truth.time)
    later = [np.minimum(np.arange(count) + round(h * 200), count - 1) for h in AHEAD]
    return np.hstack([truth.q - streams.q, truth.v, *(truth.q[k] - streams.q for k in later)])


def signals(streams: Streams) -> Array:
    """(N, S) what both detectors look at: tracking errors, torques, IMU, wrench, and how far camera and arm differ."""
    camera = np.zeros((len(streams.time), 3))
    at = np.searchsorted(streams.camera_arrives, streams.time, side="right") - 1
    seen = at >= 0
    camera[seen] = streams.camera[at[seen], 4:]
    return np.hstack(
        [
            streams.asked - streams.q,
            streams.asked_rate - streams.v,
            streams.tau,
            streams.imu,
            streams.wrench,
            np.diff(camera, axis=0, prepend=camera[:1]),
        ]
    )


@dataclass
class Threshold:
    """The outline's simple detector: a reading that left the range of normal operation."""

    limit: Array

    @staticmethod
    def train(runs: list[Streams]) -> Threshold:
        """From runs without faults."""
        return Threshold(1.1 * np.max([np.abs(signals(s)[200:]).max(axis=0) for s in runs], axis=0))

    def alarms(self, streams: Streams) -> Array:
        """Times at which it alarms [s]."""
        over = np.any(np.abs(signals(streams)) > self.limit, axis=1)
        return streams.time[over & (streams.time > 1.0)]


@dataclass
class Lstm:
    """Predicts the next signals from the past ones; alarms where the error is beyond what normal operation showed."""

    scale: Array
    weights: Array
    read: Array
    spread: Array
    limit: float

    @staticmethod
    def train(runs: list[Streams]) -> Lstm:
        """From runs without faults."""
        S = [signals(s) for s in runs]
        scale = np.vstack(S).std(axis=0) + 1e-9
        size = S[0].shape[1]
        rng = np.random.default_rng(1)
        weights = rng.normal(size=(4, size + CELLS + 1, CELLS)) / np.sqrt(size + CELLS)
        made = Lstm(scale, weights, np.zeros(0), np.ones(size), np.inf)
        X = [made._states(s) for s in S]
        F = np.vstack([x[100:-1] for x in X])
        Y = np.vstack([s[101:] / scale for s in S])
        made.read = np.linalg.solve(F.T @ F + RIDGE * len(F) * np.eye(F.shape[1]), F.T @ Y)
        error = Y - F @ made.read
        made.spread = error.std(axis=0) + 1e-9
        made.limit = 1.1 * max(float(made._score(s)[200:].max()) for s in S)
        return made

    def _states(self, S: Array) -> Array:
        """(N, …) cell outputs beside the signals themselves."""
        out, cell, rows = np.zeros(CELLS), np.zeros(CELLS), []
        for s in S / self.scale:
            z = np.concatenate([np.clip(s, -8.0, 8.0), out, [1.0]])
            i, f, o, g = z @ self.weights
            cell = cell / (1.0 + np.exp(-f - 1.0)) + np.tanh(g) / (1.0 + np.exp(-i))
            out = np.tanh(cell) / (1.0 + np.exp(-o))
            rows.append(np.concatenate([z[: len(s)], out, [1.0]]))
        return np.array(rows)

    def _score(self, S: Array) -> Array:
        error = np.zeros((len(S), S.shape[1]))
        error[1:] = S[1:] / self.scale - self._states(S)[:-1] @ self.read
        return np.asarray(np.max(np.abs(error) / self.spread, axis=1))

    def alarms(self, streams: Streams) -> Array:
        """Times at which it alarms [s]."""
        return streams.time[(self._score(signals(streams)) > self.limit) & (streams.time > 1.0)]
