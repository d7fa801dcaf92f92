"""The tables of a weighing benchmark, beside their targets."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest

from twin_diagram.estimation.weighing.weighing import PARAMETERS
from weighing_truth.trial import ABLATIONS, NOISES

Row = dict[str, Any]
WORSE = 0.05
"""Never worse than even density by more than this."""


def report(rows: Sequence[Row]) -> str:
    """All tables as text."""
    return "\n".join(_lines(rows))


def _lines(rows: Sequence[Row]) -> Iterator[str]:
    failed = [row for row in rows if "failed" in row]
    good = [row for row in rows if "failed" not in row]
    ours = [row for row in good if row["way"] == "ours"]
    seeds = sorted({row["seed"] for row in rows})
    yield f"seeds {seeds[0]} to {seeds[-1]}, {len(seeds)} objects, {len(failed)} not weighed"
    yield from (f"  seed {row['seed']}: {row['failed']}" for row in failed)
    if not ours:
        return
    yield f"processor time, median: plan {_median(ours, 'plan_cpu'):.1f} s, weigh {_median(ours, 'cpu'):.2f} s"
    bounds = np.array([row["bound"] for row in ours]) * [100, 1e3, 100]
    yield "bound of the motions, 10 s, 0.05 N·m, 100 Hz, medians: {:.2f} % {:.2f} mm {:.0f} % worst moment".format(
        *np.median(bounds, axis=0)
    )
    for noise in NOISES:
        yield from _targets([row for row in ours if row["noise"] == noise], noise)
    for noise in NOISES:
        yield f"\n{noise} N·m: all objects and ablations, median / p90: mass %, centre mm, worst moment %, even %"
        for way in ("ours", *ABLATIONS):
            yield _row(way, [row for row in good if row["noise"] == noise and row["way"] == way])
        for name, chosen in _parts():
            yield _row(f"ours, {name}", [row for row in ours if row["noise"] == noise and chosen(row)])


def _targets(rows: Sequence[Row], noise: float) -> Iterator[str]:
    low = noise == NOISES[0]
    heavy, half = [r for r in rows if r["kg"] >= 0.3], [r for r in rows if r["kg"] >= 0.5]
    yield f"\n{noise} N·m | measured | target"
    yield f"mass, ≥ 0.3 kg ({len(heavy)}) | {_pair(heavy, 'mass', 100)} % | ≤ 1 / 2 %"
    yield f"centre | {_pair(rows, 'centre', 1e3)} mm | {'≤ 2 / 4 mm' if low else '≤ 3 / 6 mm'}"
    yield f"worst moment, ≥ 0.5 kg ({len(half)}) | {_pair(half, 'moment', 100)} % | {'≤ 10 %' if low else '≤ 20 %'}"
    apart = [r for r in half if np.isfinite(r["axis"])]
    yield f"axes where moments differ by 30 % ({len(apart)}) | {_pair(apart, 'axis', 1)} ° | {'≤ 10°' if low else '–'}"
    for name, some in (("≥ 0.5 kg", half), ("all masses", rows)):
        off = [r for r in some if r["load"] != "none"]
        better = sum(r["moment"] < r["even"] for r in off)
        yield f"better than even density, off centre, {name} | {_share(better, len(off))} | ≥ 80 %"
        worse = max((r["moment"] - r["even"] for r in some), default=np.nan)
        count = sum(r["moment"] > r["even"] + WORSE for r in some)
        yield f"worse by more than 5 points, {name} | {count} of {len(some)}, by up to {100 * worse:.0f} points | none"
    held = np.array([r["held"] for r in rows])
    told = ", ".join(f"{name} {_share(int(held[:, k].sum()), len(held))}" for k, name in enumerate(PARAMETERS))
    yield f"95 % intervals that hold the truth | {told} | 88 to 99 %"
    both = np.array([r["moments_held"] for r in rows])
    yield f"… of principal moments | {_share(int(both.sum()), both.size)} | 88 to 99 %"


def _parts() -> Iterator[tuple[str, Callable[[Row], bool]]]:
    yield from ((f"load {name}", lambda r, name=name: r["load"] == name) for name in ("none", "lump", "fill"))
    for low, high in ((0.1, 0.3), (0.3, 0.5), (0.5, 1.0), (1.0, 1.6)):
        yield f"{low} to {high} kg", lambda r, low=low, high=high: low <= r["kg"] < high


def _row(name: str, rows: Sequence[Row]) -> str:
    if not rows:
        return f"  {name:28} none"
    scales = {"mass": 100, "centre": 1e3, "moment": 100, "even": 100}
    return f"  {name:28} {len(rows):3} | " + " | ".join(_pair(rows, key, scale) for key, scale in scales.items())


def _median(rows: Sequence[Row], key: str) -> float:
    return float(np.median([row[key] for row in rows]))


def _pair(rows: Sequence[Row], key: str, scale: float) -> str:
    if not rows:
        return "–"
    values = scale * np.array([row[key] for row in rows])
    return f"{np.median(values):.2f} / {np.quantile(values, 0.9):.2f}"


def _share(count: int, of: int) -> str:
    if not of:
        return "–"
    low, high = binomtest(count, of).proportion_ci(method="wilson")
    return f"{100 * count / of:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"
