"""Prints what runs of learning came to, beside what is aimed at."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def wilson(hits: int, count: int) -> str:
    """Return a share with its 95 % interval (Wilson)."""
    if not count:
        return "none"
    z, p = 1.96, hits / count
    middle = (p + z * z / (2 * count)) / (1 + z * z / count)
    half = z * np.sqrt(p * (1 - p) / count + z * z / (4 * count**2)) / (1 + z * z / count)
    return f"{hits} of {count} ({100 * max(0.0, middle - half):.0f} to {100 * min(1.0, middle + half):.0f} %)"


def told(rows: Sequence[dict[str, Any]]) -> str:
    """Return the tables: each object, then medians and 90th percentiles, then what failed, by cause."""
    # What was lost on its way has an asset of what was seen by then, and does not count.
    done = [row for row in rows if row["state"] == "finished" and "true" in row]
    lines = [
        "seed  object     true       → truth  → mesh  in 3 mm  seen %  unseen   mass %  centre mm  moments %  even %"
    ]
    for row in done:
        lines.append(
            f"{row['seed']:5d} {row['object']:10s} {row['true']:10s} {row['to_truth_mm']:6.2f} {row['to_mesh_mm']:7.2f}"
            f" {100 * row['within_3mm']:7.1f} {100 * row['seen']:7.1f} {100 * row['unseen']:7.1f}"
            f" {100 * row['mass']:8.2f} {row['centre_mm']:8.2f} {100 * row['moments']:9.1f}"
            f" {100 * row['even_moments']:8.1f}"
        )
    lines.append(f"finished: {wilson(len(done), len(rows))}, aim 95 %")
    for name, aim, scale in (
        ("to_truth_mm", "≤ 1 mm", 1.0),
        ("to_mesh_mm", "≤ 1 mm", 1.0),
        ("within_3mm", "≥ 98 %", 100.0),
        ("seen", "≥ 98 %", 100.0),
        ("mass", "≤ 1 / 2 %", 100.0),
        ("centre_mm", "≤ 2 / 4 mm", 1.0),
        ("moments", "≤ 10 %", 100.0),
    ):
        values: Array = np.abs([scale * row[name] for row in done if name != "mass" or row["true_mass"] >= 0.3])
        if len(values):
            worse = np.quantile(values, 0.1 if name in ("within_3mm", "seen") else 0.9)
            lines.append(f"{name:12s} median {np.median(values):7.2f}  90 % within {worse:7.2f}  aim {aim}")
    causes = Counter(row["why"] or row["state"] for row in rows if row not in done)
    lines += [f"not finished: {why} ({count})" for why, count in causes.items()]
    return "\n".join(lines)
