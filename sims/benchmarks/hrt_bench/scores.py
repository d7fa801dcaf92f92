"""Holds a method's estimates against the truth. The one place that opens it."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from filter_truth import COULOMB, JOINTS, ROTOR, VISCOUS
from hrt_truth.hidden import LIMIT
from hrt_truth.streams import Truth
from pydrake.multibody.tree import MultibodyForces, SpatialInertia
from scipy.ndimage import maximum_filter1d
from scipy.stats import chi2

from hrt_bench.estimate import AHEAD, STRIDE, Array, Estimate
from twin_diagram.estimation.dynamics.arm_dynamics import ArmTerms

START = 2.0
"""Left out at the beginning of a run [s]."""
DT = 0.005
THIN = 10
"""Of the torques before a change every so manieth is reckoned with, so many times."""


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=-1))))


def accuracy(e: Estimate, truth: Truth, start: float = START, end: float = np.inf) -> dict[str, float]:
    """RMSE of the hand now [mm] and ahead, its speed [m/s], orientation [deg], jerk [m/s³] and lag [ms]."""
    rows = np.flatnonzero((truth.time >= start) & (truth.time < end))
    result = {
        "now_mm": 1e3 * _rms(e.hand[rows, 4:] - truth.hand[rows, 4:]),
        "speed": _rms(e.hand_speed[rows] - truth.hand_speed[rows]),
    }
    for horizon in AHEAD:
        if horizon not in e.ahead:
            continue
        k = np.arange(len(e.ahead[horizon])) * STRIDE
        there = k + round(horizon / DT)
        good = (k >= rows[0]) & (there <= rows[-1])
        result[f"ahead_{round(1e3 * horizon)}_mm"] = 1e3 * _rms(e.ahead[horizon][good] - truth.hand[there[good], 4:])
    dot = np.abs(np.sum(e.hand[rows, :4] * truth.hand[rows, :4], axis=1))
    result["turn_deg"] = float(np.degrees(np.sqrt(np.mean((2.0 * np.arccos(np.minimum(dot, 1.0))) ** 2))))
    result["jerk"] = _rms(np.diff(e.hand_speed[rows], n=2, axis=0) / DT**2)
    result["lag_ms"] = 1e3 * lag(e.hand[rows, 4:], truth.hand[rows, 4:])
    return result


def lag(found: Array, true: Array) -> float:
    """By how much a signal (N, 3) trails another [s]: the shift with the smallest difference, to a fraction."""
    shifts = np.arange(-4, 31)
    inner = np.arange(31, len(true) - 5)
    cost = np.array([np.mean((found[inner] - true[inner - s]) ** 2) for s in shifts])
    k = int(np.clip(np.argmin(cost), 1, len(shifts) - 2))
    a, b, c = cost[k - 1 : k + 2]
    bend = a - 2.0 * b + c
    return float(DT * (shifts[k] + (0.5 * (a - c) / bend if bend > 0.0 else 0.0)))


def honesty(e: Estimate, truth: Truth, start: float = START) -> dict[str, float]:
    """NEES of [q, v] and NIS of the arm's messages over their degrees of freedom, and the shares in the 95 % band."""
    rows = np.flatnonzero(truth.time >= start)[::STRIDE]
    error = np.hstack([truth.q, truth.v])[rows] - e.extra["x"][rows]
    n = error.shape[1]
    nees = np.array([d @ np.linalg.solve(P, d) for d, P in zip(error, e.extra["P"][rows], strict=True)])
    low, high = chi2.ppf([0.025, 0.975], n)
    result = {
        "nees": float(nees.mean() / n),
        "nees_in_95": float(np.mean((nees > low) & (nees < high))),
        "nees_below": float(np.mean(nees < high)),
    }
    nis = e.extra["nis"][truth.time >= start]
    nis = nis[np.isfinite(nis)]
    if len(nis):
        result |= {"nis": float(nis.mean() / n), "nis_in_95": float(np.mean((nis > low) & (nis < high)))}
    return result


def rejection(e: Estimate, truth: Truth) -> dict[str, float]:
    """Share of the camera's outliers that were refused, and of its good poses."""
    rows = e.extra.get("outcome_camera")
    if rows is None:
        return {}
    wrong = truth.outliers[rows[:, 0].astype(int)] > 0.0
    refused = rows[:, 1] == 0.0
    return {
        "outliers_refused": float(refused[wrong].mean()) if wrong.any() else np.nan,
        "good_refused": float(refused[~wrong].mean()),
    }


def recovery(
    error: Array, time: Array, at: float, window: float = 0.1, horizon: float = 4.0, usual: Array | None = None
) -> dict[str, float]:
    """How long after a change errors (N,) stay above the band of those before it [s].

    The band is the largest RMS of a window before the change; recovered is when the last window above it has passed.
    Of windows as high as the same run's without the change, whose errors are `usual`, none is the change's: `own_s`.
    """
    step = time[1] - time[0]
    width = max(1, round(window / step))

    def rms(x: Array) -> Array:
        return np.sqrt(np.convolve(np.nan_to_num(x) ** 2, np.full(width, 1.0 / width), mode="valid"))

    smooth, ends = rms(error), time[width - 1 :]
    before = smooth[(ends >= max(START, at - 7.0)) & (ends < at)]
    after = (ends >= at) & (ends < at + horizon)

    def last(above: np.ndarray) -> float:
        return float(ends[above].max() - at) if above.any() else 0.0

    above = after & (smooth > before.max())
    result = {
        "recovered_s": last(above),
        "before_mm": float(1e3 * np.sqrt(np.mean(before**2))),
        "worst_mm": float(1e3 * smooth[after].max()),
    }
    if usual is not None:
        as_ever = maximum_filter1d((rms(usual) > before.max()).astype(float), 2 * width + 1) > 0.0
        result["own_s"] = last(above & ~as_ever)
        result["unchanged_s"] = last(after & (rms(usual) > before.max()))
    return result


def mass_bound(terms: ArmTerms, truth: Truth, start: float, end: float) -> float:
    """Standard deviation of a payload's mass [kg] below which no unbiased estimate from the arm's torques comes.

    The Cramér-Rao bound of the mass alone, motion known exactly, from torques with white noise between two times, where
    each joint's friction is off by a constant: the tenth either way within which it was drawn. All else that is not
    known, the payload's centre above all, only raises it.
    """
    rows = (truth.time > start) & (truth.time <= end)
    a = np.gradient(truth.v, truth.time, axis=0)[rows]
    Y = np.array([terms.payload_regressor(*x)[:, 0] for x in zip(truth.q[rows], truth.v[rows], a, strict=True)])
    noise, offset = (0.003 * LIMIT) ** 2, (0.1 * COULOMB) ** 2 / 3.0
    information = (np.sum(Y**2, axis=0) - offset * Y.sum(axis=0) ** 2 / (noise + len(Y) * offset)) / noise
    return float(1.0 / np.sqrt(information.sum()))


def _by_links(terms: ArmTerms, q: Array, v: Array, a: Array) -> Array:
    """(N, n, n) torque of the arm as described by the scale of each link's mass and inertia."""
    plant, (count, n) = terms.plant, q.shape
    context = plant.CreateDefaultContext()

    def torque() -> Array:
        found = np.empty((count, n))
        for k in range(count):
            plant.SetPositions(context, q[k])
            plant.SetVelocities(context, v[k])
            forces = MultibodyForces(plant)
            plant.CalcForceElementsContribution(context, forces)
            found[k] = plant.CalcInverseDynamics(context, a[k], forces)
        return found

    plain, result = torque(), np.empty((count, n, n))
    for k in range(n):
        body = plant.GetJointByName(JOINTS[k]).child_body()
        inertia = body.CalcSpatialInertiaInBodyFrame(context)
        double = SpatialInertia(2.0 * inertia.get_mass(), inertia.get_com(), inertia.get_unit_inertia())
        body.SetSpatialInertiaInBodyFrame(context, double)
        result[:, :, k] = torque() - plain
        body.SetSpatialInertiaInBodyFrame(context, inertia)
    return result


SLIDING: Final = 0.025
"""Slower, dry friction may hold a joint or let it go: its torque then says nothing of the level [rad/s]."""


def friction_bound(terms: ArmTerms, truth: Truth, at: float, after: float) -> Array:
    """Standard deviations (n,) of levels of dry friction that changed, below which no unbiased estimate comes [N·m].

    The Cramér-Rao bound, motion known exactly, from torques with white noise from `START` until `after` seconds after
    the change. Not known either, within what they were drawn from: the level before, damping, rotor and the masses of
    the links, of which the time before tells. Infinite for a joint that did not slide.
    """
    rows = np.flatnonzero((truth.time > START) & (truth.time <= at + after))
    weight = np.where(truth.time[rows] < at, float(THIN), 1.0)
    keep = (truth.time[rows] >= at) | (np.arange(len(rows)) % THIN == 0)
    rows, weight = rows[keep], weight[keep]
    v, a = truth.v[rows], np.gradient(truth.v, truth.time, axis=0)[rows]
    by_links = _by_links(terms, truth.q[rows], v, a)
    n, late = terms.n, truth.time[rows] >= at
    information = np.zeros((5 * n, 5 * n))
    for j in range(n):
        slides = np.abs(v[:, j]) > SLIDING
        Y = np.zeros((len(rows), 5 * n))
        Y[:, :n] = by_links[:, j]
        Y[:, n + j], Y[:, 2 * n + j] = v[:, j], a[:, j]
        Y[:, 3 * n + j], Y[:, 4 * n + j] = np.sign(v[:, j]) * ~late, np.sign(v[:, j]) * late
        Y = Y[slides] * np.sqrt(weight[slides])[:, None]
        information += Y.T @ Y / (0.003 * LIMIT[j]) ** 2
    spread = np.concatenate([np.full(n, 0.01), 0.1 * VISCOUS, 0.05 * ROTOR, 0.1 * COULOMB])
    information[np.arange(4 * n), np.arange(4 * n)] += 3.0 / spread**2
    told = np.concatenate([np.full(4 * n, True), information.diagonal()[4 * n :] > 0.0])
    bound = np.full(5 * n, np.inf)
    bound[told] = np.sqrt(np.linalg.inv(information[np.ix_(told, told)]).diagonal())
    return bound[4 * n :]


def latency(alarms: list[float], fault: Array, patience: float) -> dict[str, Any]:
    """Of the first alarm after a fault [ms]; None where none came in time. `false` counts those before it."""
    began = float(fault[0])
    early = sum(t < began for t in alarms)
    after = [t for t in alarms if began <= t < began + patience]
    return {"latency_ms": 1e3 * (min(after) - began) if after else None, "false": early}


def poisson_upper(count: int, hours: float, level: float = 0.95) -> float:
    """Upper bound of a rate [1/h] from events counted."""
    return float(chi2.ppf(level, 2 * (count + 1)) / (2.0 * hours)) if hours > 0.0 else np.inf


def hand_error(e: Estimate, truth: Truth) -> Array:
    """(N,) [m]."""
    return np.asarray(np.linalg.norm(e.hand[:, 4:] - truth.hand[:, 4:], axis=1))
