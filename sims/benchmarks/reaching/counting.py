"""Counts runs: which succeeded, why others did not, and how sure that is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from braking_bench.counting import wilson

LEAST = 5.0
"""Clearance that is aimed at [mm]."""
SUCCESS = 98.0
"""Share of successes that is aimed at [%]."""


def cause(summary: Mapping[str, Any]) -> str:
    """Return why a run is no success; empty where it is one: the goal is reached and nothing was touched."""
    if summary["contacts"] or (summary["clearance_min_mm"] or 0.0) <= 0.0:
        return "touched"
    if not summary["goal"]["reached"]:
        lacks = {entry["reason"] for entry in summary.get("health", [])}
        return "out of reach" if "goal_out_of_reach" in lacks else "not reached in time"
    return ""


def row(seed: int, summary: Mapping[str, Any]) -> str:
    """Return the table's line about one run."""
    why = cause(summary)
    off = summary["goal"]["error_mm"]
    return f"{seed:7d}  {summary['clearance_min_mm'] or 0.0:8.1f}  {off:8.1f}  {why or 'reached'}"


def told(summaries: Sequence[Mapping[str, Any]]) -> str:
    """Return the figures of all runs, on lines."""
    causes = Counter(filter(None, map(cause, summaries)))
    good, count = len(summaries) - sum(causes.values()), len(summaries)
    low, high = wilson(good, count)
    clear = np.array([summary["clearance_min_mm"] or 0.0 for summary in summaries])
    lines = [
        f"reached, nothing touched: {good} of {count}, {100 * good / count:.1f} % "
        f"(95 %: {100 * low:.1f} to {100 * high:.1f}; aim {SUCCESS:g} %)",
        f"clearance: {clear.min():.1f} mm at the least (aim {LEAST:g}), {(clear < LEAST).sum()} runs below",
        *(f"  {number} × {why}" for why, number in causes.most_common()),
    ]
    return "\n".join(lines)
