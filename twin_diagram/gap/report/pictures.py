"""Pictures of the residual torque over time, speed, angle and acceleration, before and after: SVG within the page.

Where a joint is prismatic, its force over its position.
"""

from __future__ import annotations

from html import escape

import numpy as np

from twin_diagram.gap.findings import Moment
from twin_diagram.gap.report.comparison import Comparison
from twin_diagram.gap.report.panel import INK, LETTER, SIZE, UP, Panel, labelled
from twin_diagram.signals import units
from twin_diagram.signals.arrays import Array

WIDTH, HEIGHT = 1060.0, 490.0
"""Of a whole picture [px]; the page scales it, and is about as wide."""

TOP, HIGH = (24.0, 252.0), (178.0, 196.0)
"""Where the upper and the lower frames begin, and how high they are [px]."""

LINE = 10.0
"""Less of it left of the lower frames but the first, which have numbers and no words there [px]."""

SIDE = 30.0
"""Left of a frame, beside its numbers: a line of words, and two gaps [px]."""

RIGHT = 6.0
"""Right of the frames [px]."""

GAP = 22.0
"""Between two words of the legend [px]."""

STILL = 1e-3
"""Share of where a joint is that a frame spans at least: closer numbers would not differ in what is written."""

THIN = 1.2
"""Of lines over time [px]."""

BEFORE = "#d9772b"
"""Of the given model's residual: the page's `--before`."""

AFTER = "#2463a6"
"""Of the corrected model's: the page's `--after`."""

NOISE = "#8a94a3"
"""Of the band that noise fills, as the page's marks of it."""

POINTS = 2500
"""Dots per picture."""

BINS = 32
"""Of the line through a cloud: fine enough for friction's step at rest, with samples enough in each."""

QUARTILES = (0.25, 0.75)
"""Whose mean is a cloud's middle; see `binned`."""

FEWEST = 6
"""Samples that make a bin worth a line."""


def residual_pictures(
    run: Comparison,
    j: int,
    noise: float,
    changed: bool,
    onset: Moment | None = None,
    end: Moment | None = None,
    prismatic: bool = False,
) -> str:
    """Return one joint of one run as an `<svg>`.

    Args:
        run: to look at.
        j: column.
        noise: floor of the residual torque [N·m].
        changed: whether the corrected model differs from the given one.
        onset: marked where it is in this run.
        end: likewise.
        prismatic: whether the joint is prismatic, for the axes' names and units.
    """
    effort, place = ("force", "position") if prismatic else ("torque", "angle")
    left = f"measured − model [{units.on_joint(units.TORQUE, prismatic)}]"
    reach = 1.08 * max(float(np.quantile(np.abs(run.before[:, j]), 0.999)), 3.0 * noise, 1e-12)
    span = (-reach, reach)
    margin = SIDE + LETTER * max(len(word) for _, word in labelled(span, HIGH[0] / UP))
    parts = [_legend(changed), _over_time(run, j, noise, changed, span, margin, left, onset, end)]
    below = (
        (f"velocity [{units.on_joint(units.SPEED, prismatic)}]", run.velocity[:, j]),
        (f"{place} [{units.on_joint(units.ANGLE, prismatic)}]", run.position[:, j]),
        (f"acceleration [{units.on_joint(units.ACCELERATION, prismatic)}]", run.acceleration[:, j]),
    )
    step = (WIDTH - margin - RIGHT - 2 * (margin - LINE)) / 3
    for column, (what, values) in enumerate(below):
        low, high = np.quantile(values, [0.002, 0.998])
        more = 0.03 * max(float(high - low), STILL * float(np.max(np.abs([low, high]))), 1e-9)
        corner = margin + column * (step + margin - LINE)
        panel = Panel(corner, TOP[1], step, HIGH[1], (float(low - more), float(high + more)), span)
        inside = panel.band(2.0 * noise, NOISE) + _cloud(panel, values, run.before[:, j], BEFORE)
        if changed:
            inside += _cloud(panel, values, run.after[:, j], AFTER)
        parts.append(panel.drawn(inside, what, left if column == 0 else ""))
    return picture("".join(parts), f"residual {effort} of {run.joints[j]}")


def picture(inside: str, words: str) -> str:
    """Return a drawing of the pictures' size, and what it is for those who do not see it."""
    return (
        f'<svg class="residual" viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img" aria-label="{escape(words)}" '
        f'font-size="{SIZE:g}" fill="{INK}">{inside}</svg>'
    )


def _over_time(
    run: Comparison,
    j: int,
    noise: float,
    changed: bool,
    span: tuple[float, float],
    margin: float,
    left: str,
    onset: Moment | None,
    end: Moment | None,
) -> str:
    """Return the residual over time, with where an effect starts or ends, if it does."""
    time = (float(run.time[0]), float(run.time[-1]))
    panel = Panel(margin, TOP[0], WIDTH - margin - RIGHT, HIGH[0], time, span)
    inside = panel.band(2.0 * noise, NOISE) + panel.line(run.time, run.before[:, j], BEFORE, THIN)
    if changed:
        inside += panel.line(run.time, run.after[:, j], AFTER, THIN)
    for when, word in ((onset, "starts"), (end, "ends")):
        inside += "" if when is None else panel.mark(when.time, word)
    return panel.drawn(inside, "time [s]", left)


def _legend(changed: bool) -> str:
    """Return what the colours are, above the frames' right."""
    entries = [("noise (± 2 σ)", NOISE), ("given model", BEFORE)] + [("corrected model", AFTER)] * changed
    at, parts = WIDTH - RIGHT, []
    for words, colour in reversed(entries):
        at -= LETTER * len(words)
        shape = f'<path d="M{at - 24:.1f} 11h16" stroke="{colour}" stroke-width="1.6"/>'
        if colour == NOISE:
            shape = f'<rect x="{at - 24:.1f}" y="6" width="16" height="9" fill="{colour}" fill-opacity="0.18"/>'
        parts.append(f'{shape}<text x="{at:.1f}" y="15">{words}</text>')
        at -= 24.0 + GAP
    return "".join(parts)


def _cloud(panel: Panel, x: Array, y: Array, colour: str) -> str:
    """Return dots, and the line through their middle."""
    every = max(1, len(x) // POINTS)
    centres, middles = binned(x, y)
    return (
        panel.dots(x[::every], y[::every], colour)
        + panel.line(centres, middles, "white", 4.4)
        + panel.line(centres, middles, colour, 2.4)
    )


def binned(x: Array, y: Array, bins: int = BINS) -> tuple[Array, Array]:
    """Return the middles of y (M,) over equal steps of x (M,), where there are samples enough.

    The middle is that of the quartiles: where a cloud has two branches, a median jumps from one to the other.
    """
    low, high = np.quantile(x, [0.002, 0.998])
    if not high > low:
        return np.array([low]), np.array([np.mean(np.quantile(y, QUARTILES))])
    edges = np.linspace(low, high, bins + 1)
    owner = np.digitize(x, edges) - 1
    centres, middles = [], []
    for k in range(bins):
        inside = y[owner == k]
        if len(inside) >= FEWEST:
            centres.append(0.5 * (edges[k] + edges[k + 1]))
            middles.append(float(np.mean(np.quantile(inside, QUARTILES))))
    return np.array(centres), np.array(middles)
