"""Two ways to learn a payload, side by side: by covariance, and by the outline's gradient with η = 0.01.

    python sims/adaptation.py --out out/adaptation

A UR5e in MuJoCo (`filter_truth`) takes up 2 kg while it moves; both rules start from one filter. Then the outline's
convergence theorem as an experiment (Hybrid Reality Twins, section 3.2 and appendix A: the error of θ is at most
C₂ η + C₃ |w|² / λ_min of the excitation): the error late in a run against η, Q, R, excitation and model mismatch,
beside a bound of that form whose two constants are fitted to the runs. Above some η the rule diverges, which the
theorem, silent on stability, does not tell: such runs are printed and left out of the fit.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from filter_truth import COULOMB, Truth, told
from scipy.optimize import linprog

from twin_diagram.estimation.ekf import Ekf
from twin_diagram.looking.atomic_file import write
from twin_diagram.scenario import Filter

ADDED, AT = 2.0, 5.0
"""Mass that is taken up [kg], and when [s]."""


def learn(truth: Truth, tuning: Filter, duration: float) -> tuple[np.ndarray, np.ndarray, float]:
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


def side_by_side(out: Path, seed: int) -> str:
    """The same arm under both rules: a picture and a table."""
    truth = Truth.draw(seed, added=ADDED, added_at=AT)
    fig, axes = plt.subplots(figsize=(8, 4.5))
    rows = ["| rule | error at 0.5 s | 1 s | 2 s | 5 s |", "|---|---|---|---|---|"]
    for label, tuning in (
        ("covariance", Filter()),
        ("gradient, η = 0.01", Filter(rule="gradient")),
        ("gradient, η = 0.003", Filter(rule="gradient", learning_rate=0.003)),
    ):
        times, masses, _ = learn(truth, tuning, AT + 6.0)
        axes.plot(times, masses, label=label)
        at = np.searchsorted(times, AT + np.array([0.5, 1.0, 2.0, 5.0]))
        errors = np.abs(masses[at] - truth.mass - ADDED) / (truth.mass + ADDED)
        rows.append(f"| {label} | " + " | ".join(f"{100 * error:.1f} %" for error in errors) + " |")
    after = truth.mass + ADDED
    axes.step([0.0, AT, AT + 6.0], [truth.mass, after, after], "k--", where="post", label="true")
    axes.set(xlabel="time [s]", ylabel="mass learnt [kg]", title=f"{ADDED:g} kg taken up at {AT:g} s")
    axes.legend()
    fig.tight_layout()
    out.mkdir(parents=True, exist_ok=True)
    fig.savefig(out / "adaptation.png", dpi=120)
    plt.close(fig)
    return "\n".join(rows)


def convergence(seeds: range, duration: float) -> str:
    """Root mean square error of the mass over the last third of the runs, as one thing is changed at a time."""
    base = Filter(rule="gradient")
    cases: list[tuple[str, Filter, dict[str, Any]]] = [
        ("as it is", base, {}),
        *((f"η = {eta:g}", replace(base, learning_rate=eta), {}) for eta in (0.001, 0.003, 0.03)),
        *((f"Q × {factor**2:g}", replace(base, torque_std=base.torque_std * factor), {}) for factor in (0.3, 3.0)),
        *(
            (
                f"R × {factor**2:g}",
                replace(base, velocity_std=factor * base.velocity_std),
                {"velocity_noise": 1e-3 * factor},
            )
            for factor in (0.5, 3.0)
        ),
        *((f"excitation × {factor:g}", base, {"liveliness": factor}) for factor in (0.3, 0.6)),
        *((f"friction × {factor:g}", base, {"friction": COULOMB * factor}) for factor in (0.5, 1.5)),
        ("covariance", Filter(), {}),
        ("covariance, excitation × 0.3", Filter(), {"liveliness": 0.3}),
        ("covariance, friction × 1.5", Filter(), {"friction": COULOMB * 1.5}),
    ]
    found = []
    for label, tuning, changes in cases:
        errors, excitation = [], []
        for seed in seeds:
            truth = replace(Truth.draw(seed), **changes)
            times, masses, information = learn(truth, tuning, duration)
            errors.append(np.mean((masses[times > 2 * duration / 3] - truth.mass) ** 2))
            excitation.append(information)
        friction = float(changes["friction"][0] / COULOMB[0] - 1.0) if "friction" in changes else 0.06
        found.append((label, tuning, float(np.mean(errors)), float(np.mean(excitation)), friction))
    gradient = [row for row in found if row[1].rule == "gradient" and row[2] < 1.0]
    terms = np.array([[row[1].learning_rate, (row[4] ** 2) / row[3]] for row in gradient])
    error = np.array([row[2] for row in gradient])
    # The least C₂, C₃ ≥ 0 that bound all runs of the gradient rule.
    best = linprog(terms.sum(axis=0), A_ub=-terms, b_ub=-error, bounds=[(0, None), (0, None)])
    rows = [
        "| run | error² [kg²] | rms [kg] | excitation [1/(kg² s)] | bound on error² [kg²] |",
        "|---|---|---|---|---|",
    ]
    for label, tuning, squared, information, friction in found:
        limit = (
            best.x @ [tuning.learning_rate, friction**2 / information]
            if tuning.rule == "gradient" and squared < 1.0
            else np.nan
        )
        rows.append(
            f"| {label} | {squared:.4f} | {np.sqrt(squared):.3f} | {information:.3g} | "
            + (f"{limit:.4f} |" if np.isfinite(limit) else "– |")
        )
    rows.append(f"\nfitted: C₂ = {best.x[0]:.3g} kg², C₃ = {best.x[1]:.3g}")
    return "\n".join(rows)


def main() -> None:
    """Prints both tables and writes the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/adaptation"))
    parser.add_argument("--seed", type=int, default=1001)
    parser.add_argument("--seeds", type=int, default=2, help="runs per case of the convergence experiment")
    parser.add_argument("--duration", type=float, default=12.0, help="of each of them [s]")
    args = parser.parse_args()
    table = side_by_side(args.out, args.seed)
    print(table, flush=True)
    experiment = convergence(range(args.seed, args.seed + args.seeds), args.duration)
    print(experiment)
    write(args.out / "adaptation.md", table + "\n\n" + experiment + "\n")


if __name__ == "__main__":
    main()
