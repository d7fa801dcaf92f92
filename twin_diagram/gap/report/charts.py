"""Drawings of the report that are made of rectangles and lines: inline SVG, sharp at any size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from twin_diagram.gap.report.numbers import number
from twin_diagram.signals.arrays import Array

ROW = 46
"""Height of one joint's two bars and the gap below them [px of the drawing]."""

LABEL = 164
"""Left of the bars: a joint's name, `LETTERS` of it at the most [px]."""

LETTERS = 19
"""Of a name, as of `shoulder_lift_joint`."""

LETTER = 7.2
"""Width of one in the widest font that browsers take, DejaVu Sans [px]."""

VALUE = 130
"""Right of the bars: a value and its unit [px]."""

WIDTH = 560
"""Of the whole drawing [px]; the page scales it."""

BAR = 13
"""Height of one bar [px]: that of its text."""


def bars(
    joints: Sequence[str],
    before: Array,
    after: Array,
    noise: Array | None,
    unit: str | Sequence[str],
    changed: bool = True,
    most: float | Array = np.inf,
) -> str:
    """Return two bars per joint, before and after, with the noise floor as a mark.

    Each joint has its own scale: a shoulder's torque would hide a wrist's. Bars that have nothing beside them to be
    held against share one with those of their unit.

    Args:
        joints: names of the n rows.
        before: (n,).
        after: (n,).
        noise: (n,) or None.
        unit: of all, or of each.
        changed: whether there is an after that differs; if not, one bar is drawn.
        most: values beyond it are said to be, and no more; of all, or of each.
    """
    units = np.array([unit] * len(joints) if isinstance(unit, str) else unit)
    most = np.broadcast_to(np.asarray(most, dtype=float), len(joints))
    before, after = np.minimum(before, most), np.minimum(after, most)
    row = ROW if changed else ROW - BAR - 4
    rows = []
    for k, joint in enumerate(joints):
        floor = 0.0 if noise is None else float(noise[k])
        values = {"before": float(before[k]), "after": float(after[k])}
        shared = float(np.max(before[units == units[k]]))
        largest = max(values.values()) if changed or noise is not None else shared
        scale = (WIDTH - LABEL - VALUE) / max(largest, 1.25 * floor, 1e-300)
        if not changed:
            del values["after"]
        rows += _joint_bars(joint, k * row + 8, values, floor, scale, units[k], most[k])
    height = row * len(joints) + 4
    return (
        f'<svg class="bars" viewBox="0 0 {WIDTH} {height}" role="img" aria-label="before and after, per joint">'
        f"{''.join(rows)}</svg>"
    )


def _joint_bars(
    joint: str, top: int, values: Mapping[str, float], floor: float, scale: float, unit: str, most: float
) -> list[str]:
    """Return the name, the bars of `values` by their class, and the noise's mark of one joint."""
    both = len(values) > 1
    parts = [
        f'<text x="{LABEL - 12}" y="{top + (19 if both else 11)}" class="joint">{escape(_short(joint))}'
        f"<title>{escape(joint)}</title></text>"
    ]
    for k, (kind, value) in enumerate(values.items()):
        y = top + k * (BAR + 2)
        wide = max(1.5, value * scale)
        text = f"{'&gt; ' if value == most else ''}{number(value)} {unit}"
        crossed = -6.0 < floor * scale - wide < 6.0 + LETTER * len(text)  # the noise's mark would cross the text
        beside = max(wide, floor * scale) if crossed else wide
        parts.append(
            f'<rect x="{LABEL}" y="{y}" width="{wide:.1f}" height="{BAR}" rx="2" class="{kind}"/>'
            f'<text x="{LABEL + beside + 6:.1f}" y="{y + BAR - 2.5}" class="value">{text}</text>'
        )
    if floor > 0.0:
        x, low = LABEL + floor * scale, top + (2 * BAR if both else BAR) + 5
        parts.append(
            f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{top - 3}" y2="{low}" class="noise">'
            f"<title>noise {number(floor)} {unit}</title></line>"
        )
    return parts


def share_bar(share: float) -> str:
    """Return a filled track."""
    wide = 100.0 * min(1.0, max(0.0, share))
    return f'<span class="track"><span class="fill" style="width:{wide:.1f}%"></span></span>'


def ring(share: float, words: str) -> str:
    """Return a probability as a ring that is filled so far."""
    small = ' style="font-size:12px"' if len(words) > 4 else ""
    radius, share = 30.0, min(1.0, max(0.0, share))
    whole = 2.0 * np.pi * radius
    return (
        '<svg class="ring" viewBox="0 0 76 76" role="img">'
        f'<circle cx="38" cy="38" r="{radius}" class="ring-back"/>'
        f'<circle cx="38" cy="38" r="{radius}" class="ring-front" stroke-dasharray="{share * whole:.1f} {whole:.1f}" '
        'transform="rotate(-90 38 38)"/>'
        f'<text x="38" y="43" class="ring-text"{small}>{escape(words)}</text></svg>'
    )


def sparkline(time: Array, position: Array, joints: Sequence[str], moved: Sequence[str]) -> str:
    """Return a motion, each joint a line; those that the experiment is about in colour."""
    wide, high = 360, 90
    keep = np.unique(np.linspace(0, len(time) - 1, min(len(time), 500)).astype(int))
    x = wide * (time[keep] - time[0]) / max(float(time[-1] - time[0]), 1e-9)
    middle = 0.5 * (position.max(axis=0) + position.min(axis=0))
    scale = 0.46 * high / max(float(np.max(np.abs(position - middle))), 1e-9)
    lines = []
    for k, joint in enumerate(joints):
        y = 0.5 * high - scale * (position[keep, k] - middle[k])
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
        kind = "moved" if joint in moved else "still"
        lines.append((kind, f'<polyline points="{points}" class="{kind}"><title>{escape(joint)}</title></polyline>'))
    lines.sort(key=lambda line: line[0] == "moved")
    return f'<svg class="spark" viewBox="0 -2 {wide} {high + 4}" role="img">{"".join(line for _, line in lines)}</svg>'


def _short(name: str, most: int = LETTERS) -> str:
    return name if len(name) <= most else f"{name[: most - 1]}…"
