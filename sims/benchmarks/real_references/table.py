"""What each estimator leaves of a row's held-out torque, and how `gap` compares with the others."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from real_data import DATA

from real_references import least_squares
from real_references.regression import equations
from real_references.rows import LWR_RUNS, Row, cut
from twin_diagram.logs import read_log
from twin_diagram.model.prediction import load_model_for, torque_residual
from twin_diagram.signals.arrays import Array

LONGEST = 1800.0
"""A run of `gap` is given up after this [s]."""


def references(row: Row, folder: Path) -> dict[str, Array]:
    """(n,) held-out residuals of the description and of what two estimators make of the fit log."""
    fit, held = logs(row, folder)
    model = DATA / row.model
    seen, unseen = equations(model, fit, row.side), equations(model, held, row.side)
    scale = np.array(row.scale) if row.scale else 1.0
    result = {"description": unseen.before / scale, "classical": unseen.left(least_squares.classical(seen)) / scale}
    if row.told:
        result["physical"] = unseen.left(least_squares.physical(seen)) / scale
    return result


def logs(row: Row, folder: Path) -> tuple[Path, Path]:
    """The fit and the held-out log of a row; what is cut is written to a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    fit = cut(DATA / row.fit, row.fit_span, folder / "fit.csv")
    return fit, cut(DATA / row.holdout, row.holdout_span, folder / "holdout.csv")


def run_gap(row: Row, folder: Path, sided: bool) -> dict[str, Any]:
    """What `twin-diagram gap` says of a row, as any user would call it, with its processor seconds."""
    fit, held = logs(row, folder)
    command = [sys.executable, "-m", "twin_diagram", "gap", "--model", str(DATA / row.model)]
    command += ["--fit", str(fit), "--holdout", str(held), "--out", str(folder / "gap")]
    command += ["--torque-side", row.side] if sided else []
    root = str(Path(__file__).resolve().parents[3])
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
    used = _children()
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=LONGEST)
    seconds = _children() - used
    if done.returncode:
        return {"error": done.stderr.strip().splitlines()[-1][:200], "processor": seconds}
    return {**json.loads((folder / "gap" / "gap.json").read_text(encoding="utf-8")), "processor": seconds}


def agreement(a: Path, b: Path, log: Path) -> tuple[Array, Array]:
    """How far two corrected models' torques differ on a log, and what the better of them leaves, each (n,) RMS N·m."""
    left = []
    for folder in (a, b):
        model, checked, _ = load_model_for(read_log(log), folder)
        left.append(torque_residual(model, checked))
    apart = np.sqrt(np.mean((left[0] - left[1]) ** 2, axis=0))
    return apart, np.min(np.sqrt(np.mean(np.square(left), axis=1)), axis=0)


def agreement_text(out: Path) -> str:
    """What `agreement` says of both descriptions of the LWR4+, on run 2; of runs that were done before."""
    folders = [out / name / "gap" / "model" for name in ("lwr4", "lwr4-published")]
    if not all(folder.is_dir() for folder in folders):
        return ""
    apart, left = agreement(*folders, DATA / LWR_RUNS[1])
    share = apart / left
    return "\n".join(
        [
            "lwr4 and lwr4-published: corrected models' torques on run 2",
            f"  apart             {_numbers(apart)}",
            f"  over what is left {_numbers(share)}  mean {np.mean(share):.2f}, most {np.max(share):.2f}",
        ]
    )


def _children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def text(row: Row, found: dict[str, Array], gap: dict[str, Any] | None) -> str:
    """A row's block of the table: residuals, `gap` over the others, and what it named."""
    lines = [f"{row.name}: {row.fit} {_span(row.fit_span)} → {row.holdout} {_span(row.holdout_span)}"]
    found = dict(found)
    if gap is not None and "error" not in gap:
        after = np.array(list(gap["gap"]["torque_rms"]["holdout"]["after"].values()), dtype=float)
        found["gap"] = after / (np.array(row.scale) if row.scale else 1.0)
    lines += [f"  {name:<18}{_numbers(values)}" for name, values in found.items()]
    for other in ("physical", "description"):
        if "gap" in found and other in found:
            ratio = found["gap"] / found[other]
            said = f"  mean {np.mean(ratio):.2f}, most {np.max(ratio):.2f}"
            lines.append(f"  gap / {other:<12}{_numbers(ratio)}{said}")
    if gap is not None:
        lines.append("  " + _named(gap))
    return "\n".join(lines)


def _named(gap: dict[str, Any]) -> str:
    if "error" in gap:
        return f"gap: {gap['error']}"
    names = [f"{e['name']}({len(e['joints'] or e['links'])})" for e in gap["effects"]]
    rest = " with remainder" if gap["remainder"] else ""
    return f"{gap['verdict']}{rest}: {', '.join(names) or '–'}; {gap['processor']:.0f} s of processor time"


def _numbers(values: Array) -> str:
    return " ".join(f"{x:6.2f}" for x in values)


def _span(span: tuple[float, float]) -> str:
    low, high = span
    return " ".join([f"from {low:g} s" if np.isfinite(low) else "", f"to {high:g} s" if np.isfinite(high) else ""])
