"""The figures of all arms that were run, beside their targets, with Wilson's 95 % intervals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
from braking_bench.counting import wilson

CLEAR = 8.0
"""Separation from which on what is unusual can be told."""


def text(results: list[dict[str, Any]]) -> str:
    """One line per figure."""
    fine = [r for r in results if "error" not in r]
    real = [r for r in fine if not r["as_described"]]
    clear = [r for r in real if r["unusual"] and r["separation"] >= CLEAR]
    in_white = [r for r in real if r["unusual"] and r.get("separation_white", 0.0) >= CLEAR]
    curves = [row for r in real for row in joints_of(r["friction"])]
    loads = [r["payload"] for r in real if r["payload"] and r["payload"][2] > 0.0]
    later = [r["loaded"] for r in fine if "loaded" in r]
    sure = [ok for r in fine for _, confidence, ok in r["confidences"] if confidence >= 0.9]
    lines = [
        f"{len(results)} arms, {len(results) - len(fine)} without an answer",
        share("friction's curve, joints", [ok for ok, _ in curves], ">= 95 %"),
        share("  within two standard errors", [in_two for _, in_two in curves], "90 to 98 %"),
        share(
            "inertia about the axis within 10 %, joints", [near(pair) for r in real for pair in r["rotors"]], ">= 95 %"
        ),
        share(f"unusual named, separation >= {CLEAR:g}", [r["found"] for r in clear], ">= 95 %"),
        share("  of white noise and fewer usual things", [r["found"] for r in in_white], ""),
        share("unusual named that is not there, arms", [bool(r["false"]) for r in fine], "<= 2 %"),
        share("as described: none", [r["verdict"] == "none" for r in fine if r["as_described"]], ">= 98 %"),
        share("unknown, of those that lack something", [r["verdict"] == "unknown" for r in real], "0 %"),
        share("second run on its own model: none", [r["second"] == "none" for r in fine if "second" in r], ">= 98 %"),
        share("later run of other motion: none", [r["later"] == "none" for r in fine if "later" in r], ">= 95 %"),
        share(
            "payload, model of an unloaded log: within 3 %", [abs(x[1] - x[0]) <= 0.03 * x[0] for x in later], ">= 90 %"
        ),
        share(
            "payload, the description: interval of 95 % covers",
            [abs(s - t) <= 1.96 * e for t, s, e in loads],
            "90 to 98 %",
        ),
        share("names with confidence >= .9 right", sure, ">= 90 %"),
        *spread("held-out residual over told, median / p95", [r["held_out"]["over_told"] for r in real], "1.05 / 1.3"),
        *spread("processor seconds, median / p95", [r["processor"] for r in fine], "15 / 45"),
    ]
    for n in sorted({len(r["rotors"]) for r in real}):
        own = [r["processor"] for r in real if len(r["rotors"]) == n]
        lines += spread(f"  of {n} joints ({len(own)} arms)", own, "")
    missed = Counter(r["unusual"][0] for r in clear if not r["found"])
    wrong = Counter(name for r in fine for name in r["false"])
    errors = Counter(r["error"].split(":")[0] for r in results if "error" in r)
    for what, counted in (("missed", missed), ("named and not there", wrong), ("no answer", errors)):
        lines.append(f"{what}: {', '.join(f'{name} {count}' for name, count in counted.most_common()) or '–'}")
    return "\n".join(lines)


def near(pair: list[float]) -> bool:
    """Whether what is said is within a tenth of what is true."""
    true, said = pair
    return abs(said - true) <= 0.1 * true


def joints_of(rows: list[dict[str, float]]) -> Iterable[tuple[bool, bool]]:
    """Per joint: whether friction is right at all speeds, and whether it is within two standard errors."""
    for j in {row["joint"] for row in rows}:
        mine = [row for row in rows if row["joint"] == j]
        close = [abs(r["said"] - r["true"]) <= 0.1 * abs(r["true"]) for r in mine]
        two = [abs(r["said"] - r["true"]) <= 2.0 * r["std"] for r in mine]
        known = [r["std"] <= 0.15 * abs(r["true"]) for r in mine]
        yield all(a or (b and c) for a, b, c in zip(close, two, known, strict=True)), all(two)


def share(what: str, cases: Iterable[bool], target: str) -> str:
    """A share with Wilson's interval."""
    some = list(cases)
    if not some:
        return f"{what:<52}     –"
    low, high = wilson(sum(some), len(some))
    counted = f"({sum(some)}/{len(some)}; {100 * low:.0f} to {100 * high:.0f} %)"
    return f"{what:<52}{100 * np.mean(some):6.1f} % {counted:<28}{target}"


def spread(what: str, values: list[float], target: str) -> list[str]:
    """Median and 95th percentile; nothing where there is none."""
    if not values:
        return []
    return [f"{what:<52}{np.median(values):6.2f} / {np.percentile(values, 95):<20.2f}{target}"]
