"""What is learnt from simulated arms: the domain-randomised estimator and the LSTM detector of the outline's tables.

Both are kept small and in numpy: fixed random features with a read-out by ridge regression for the estimator, a trained
LSTM (`lstm`) for the detector. Detectors see normal operation alone.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final, TypeVar

import numpy as np
from filter_truth import HOME
from hrt_truth.streams import Streams, Truth

from hrt_bench import lstm
from hrt_bench.estimate import AHEAD, STRIDE, Array, Estimate, Kinematics

WINDOW = (0, 1, 2, 4, 8, 16)
"""Messages back that the estimator sees."""
HIDDEN = 600
RIDGE = 1e-3
CELLS: Final = 32
STEPS: Final = 500
"""Of the LSTM's optimiser."""
WARM: Final = 200
"""Rows at the start of a run that teach no limits and raise no alarms."""
MARGIN: Final = 1.1
"""A limit is this many times the largest value of normal operation."""
WILD: Final = 8.0
"""Readings count for no more than this many of their standard deviations where a network reads them."""
Learner = TypeVar("Learner", "Randomised", "Threshold", "Lstm")


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
    """The outline's simple detector: a reading that left the range of normal operation.

    Attributes:
        limit: (S,) of each signal.
    """

    limit: Array

    @staticmethod
    def train(runs: list[Streams]) -> Threshold:
        """From runs without faults."""
        return Threshold(MARGIN * np.max([np.abs(signals(s)[WARM:]).max(axis=0) for s in runs], axis=0))

    def alarms(self, streams: Streams) -> Array:
        """Times at which it alarms [s]."""
        return _beyond(streams, np.abs(signals(streams)), self.limit)


@dataclass
class Lstm:
    """Predicts the next signals from those so far; alarms where one is farther off than in all normal operation.

    Attributes:
        scale: (S,) spread of the signals.
        gates, read: of `lstm.Weights`.
        limit: (S,) of the errors.
        loss: (2,) mean squared error over the variance on runs that were not trained on: the network's, and that of
            saying "as before".
    """

    scale: Array
    gates: Array
    read: Array
    limit: Array
    loss: Array

    @staticmethod
    def train(runs: list[Streams]) -> Lstm:
        """From runs without faults; every fourth is held back from the training, limits are taken from all."""
        found = [signals(s) for s in runs]
        scale = np.vstack(found).std(axis=0) + 1e-9
        rows = [np.clip(s / scale, -WILD, WILD) for s in found]
        weights, _ = lstm.train([r for k, r in enumerate(rows) if k % 4], CELLS, STEPS, seed=1)
        errors = [lstm.errors(weights, r)[WARM:] for r in rows]
        limit = MARGIN * np.max([np.abs(e).max(axis=0) for e in errors], axis=0)
        loss = [np.mean([np.mean(e**2) for e in errors[::4]])]
        loss.append(np.mean([np.mean(np.diff(r[WARM - 1 :], axis=0) ** 2) for r in rows[::4]]))
        return Lstm(scale, weights.gates, weights.read, limit, np.array(loss))

    def alarms(self, streams: Streams) -> Array:
        """Times at which it alarms [s]."""
        rows = np.clip(signals(streams) / self.scale, -WILD, WILD)
        return _beyond(streams, np.abs(lstm.errors(lstm.Weights(self.gates, self.read), rows)), self.limit)


def _beyond(streams: Streams, level: Array, limit: Array) -> Array:
    over = np.any(level > limit, axis=1)
    over[:WARM] = False
    return streams.time[over]


def save(path: Path, learner: Learner) -> None:
    """Writes to a temporary name and renames it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(f".{os.getpid()}.part.npz")
    np.savez(part, **{f.name: getattr(learner, f.name) for f in fields(learner)})
    part.replace(path)


def load(path: Path, kind: type[Learner]) -> Learner:
    """Reads what `save` wrote."""
    with np.load(path, allow_pickle=False) as data:
        return kind(**{f.name: data[f.name] for f in fields(kind)})
