"""All results in one table, with bounds and targets."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import beta

Record = dict[str, Any]


@dataclass(frozen=True)
class Row:
    """One figure: what it is, what it came to, its 95 % bounds, what was asked, and whether that is met."""

    figure: str
    value: str
    bounds: str
    target: str
    met: bool | None

    def text(self) -> str:
        """A line."""
        mark = {True: "met", False: "MISSED", None: ""}[self.met]
        return f"{self.figure:<58} {self.value:>20} {self.bounds:>20}  {self.target:<16} {mark}"


def proportion(hits: int, count: int) -> tuple[float, float]:
    """Bounds of 95 % (Clopper and Pearson 1934); where none or all hit, one-sided."""
    if count == 0:
        return 0.0, 1.0
    tail = 0.05 if hits in (0, count) else 0.025
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, count - hits + 1))
    high = 1.0 if hits == count else float(beta.ppf(1.0 - tail, hits + 1, count - hits))
    return low, high


def share(figure: str, outcomes: Iterable[bool], target: str, met: Callable[[float], bool] | None) -> Row:
    """Of yes and no."""
    outcomes = list(outcomes)
    if not outcomes:
        return Row(figure, "–", "", target, None)
    hits, count = sum(outcomes), len(outcomes)
    low, high = proportion(hits, count)
    verdict = None if met is None else met(hits / count)
    return Row(
        figure, f"{hits}/{count} = {100 * hits / count:.1f} %", f"{100 * low:.1f}–{100 * high:.1f} %", target, verdict
    )


def quantiles(figure: str, values: Iterable[float], unit: str, scale: float, targets: tuple[float, ...]) -> Row:
    """Median and 95th percentile against two targets, one, or none."""
    array = scale * np.array(list(values), dtype=float)
    wanted = " / ".join(f"{t:g}" for t in targets)
    target = f"≤ {wanted} {unit}" if targets else "printed"
    if not len(array):
        return Row(figure, "–", "", target, None)
    found = np.quantile(array, [0.5, 0.95])
    met = all(x <= t for x, t in zip(found, targets, strict=False)) if targets else None
    return Row(figure, f"{found[0]:.3g} / {found[1]:.3g} {unit}", f"n = {len(array)}", target, met)


PLAIN = 30.0
"""Strength, in noise units, from which on an effect shows soon after it began."""


def rows(records: list[Record]) -> list[Row]:
    """The issue's targets."""
    ran = [r for r in records if "error" not in r]
    named = [r for r in ran if r["kind"] not in ("clean", "outside")]
    alone = [r for r in named if r["kind"] in ("single", "several", "onset", "dirty")]
    clean = [r for r in ran if r["kind"] == "clean"]
    outside = [r for r in ran if r["kind"] == "outside"]
    pairs = [r for r in named if r["kind"] == "pair" and r["separation"] >= 8.0]
    triples = [r for r in named if r["kind"] == "triple" and r["separation"] >= 8.0]
    far = [p for r in named for p in r["parameters"] if p["separation"] >= 20.0]
    close = [r for r in named if r["separation"] < 4.0]
    claims = [c for r in ran for c in r["claims"]]
    onsets = [e for r in named for e in r["onset_errors"]]
    # Until it has shown in the noise, nothing tells when a weak effect began.
    plain = [e for r in named if min(p["strength"] for p in r["parts"]) >= PLAIN for e in r["onset_errors"]]
    possible = [
        errors or []
        for r in named
        for found, errors in zip(r["onset_errors"], r.get("oracle_onset_errors", []), strict=False)
        if found is not None
    ]
    repaired = [
        r["held_out"]["left"] for r in named if r["verdict"] == "named" and r["held_out"] and r["held_out"]["visible"]
    ]
    result = [
        share(
            "name + joint exactly right, separation ≥ 8",
            (r["exact"] for r in alone if r["separation"] >= 8.0),
            "≥ 98 %",
            lambda x: x >= 0.98,
        ),
        share(
            "… 6 to 8",
            (r["exact"] for r in alone if 6.0 <= r["separation"] < 8.0),
            "≥ 93 %",
            lambda x: x >= 0.93,
        ),
        share("… 4 to 6", (r["exact"] for r in alone if 4.0 <= r["separation"] < 6.0), "printed", None),
        share(
            "wrong name with confidence ≥ 0.9, separation below 4",
            (any(not c["right"] and c["confidence"] >= 0.9 for c in r["claims"]) for r in close),
            "≤ 2 %",
            lambda x: x <= 0.02,
        ),
        share(
            "truth among name + its ≤ 3 alternatives, separation ≥ 4",
            (a for r in named if r["separation"] >= 4.0 for a in r["among"]),
            "≥ 97 %",
            lambda x: x >= 0.97,
        ),
        share(
            "… of all cases in which something was named",
            (a for r in named if r["verdict"] == "named" for a in r["among"]),
            "printed",
            None,
        ),
        Row(
            "Brier score of the confidences",
            f"{np.mean([(c['confidence'] - c['right']) ** 2 for c in claims]):.4f}" if claims else "–",
            f"n = {len(claims)}",
            "printed",
            None,
        ),
        share("false names on clean logs", (bool(r["claims"]) for r in clean), "0 in 600", lambda x: x == 0.0),
        share("… anything but `none`", (r["verdict"] != "none" for r in clean), "printed", None),
        share(
            "outside the catalogue: `unknown`, or `remainder`",
            (r["abstains"] for r in outside),
            "≥ 85 %",
            lambda x: x >= 0.85,
        ),
        share(
            "… those at least 8 from any explanation",
            (r["abstains"] for r in outside if r["separation"] >= 8.0),
            "printed",
            None,
        ),
        share("pairs exactly right, both ≥ 8", (r["exact"] for r in pairs), "≥ 90 %", lambda x: x >= 0.9),
        share("triples exactly right, all ≥ 8", (r["exact"] for r in triples), "printed", None),
        share(
            "arms that pick and rest (suite `resting`) exactly right, ≥ 8",
            (r["exact"] for r in ran if r["kind"] == "resting" and r["separation"] >= 8.0),
            "≥ 95 %",
            lambda x: x >= 0.95,
        ),
        quantiles("onset error, median / p95", (abs(e) for e in onsets if e is not None), "ms", 1e3, (50.0, 200.0)),
        quantiles(f"… of effects of strength ≥ {PLAIN:g}", (abs(e) for e in plain if e is not None), "ms", 1e3, ()),
        quantiles(
            "… of an estimator that knows all but the onset",
            itertools.chain.from_iterable(possible),
            "ms",
            1e3,
            (),
        ),
        share("… onsets not reported", (e is None for e in onsets), "printed", None),
        quantiles("parameter error, separation ≥ 20, median / p95", (p["error"] for p in far), "%", 100.0, (3.0,)),
        share("… 95 % intervals cover", (abs(p["z"]) <= 1.96 for p in far), "92–98 %", lambda x: 0.92 <= x <= 0.98),
        quantiles(
            "held-out gap left over, median / p95", (x for x in repaired if x is not None), "%", 100.0, (10.0, 25.0)
        ),
        quantiles("processor time of `gap`, median / p95", (r["processor"] for r in ran), "s", 1.0, (60.0, 60.0)),
        quantiles("… by the clock", (r["seconds"] for r in ran), "s", 1.0, ()),
    ]
    errors = [r for r in records if "error" in r]
    result.append(share("results that break the contract", (bool(r["faults"]) for r in ran), "0", lambda x: x == 0.0))
    result.append(Row("runs that failed", str(len(errors)), f"of {len(records)}", "0", not errors))
    return result


def histogram(records: list[Record]) -> str:
    """How far the cases were from their nearest other explanation, and how many of each were right."""
    edges = [0.0, 2.0, 4.0, 6.0, 8.0, 12.0, 20.0, 50.0, 100.0, np.inf]
    scored = [r for r in records if "error" not in r and r["kind"] not in ("clean", "outside")]
    lines = ["separation        cases  right"]
    for low, high in itertools.pairwise(edges):
        inside = [r for r in scored if low <= r["separation"] < high]
        bar = "█" * round(50 * len(inside) / max(1, len(scored)))
        lines.append(f"{low:5g} to {high:5g}  {len(inside):7d} {sum(r['exact'] for r in inside):6d}  {bar}")
    return "\n".join(lines)


def name_rows(records: list[Record], least: float = 8.0) -> list[tuple[str, int, int, int, str]]:
    """Per true name: cases, those far enough, how many of these were right, and what else was said."""
    result = []
    names = sorted(
        {"+".join(r["truth_names"]) if len(r["truth_names"]) == 1 else r["kind"] for r in records if "error" not in r}
    )
    for name in names:
        own = [
            r
            for r in records
            if "error" not in r and (r["truth_names"] == [name] or (len(r["truth_names"]) != 1 and r["kind"] == name))
        ]
        far = [r for r in own if r["kind"] == "clean" or r["separation"] >= least]
        wrong: dict[str, int] = {}
        for r in far:
            if not r["exact"]:
                said = "+".join(sorted(c["name"] for c in r["claims"])) or r["verdict"]
                wrong[said] = wrong.get(said, 0) + 1
        instead = ", ".join(f"{count} {said}" for said, count in sorted(wrong.items(), key=lambda x: -x[1])[:4])
        result.append((name, len(own), len(far), sum(r["exact"] for r in far), instead))
    return result


def by_name(records: list[Record], least: float = 8.0) -> str:
    """The same as text."""
    lines = [f"{'name':<28} cases  ≥ {least:g}  right  instead"]
    for name, count, far, right, instead in name_rows(records, least):
        lines.append(f"{name:<28} {count:5d} {far:5d} {right:6d}  {instead}")
    return "\n".join(lines)


def sizes(records: list[Record]) -> str:
    """Typical separations per name, and what its cases were mostly nearest to."""
    lines = [f"{'name':<28} cases  strength: median   separation: 10 %   median     90 %   ≥ 8   nearest"]
    for name in sorted({r["name"] for r in records}):
        own = [r for r in records if r["name"] == name]
        low, middle, high = np.quantile([r["separation"] for r in own], [0.1, 0.5, 0.9])
        strength = np.median([r["strength"] for r in own])
        far = np.mean([r["separation"] >= 8.0 for r in own])
        near = [r["nearest"] or "nothing" for r in own]
        first = ", ".join(f"{near.count(n)} {n}" for n in sorted(set(near), key=near.count, reverse=True)[:3])
        figures = f"{len(own):5d} {strength:17.1f} {low:18.1f} {middle:8.1f} {high:8.1f}  {100 * far:3.0f} %"
        lines.append(f"{name:<28} {figures}  {first}")
    return "\n".join(lines)


def ablation_rows(records: list[Record], results: list[Record]) -> tuple[list[str], list[list[str]]]:
    """Methods side by side, on the cases that each has run: the table's head and its lines."""
    head = ["method", "cases", "exact, separation ≥ 8", "false names per case", "false on clean", "gap left, median"]
    head.append("processor time, median")
    ran = [
        {**r, "method": "twin-diagram", "left": r["held_out"]["left"], "visible": r["held_out"]["visible"]}
        for r in results
        if "error" not in r
    ]
    lines = []
    for method in ["twin-diagram", *sorted({r["method"] for r in records})]:
        own = [r for r in [*ran, *records] if r["method"] == method]
        if not own:
            continue
        far = [r for r in own if r["kind"] not in ("clean", "outside") and r["separation"] >= 8.0]
        clean = [r for r in own if r["kind"] == "clean"]
        wrong = sum(not c["right"] for r in own for c in r["claims"]) / len(own)
        left = [r["left"] for r in own if r["visible"] and r["kind"] not in ("clean", "outside")]
        gap = f"{100 * np.median(left):.0f} %" if left else "–"
        lines.append(
            [
                method,
                str(len(own)),
                f"{sum(r['exact'] for r in far)}/{len(far)}",
                f"{wrong:.1f}",
                f"{sum(bool(r['claims']) for r in clean)}/{len(clean)}",
                gap,
                f"{np.median([r['processor'] for r in own]):.1f} s",
            ]
        )
    return head, lines


def ablations(records: list[Record], results: list[Record]) -> str:
    """The same as text."""
    head, lines = ablation_rows(records, results)
    widths = [max(len(line[k]) for line in [head, *lines]) for k in range(len(head))]
    return "\n".join(
        "  ".join(
            word.ljust(wide) if k == 0 else word.rjust(wide)
            for k, (word, wide) in enumerate(zip(line, widths, strict=True))
        )
        for line in [head, *lines]
    )


def report(records: list[Record]) -> str:
    """Everything, as text."""
    versions = sorted({f"{r['version']} ({r['code']})" for r in records})
    head = f"{len(records)} cases, version {', '.join(versions)}"
    table = "\n".join(row.text() for row in rows(records))
    return "\n\n".join([head, table, histogram(records), by_name(records)])


def calibration(records: list[Record]) -> list[tuple[float, float, int]]:
    """(mean confidence, share right, count) in bins of the confidence."""
    claims = [c for r in records if "error" not in r for c in r["claims"]]
    result = []
    edges = [0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0 + 1e-9]
    for low, high in itertools.pairwise(edges):
        inside = [c for c in claims if low <= c["confidence"] < high]
        if inside:
            mean = float(np.mean([c["confidence"] for c in inside]))
            result.append((mean, float(np.mean([c["right"] for c in inside])), len(inside)))
    return result
