"""Two ways to learn a payload, side by side: by covariance, and by the outline's gradient with η = 0.01.

    python sims/benchmarks/adaptation.py --out out/adaptation

A UR5e in MuJoCo (`filter_truth`) takes up 2 kg while it moves; both rules start from one filter. Then the outline's
convergence theorem as an experiment: see `hrt_bench.convergence`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from filter_truth import Truth
from hrt_bench.convergence import learn, measure, table

from twin_diagram.atomic_file import write
from twin_diagram.scenario import Filter

ADDED, AT = 2.0, 5.0
"""Mass that is taken up [kg], and when [s]."""


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


def main() -> None:
    """Prints both tables and writes the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/adaptation"))
    parser.add_argument("--seed", type=int, default=1001)
    parser.add_argument("--seeds", type=int, default=2, help="runs per case of the convergence experiment")
    parser.add_argument("--duration", type=float, default=12.0, help="of each of them [s]")
    args = parser.parse_args()
    learnt = side_by_side(args.out, args.seed)
    print(learnt, flush=True)
    seeds = range(args.seed, args.seed + args.seeds)
    experiment = "\n".join(table([record for seed in seeds for record in measure(seed, args.duration)]))
    print(experiment)
    write(args.out / "adaptation.md", learnt + "\n\n```\n" + experiment + "\n```\n")


if __name__ == "__main__":
    main()
