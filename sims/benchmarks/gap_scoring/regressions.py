"""Two regressions on columns of the whole catalogue: greedy selection, and sparse regression."""

from __future__ import annotations

import importlib
import json
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gap_truth import explanations
from gap_truth.cases import model_path
from gap_truth.chain import Chain, read_urdf
from gap_truth.explanations import Explanation, Setting
from scipy.signal import butter, sosfiltfilt

from gap_scoring.held_out import read_columns, stack

Array = npt.NDArray[np.float64]

SMOOTH = 25.0
BAND = 20.0
KEPT = 50.0
"""Positions are smoothed, torques low-passed [Hz], and samples kept per second."""

CUT = 0.3
MOST = 8


@dataclass(frozen=True, eq=False)
class Data:
    """A log as a regression sees it: motion at its own rate, and thinned residual torque (M n,)."""

    setting: Setting
    residual: Array
    rate: float

    def reduce(self, signal: Array) -> Array:
        """(N, n, …) low-passed and thinned to (M n, …)."""
        low = sosfiltfilt(butter(4, BAND, fs=self.rate, output="sos"), signal, axis=0)
        edge, stride = round(CUT * self.rate), max(1, round(self.rate / KEPT))
        taken = low[edge:-edge:stride]
        return np.asarray(taken.reshape(-1, *signal.shape[2:]))

    def columns(self, explanation: Explanation) -> Array:
        """(M n, k)."""
        whole = np.zeros((len(self.setting.time), self.setting.chain.n, explanation.columns.shape[2]))
        whole[:, list(explanation.rows)] = explanation.columns
        return self.reduce(whole)


def read(folder: Path, name: str) -> Data:
    """A log of a case folder and what its given model leaves of it."""
    path = model_path(folder)
    chain = read_urdf(path / "arm.urdf" if path.is_dir() else path, "", 1.0, np.zeros(0))
    columns = read_columns(folder / name)
    joints = list(chain.joints)
    stamps = columns["time"]
    period = float(stamps[-1] - stamps[0]) / (len(stamps) - 1)
    grid = stamps[0] + period * np.arange(len(stamps))

    def regular(signal: str) -> Array:
        return np.stack([np.interp(grid, stamps, x) for x in stack(columns, signal, joints).T], axis=1)

    sections = butter(4, SMOOTH, fs=1.0 / period, output="sos")
    q = sosfiltfilt(sections, regular("position_measured"), axis=0)
    v = np.gradient(q, period, axis=0)
    a = np.gradient(v, period, axis=0)
    setting = Setting(chain, grid, q, v, a, regular("torque_measured"))
    missing = setting.torque - setting.load
    if path.is_dir():
        for effect in json.loads((path / "effects.yaml").read_text(encoding="utf-8"))["effects"]:
            level = np.array(next(iter(effect["parameters"].values())))
            missing = missing - level * (setting.sign if effect["name"] == "coulomb_friction" else v)
    data = Data(setting, np.zeros(0), 1.0 / period)
    return Data(setting, data.reduce(missing), data.rate)


def library(setting: Setting, limits: Array, ripples: int = 40) -> list[Explanation]:
    """What holds throughout a log, with the same shapes for every log of an arm."""
    result = []
    for j in range(setting.chain.n):
        for name in explanations.JOINT_NAMES:
            if name == "actuator_fault":
                continue
            if name == "torque_constant":  # of the torque that is needed: the measured one brings its noise along
                column = setting.load[:, j, None, None]
                result.append(Explanation(name, (j,), (j,), column, 1, (False,)))
                continue
            if name == "torque_saturation":
                shapes: list[dict[str, float] | None] = [{"limit": x * float(limits[j])} for x in (0.7, 0.8, 0.9)]
            elif name == "torque_ripple":
                shapes = [{"cycles": float(c)} for c in range(2, ripples)]
            else:
                shapes = [None]
            result += [e for shape in shapes for e in explanations.on_joint(setting, j, name, shape)]
    result += [explanations.coupled(setting, j, j + 1) for j in range(setting.chain.n - 1)]
    result += [explanations.of_link(setting, k) for k in range(setting.chain.n - 1)]
    point = explanations.payload(setting)
    result.append(Explanation("payload", point.place, point.rows, point.columns[..., :4], 4, (False,) * 4))
    return [*result, explanations.tilt(setting), *explanations.delays(setting)]


@dataclass(frozen=True)
class Answer:
    """What a method says: effects, and residual torque (M n,) on the held-out log."""

    effects: list[dict[str, Any]]
    residual: Array


def _said(chain: Chain, chosen: list[Explanation]) -> list[dict[str, Any]]:
    """As `gap.json` lists effects: one entry per name."""
    result: dict[str, dict[str, Any]] = {}
    for e in chosen:
        entry = result.setdefault(e.name, {"name": e.name, "joints": set(), "links": set(), "confidence": 1.0})
        entry["joints"] |= {chain.joints[i] for i in e.place if i >= 0}
        entry["links"] |= {chain.link_names[-1 - i] for i in e.place if i < 0}
    return [{**e, "joints": sorted(e["joints"]), "links": sorted(e["links"])} for e in result.values()]


def _both(folder: Path) -> tuple[Data, Data, list[Explanation], list[Explanation]]:
    fit, held = read(folder, "fit.csv"), read(folder, "holdout.csv")
    limits = np.abs(fit.setting.torque).max(axis=0)
    return fit, held, library(fit.setting, limits), library(held.setting, limits)


def _scales(data: Data) -> Array:
    """Noise of each joint, by differences of neighbouring samples (M n,)."""
    n = data.setting.chain.n
    rows = data.residual.reshape(-1, n)
    level = np.maximum(np.std(np.diff(rows, n=2, axis=0), axis=0) / np.sqrt(6.0), 1e-9)
    return np.tile(level, len(rows))


def greedy_bic(folder: Path) -> Answer:
    """Adds the explanation that lowers the criterion most, until none does."""
    fit, held, own, theirs = _both(folder)
    weight = 1.0 / _scales(fit)
    y = fit.residual * weight
    columns = [fit.columns(e) * weight[:, None] for e in own]
    chosen: list[int] = []
    A = np.zeros((len(y), 0))
    best = len(y) * np.log(y @ y / len(y))
    while len(chosen) < MOST:
        Q = np.linalg.qr(A)[0]
        left = y - Q @ (Q.T @ y)
        scores = []
        for B in columns:
            P = B - Q @ (Q.T @ B)
            x = np.linalg.lstsq(P.T @ P, P.T @ left, rcond=1e-10)[0]
            rss = float(left @ left - left @ (P @ x))
            scores.append(len(y) * np.log(max(rss, 1e-12) / len(y)) + (A.shape[1] + B.shape[1]) * np.log(len(y)))
        k = int(np.argmin(scores))
        if scores[k] >= best:
            break
        best = scores[k]
        chosen.append(k)
        A = np.hstack([A, columns[k]])
    x = np.linalg.lstsq(A, y, rcond=1e-10)[0] if chosen else np.zeros(0)
    parts = [held.columns(theirs[k]) for k in chosen]
    after = held.residual - (np.hstack(parts) @ x if chosen else 0.0)
    return Answer(_said(fit.setting.chain, [own[k] for k in chosen]), after)


def stlsq(folder: Path) -> Answer:
    """All columns at once, those below a threshold dropped; the threshold by the same criterion."""
    optimisers = importlib.import_module("pysindy.optimizers")
    fit, held, own, theirs = _both(folder)
    weight = 1.0 / _scales(fit)
    y = fit.residual * weight
    A = np.hstack([fit.columns(e) * weight[:, None] for e in own])
    owner = np.concatenate([np.full(e.columns.shape[2], k) for k, e in enumerate(own)])
    size = np.linalg.norm(A, axis=0) + 1e-12
    A = A / size
    best, coefficients = np.inf, np.zeros(A.shape[1])
    for part in (0.5, 0.2, 0.1, 0.05, 0.02):
        threshold = part * float(np.linalg.norm(y))
        # Many columns are all but dependent, hence the ridge, which is the one that pysindy comes with.
        optimiser = optimisers.STLSQ(threshold=threshold, alpha=0.05, max_iter=20, normalize_columns=False)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            optimiser.fit(A, y[:, None])
        x = np.asarray(optimiser.coef_).ravel()
        rss = float(np.sum((y - A @ x) ** 2))
        score = len(y) * np.log(rss / len(y)) + np.count_nonzero(x) * np.log(len(y))
        if score < best:
            best, coefficients = score, x
    chosen = sorted(set(owner[np.flatnonzero(coefficients)].tolist()))
    B = np.hstack([held.columns(e) for e in theirs])
    return Answer(_said(fit.setting.chain, [own[k] for k in chosen]), held.residual - B @ (coefficients / size))
