"""Pictures of the residual torque over time, speed, angle and acceleration, before and after: PNG within the page.

Where a joint is prismatic, its force over its position.
"""

from __future__ import annotations

import base64
import io
from html import escape

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from twin_diagram.gap.findings import Moment
from twin_diagram.gap.report.comparison import Comparison
from twin_diagram.signals import units
from twin_diagram.signals.arrays import Array

BEFORE = "#d9772b"
"""Of the given model's residual: the page's `--before`."""

AFTER = "#2463a6"
"""Of the corrected model's: the page's `--after`."""

NOISE = "#8a94a3"
"""Of the band that noise fills, as the page's marks of it."""

INK = "#253040"
"""Of words and marks: near the page's `--ink`."""

GRID = "#e4e8ee"
"""Of lines that must not compete with the data."""

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
    """Return one joint of one run as an `<img>`.

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
    figure = Figure(figsize=(10.6, 4.9), facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 3, height_ratios=(1.0, 1.1))
    reach = 1.08 * max(float(np.quantile(np.abs(run.before[:, j]), 0.999)), 3.0 * noise, 1e-12)
    over_time = figure.add_subplot(grid[0, :])
    _dress(over_time, "time [s]", left)
    _noise(over_time, noise)
    _draw_over_time(over_time, run, j, changed)
    _mark(over_time, onset, "starts")
    _mark(over_time, end, "ends")
    over_time.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=3,
        fontsize=8,
        frameon=False,
        borderpad=0.1,
        handlelength=1.4,
    )
    over_time.set_ylim(-reach, reach)
    below = (
        (f"velocity [{units.on_joint(units.SPEED, prismatic)}]", run.velocity[:, j]),
        (f"{place} [{units.on_joint(units.ANGLE, prismatic)}]", run.position[:, j]),
        (f"acceleration [{units.on_joint(units.ACCELERATION, prismatic)}]", run.acceleration[:, j]),
    )
    for column, (what, values) in enumerate(below):
        axes = figure.add_subplot(grid[1, column])
        _dress(axes, what, left if column == 0 else "")
        _noise(axes, noise)
        _cloud(axes, values, run.before[:, j], BEFORE)
        if changed:
            _cloud(axes, values, run.after[:, j], AFTER)
        low, high = np.quantile(values, [0.002, 0.998])
        margin = 0.03 * max(float(high - low), 1e-9)
        axes.set_xlim(low - margin, high + margin)
        axes.set_ylim(-reach, reach)
    return image(figure, f"residual {effort} of {run.joints[j]}")


def _draw_over_time(axes: Axes, run: Comparison, j: int, changed: bool) -> None:
    axes.plot(run.time, run.before[:, j], color=BEFORE, lw=0.9, label="given model")
    if changed:
        axes.plot(run.time, run.after[:, j], color=AFTER, lw=0.9, label="corrected model")
    axes.set_xlim(run.time[0], run.time[-1])


def _mark(axes: Axes, when: Moment | None, word: str) -> None:
    """Draw a line where an effect starts or ends, if it does."""
    if when is not None:
        axes.axvline(when.time, color=INK, lw=1.0, ls="--")
        axes.annotate(
            f" {word}", (when.time, 0.97), xycoords=("data", "axes fraction"), va="top", fontsize=8, color=INK
        )


def image(figure: Figure, words: str, dpi: int = 150) -> str:
    """Return a figure as an `<img>` that carries its own data."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<img alt="{escape(words)}" src="data:image/png;base64,{data}"/>'


def _dress(axes: Axes, below: str, beside: str) -> None:
    axes.set_xlabel(below, fontsize=8.5, color=INK)
    axes.set_ylabel(beside, fontsize=8.5, color=INK)
    axes.tick_params(labelsize=8, colors=INK, length=2.5)
    axes.grid(color=GRID, lw=0.7)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#b9c1cc")


def _noise(axes: Axes, noise: float) -> None:
    axes.axhspan(-2.0 * noise, 2.0 * noise, color=NOISE, alpha=0.16, lw=0, label="noise (± 2 σ)")


def _cloud(axes: Axes, x: Array, y: Array, colour: str) -> None:
    """Draw dots, and the line through their middle."""
    every = max(1, len(x) // POINTS)
    axes.plot(x[::every], y[::every], ".", ms=2.0, mew=0, alpha=0.28, color=colour, rasterized=True)
    centres, middles = binned(x, y)
    axes.plot(centres, middles, color="white", lw=3.2, solid_capstyle="round")
    axes.plot(centres, middles, color=colour, lw=1.7, solid_capstyle="round")


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
