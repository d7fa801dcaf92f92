"""Prints what runs of learning came to, beside what is aimed at."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from braking_bench.counting import wilson

Array = npt.NDArray[np.float64]
Row = dict[str, Any]
FINE = 0.1
"""Noise of torques up to which the sharper aims hold [N·m]."""
WORSE = 0.05
"""By more than this no worst moment may be worse than that of an even density."""
PARAMETERS = ("mass", "x", "y", "z", "xx", "yy", "zz", "xy", "xz", "yz")


def share(hits: int, count: int) -> str:
    """Return a share with its 95 % interval."""
    low, high = wilson(hits, count)
    return f"{hits} of {count} ({100 * low:.0f} to {100 * high:.0f} %)" if count else "none"


def told(rows: Sequence[Row], runs: Sequence[Row], noise: float) -> str:
    """Return the tables: each object, then medians and 90th percentiles, rows apart, then what failed, by cause.

    Args:
        rows: of the objects.
        runs: of the bins.
        noise: of measured torques [N·m], by which the aims differ.
    """
    # What was lost on its way has an asset of what was seen by then, and does not count.
    done = [row for row in rows if row["state"] == "finished" and "true" in row]
    parts = (_each(done), _bins(rows, done, runs), _aims(done, noise), _apart(done), _honest(done))
    return "\n".join(line for part in parts for line in part)


def _each(done: Sequence[Row]) -> Iterator[str]:
    yield "seed  object     true       kg    → truth  → mesh  in 3 mm  seen %   mass %  centre mm  moments %  even %"
    for row in done:
        loaded = "+" if row["loaded"] else " "
        yield (
            f"{row['seed']:5d} {row['object']:10s} {row['true']:8s} {row['true_mass']:5.2f} {loaded}"
            f" {row['to_truth_mm']:6.2f} {row['to_mesh_mm']:7.2f}"
            f" {100 * row['within_3mm']:7.1f} {100 * row['seen']:7.1f}"
            f" {100 * row['mass']:8.2f} {row['centre_mm']:8.2f} {100 * row['moments']:9.1f}"
            f" {100 * row['even_moments']:8.1f}  {' / '.join((row['by'] or {}).values())}"
        )


def _bins(rows: Sequence[Row], done: Sequence[Row], runs: Sequence[Row]) -> Iterator[str]:
    count = sum(run["objects"] for run in runs)
    yield f"finished without help: {share(len(done), count)}, aim 95 %"
    for name in ("put_away", "left", "elsewhere", "contacts"):
        words = {
            "put_away": "in the other bin",
            "left": "left in the first",
            "contacts": "contacts that no step asks for",
        }
        yield f"{words.get(name, name)}: {sum(run[name] for run in runs)}"
    causes = Counter(row["why"] or row["state"] for row in rows if row not in done)
    yield from (f"not finished: {why} ({many})" for why, many in causes.items())
    for key, name, aim in (("sim_s", "simulated", 3), ("wall_s", "by the clock", 5)):
        if done:
            yield f"time per object, {name}: median {np.median([row[key] for row in done]) / 60:.1f} min, aim ≤ {aim}"


def _aims(done: Sequence[Row], noise: float) -> Iterator[str]:
    fine = noise <= FINE
    heavy, half = ([row for row in done if row["true_mass"] >= least] for least in (0.3, 0.5))
    for name, some, scale, aim in (
        ("to_truth_mm", done, 1.0, "≤ 1 mm"),
        ("to_mesh_mm", done, 1.0, "≤ 1 mm"),
        ("within_3mm", done, 100.0, "≥ 98 %"),
        ("seen", done, 100.0, "≥ 98 %"),
        ("mass", heavy, 100.0, "≤ 1 / 2 %, from 0.3 kg"),
        ("centre_mm", done, 1.0, "≤ 2 / 4 mm" if fine else "≤ 3 / 6 mm"),
        ("moments", half, 100.0, "≤ 10 %, from 0.5 kg" if fine else "≤ 20 %, from 0.5 kg"),
        ("axis_deg", [row for row in half if row["axis_deg"] is not None], 1.0, "≤ 10°" if fine else "none"),
    ):
        worst = 0.1 if name in ("within_3mm", "seen") else 0.9
        yield f"{name:12s} {_pair(some, name, scale, worst)}  of {len(some):3d}, aim {aim}"
    bounds = np.array([row["bound"] for row in done if row["bound"]])
    if len(bounds):
        mass, centre, moment = np.median(bounds, axis=0)
        yield (
            f"bound of the motions for the reference object: {100 * mass:.2f} %, {1e3 * centre:.2f} mm,"
            f" {100 * moment:.0f} %, aim ≤ 0.1 %, 0.5 mm, 13 %"
        )


def _apart(done: Sequence[Row]) -> Iterator[str]:
    """Yield rows by load and by mass."""
    groups: list[tuple[str, Callable[[Row], bool]]] = [
        ("without a load off centre", lambda row: not row["loaded"]),
        ("with one", lambda row: bool(row["loaded"])),
    ]
    for low, high in ((0.0, 0.3), (0.3, 0.5), (0.5, 1.0), (1.0, 2.0)):
        groups.append((f"{low} to {high} kg", lambda row, low=low, high=high: low <= row["true_mass"] < high))
    for name, chosen in groups:
        some = [row for row in done if chosen(row)]
        if some:
            pairs = ", ".join(
                f"{what} {_pair(some, key, scale, 0.9)}"
                for what, key, scale in (
                    *(("mass %", "mass", 100.0), ("centre mm", "centre_mm", 1.0)),
                    *(("moments %", "moments", 100.0), ("even %", "even_moments", 100.0)),
                )
            )
            yield f"  {name} ({len(some)}): {pairs}"


def _honest(done: Sequence[Row]) -> Iterator[str]:
    """Yield how weighing compares with an even density, and whether told intervals hold."""
    loaded = [row for row in done if row["loaded"]]
    better = sum(row["moments"] < row["even_moments"] for row in loaded)
    yield f"moments better than an even density's, with a load: {share(better, len(loaded))}, aim ≥ 80 %"
    worse = [row["moments"] - row["even_moments"] for row in done]
    count = sum(off > WORSE for off in worse)
    yield f"worse by more than 5 points: {count} of {len(done)}, by up to {100 * max(worse, default=0.0):.0f}, aim none"
    held = np.array([row["held"] for row in done if row["held"]])
    if len(held):
        shares = ", ".join(f"{name} {100 * part:.0f}" for name, part in zip(PARAMETERS, held.mean(axis=0), strict=True))
        yield f"95 % intervals that hold the truth, % of {len(held)}: {shares}; aim 88 to 99"


def _pair(rows: Sequence[Row], key: str, scale: float, worst: float) -> str:
    if not rows:
        return "none"
    values: Array = np.abs(scale * np.array([row[key] for row in rows], dtype=float))
    return f"{np.median(values):.2f} / {np.quantile(values, worst):.2f}"
