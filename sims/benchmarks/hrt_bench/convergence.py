"""The outline's convergence theorem as an experiment (Hybrid Reality Twins, section 3.2 and appendix A).

It says that the error of θ is at most C₂ η + C₃ |w|² / λ_min of the excitation. Here: the squared error of a payload's
mass late in a run against η, Q, R, excitation and model mismatch, beside a bound of that form whose two constants are
the smallest that hold for all runs. Above some η the rule diverges, which the theorem, silent on stability, does not
tell: such runs are printed and left out of the fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from filter_truth import COULOMB, Truth, told
from scipy.optimize import linprog

from hrt_bench.estimate import Array
from twin_diagram.estimation.filter.ekf import Ekf
from twin_diagram.scenario import Filter

DURATION: Final = 12.0
"""Of a run [s]."""
DIVERGED: Final = 1.0
"""A squared error beyond it [kg²]."""
MISMATCH: Final = 0.06
"""Root mean square share by which friction, drawn within a tenth, differs from what is told."""
BASE: Final = Filter(rule="gradient")
FAR: Final = (0.5, 1.5)
"""Times nominal friction."""
CASES: Final[dict[str, tuple[Filter, dict[str, Any]]]] = {
    "as it is": (BASE, {}),
    **{f"η = {eta:g}": (replace(BASE, learning_rate=eta), {}) for eta in (0.001, 0.003, 0.03)},
    **{f"Q × {f**2:g}": (replace(BASE, torque_std=BASE.torque_std * f), {}) for f in (0.3, 3.0)},
    **{
        f"R × {f**2:g}": (replace(BASE, velocity_std=f * BASE.velocity_std), {"velocity_noise": 1e-3 * f})
        for f in (0.5, 3.0)
    },
    **{f"excitation × {f:g}": (BASE, {"liveliness": f}) for f in (0.3, 0.6)},
    **{f"friction × {f:g}": (BASE, {"friction": COULOMB * f}) for f in FAR},
    "covariance": (Filter(), {}),
    "covariance, excitation × 0.3": (Filter(), {"liveliness": 0.3}),
    "covariance, friction × 1.5": (Filter(), {"friction": COULOMB * 1.5}),
}
"""One thing changed at a time: tuning, and the truth's fields."""


def learn(truth: Truth, tuning: Filter, duration: float) -> tuple[Array, Array, float]:
    """Times (K,) [s], mass learnt (K,) [kg], and the excitation: information per second about the mass [1/(kg² s)]."""
    ekf = Ekf(told(), tuning)
    times, masses, excitation = [], [], 0.0
    before = None
    for t, q, v, tau, _ in truth.messages(duration):
        ekf.observe(q, v, tau, t)
        if before is not None and t > 1.0:
            Y = ekf.terms.payload_regressor(q, v, (v - before) / 0.005)[:, 0]
            moving = np.abs(v) > 0.01
            excitation += float(np.sum((Y / (0.1 + 0.15 * COULOMB))[moving] ** 2)) * 0.005
        before = v
        times.append(t)
        masses.append(float(ekf.belief.theta[0]))
    return np.array(times), np.array(masses), excitation / duration


def measure(seed: int, duration: float = DURATION) -> list[dict[str, Any]]:
    """One record per case: η (None for the rule by covariance), squared error [kg²], excitation, mismatch."""
    records = []
    for label, (tuning, changes) in CASES.items():
        truth = replace(Truth.draw(seed), **changes)
        times, masses, information = learn(truth, tuning, duration)
        mismatch = float(changes["friction"][0] / COULOMB[0] - 1.0) if "friction" in changes else MISMATCH
        records.append(
            {
                "method": label,
                "eta": tuning.learning_rate if tuning.rule == "gradient" else None,
                "squared": float(np.mean((masses[times > 2 * duration / 3] - truth.mass) ** 2)),
                "excitation": information,
                "mismatch": mismatch,
            }
        )
    return records


def table(records: Sequence[dict[str, Any]]) -> list[str]:
    """Means over seeds, beside the bound."""
    found = []
    for label in dict.fromkeys(r["method"] for r in records):
        own = [r for r in records if r["method"] == label]
        squared, information = (float(np.mean([r[key] for r in own])) for key in ("squared", "excitation"))
        found.append((label, own[0]["eta"], squared, information, own[0]["mismatch"]))
    bounded = [row for row in found if row[1] is not None and row[2] < DIVERGED]
    terms = np.array([[row[1], row[4] ** 2 / row[3]] for row in bounded])
    best = linprog(terms.sum(axis=0), A_ub=-terms, b_ub=[-row[2] for row in bounded], bounds=[(0, None)] * 2).x
    lines = [
        f"{'run':30s} {'error² [kg²]':>12s} {'rms [kg]':>9s} {'excitation [1/(kg² s)]':>23s} "
        f"{'bound on error² [kg²]':>22s}"
    ]
    for label, eta, squared, information, mismatch in found:
        bound = "–" if eta is None else f"{best @ [eta, mismatch**2 / information]:.4f}"
        if eta is not None and squared >= DIVERGED:
            bound = "diverged"
        lines.append(f"{label:30s} {squared:12.4f} {np.sqrt(squared):9.3f} {information:23.3g} {bound:>22s}")
    lines.append(
        f"C₂ = {best[0]:.3g} kg², C₃ = {best[1]:.3g}: the smallest that hold for all runs that did not diverge"
    )
    return lines
