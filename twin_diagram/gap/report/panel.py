"""Axes of a picture as SVG: frame, grid, numbers, words, lines; sharp at any size, and drawn in a millisecond."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

import numpy as np
import numpy.typing as npt

from twin_diagram.gap.report.dots import cloud
from twin_diagram.signals.arrays import Array

INK = "#253040"
"""Of words and marks: near the page's `--ink`."""

GRID = "#e4e8ee"
"""Of lines that must not compete with the data."""

FRAME = "#b9c1cc"
"""Of the two axes."""

ACROSS = 64.0
"""Between two numbers below the axes, at least [px of the drawing]."""

UP = 26.0
"""The same beside them [px]."""

STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
"""Of round numbers, within a power of ten."""

SIZE = 11.5
"""Of letters [px]."""

LETTER = 6.9
"""Width of a digit of that size in the widest font that browsers take, DejaVu Sans [px]."""

FINE = 0.5
"""Two samples of a line are drawn within so much of the axis: the lowest and the highest [px]."""


@dataclass(frozen=True)
class Panel:
    """One pair of axes.

    Attributes:
        left, top: corner of the frame [px of the drawing].
        width, height: of the frame [px].
        x, y: what the frame spans, lowest and highest.
    """

    left: float
    top: float
    width: float
    height: float
    x: tuple[float, float]
    y: tuple[float, float]

    def across(self, x: Array | float) -> Array:
        """Return where values are, from the frame's left [px]."""
        return np.asarray((np.asarray(x) - self.x[0]) * (self.width / (self.x[1] - self.x[0])))

    def down(self, y: Array | float) -> Array:
        """Return where values are, from the frame's top [px]."""
        return np.asarray((self.y[1] - np.asarray(y)) * (self.height / (self.y[1] - self.y[0])))

    def drawn(self, inside: str, below: str, beside: str) -> str:
        """Return the axes with their numbers and words about what is inside; what leaves the frame is cut off."""
        wide, high = self.width, self.height
        lines, text = [], []
        for value, word in labelled(self.x, wide / ACROSS):
            at = f"{float(self.across(value)):.1f}"
            lines.append(f"M{at} 0V{high:g}")
            text.append(f'<text x="{at}" y="{high + 16:g}" text-anchor="middle">{word}</text>')
        for value, word in labelled(self.y, high / UP):
            low = float(self.down(value))
            lines.append(f"M0 {low:.1f}H{wide:g}")
            text.append(f'<text x="-7" y="{low + 4:.1f}" text-anchor="end">{word}</text>')
        text.append(f'<text x="{0.5 * wide:g}" y="{high + 34:g}" text-anchor="middle">{escape(below)}</text>')
        if beside:
            aside = -16.0 - LETTER * max((len(word) for _, word in labelled(self.y, high / UP)), default=1)
            turned = f"translate({aside:.1f} {0.5 * high:g}) rotate(-90)"
            text.append(f'<text transform="{turned}" text-anchor="middle">{escape(beside)}</text>')
        return (
            f'<g transform="translate({self.left:g} {self.top:g})"><path d="{"".join(lines)}" stroke="{GRID}"/>'
            f'<svg width="{wide:g}" height="{high:g}" overflow="hidden">{inside}</svg>'
            f'<path d="M0 0V{high:g}H{wide:g}" fill="none" stroke="{FRAME}"/>{"".join(text)}</g>'
        )

    def band(self, half: float, colour: str) -> str:
        """Return what lies within `half` of zero, filled."""
        high, low = float(self.down(half)), float(self.down(-half))
        return (
            f'<rect y="{high:.2f}" width="{self.width:g}" height="{max(low - high, 0.0):.2f}" '
            f'fill="{colour}" fill-opacity="0.18"/>'
        )

    def line(self, x: Array, y: Array, colour: str, thick: float) -> str:
        """Return a line through (M,), (M,), as fine as can be seen; x rises."""
        kept = telling(self.across(x), y)
        points = zip(self.across(x[kept]), self.down(y[kept]), strict=True)
        path = "L".join(f"{a:.1f} {b:.1f}" for a, b in points)
        return (
            f'<path d="M{path}" fill="none" stroke="{colour}" stroke-width="{thick:g}" stroke-linejoin="round" '
            'stroke-linecap="round"/>'
        )

    def dots(self, x: Array, y: Array, colour: str) -> str:
        """Return a cloud."""
        return cloud(self.across(x), self.down(y), self.width, self.height, colour)

    def mark(self, x: float, word: str) -> str:
        """Return a dashed line at a value with a word beside it, on the side where there is room."""
        at = float(self.across(x))
        late = at + LETTER * (len(word) + 2) > self.width
        return (
            f'<path d="M{at:.1f} 0V{self.height:g}" stroke="{INK}" stroke-dasharray="5 3"/>'
            f'<text x="{at + (-6 if late else 6):.1f}" y="14" text-anchor="{"end" if late else "start"}">'
            f"{escape(word)}</text>"
        )


def labelled(span: tuple[float, float], most: float) -> list[tuple[float, str]]:
    """Return round numbers within a span, and how they are written: at most so many, and one more."""
    low, high = span
    step = rounded_up((high - low) / max(most, 1.0))
    values = step * np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1.0) + 0.0
    size = max(abs(low), abs(high))
    if 1e-4 <= step and size < 1e5:
        decimals = next(d for d in range(7) if abs(round(step, d) - step) < 1e-9 * step)
        words = [f"{value:.{decimals}f}" for value in values]
    else:  # all with one power of ten
        power = int(np.floor(np.log10(size)))
        scaled = values / 10.0**power
        decimals = next((d for d in range(7) if abs(round(step / 10.0**power, d) - step / 10.0**power) < 1e-9), 7)
        words = [
            "0" if value == 0.0 else f"{one:.{decimals}f}e{power}" for value, one in zip(values, scaled, strict=True)
        ]
    return [(float(value), word.replace("-", "−")) for value, word in zip(values, words, strict=True)]


def rounded_up(step: float) -> float:
    """Return the next round number."""
    power = 10.0 ** np.floor(np.log10(step))
    return float(next(k * power for k in STEPS if k * power >= step * (1.0 - 1e-9)))


def telling(across: Array, y: Array, fine: float = FINE) -> npt.NDArray[np.int64]:
    """Return the indices of the lowest and the highest of (M,) within each step of a line; all, where they are few."""
    count = max(1, int(np.ceil((across[-1] - across[0]) / fine)))
    if len(y) <= 2 * count:
        return np.arange(len(y))
    owner = np.minimum(((across - across[0]) / fine).astype(int), count - 1)
    order = np.lexsort((y, owner))
    first = np.flatnonzero(np.diff(owner[order], prepend=-1))
    return np.unique(np.concatenate([order[first], order[np.append(first[1:], len(y)) - 1]]))
