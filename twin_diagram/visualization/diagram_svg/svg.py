"""A Diagram as a picture: station on the left, twin on the right, a labelled port at both ends of every wire."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache
from html import escape
from pathlib import Path
from typing import Final

from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath
from pydrake.systems.framework import Diagram

from twin_diagram.runtime import atomic_file
from twin_diagram.visualization.diagram_svg.columns import STATION
from twin_diagram.visualization.diagram_svg.graph import TRUTH, Block, BlockGraph
from twin_diagram.visualization.diagram_svg.heights import HEADER, ROW
from twin_diagram.visualization.diagram_svg.routes import Layout, Placed, Point, Wire, layout

FONT_FAMILY: Final = "'DejaVu Sans', Verdana, Geneva, sans-serif"
"""Widths are measured with the first; the others are about as wide."""
FONT_SIZE: Final = 12.0
"""[px]; 9 pt."""
INK: Final = "#1f2933"
"""Of names and of ports in use."""
MUTED: Final = "#9aa5b1"
"""Of ports without a wire."""
OTHERS: Final = "#616e7c"
"""Of blocks that are not in `COLOURS`, and of the legend."""
COLOURS: Final = {
    "PerceptionSystem": "#0b7285",
    "IcpPoseEstimator": "#0b7285",
    "AdaptiveEkf": "#1864ab",
    "DriftMonitor": "#1864ab",
    "SceneGraphUpdater": "#5f3dc4",
    "MultibodyPositionToGeometryPose": "#5f3dc4",
    "SceneGraph": "#5f3dc4",
    "Mpc": "#c2410c",
}
"""By class: perception teal, estimation blue, scene violet, planning orange."""
STATION_COLOUR: Final = "#2b3a4a"
"""Of the station and its wires."""
CORNER: Final = 5.0
"""Radius of the wires' corners [px]."""


def write_diagram_svg(diagram: Diagram, path: str | Path, opened: Collection[str] = ("twin",)) -> Path:
    """Draw a Diagram into an SVG file.

    Args:
        diagram: the top-level Diagram.
        path: of the file.
        opened: names of the sub-Diagrams that are drawn with their systems.
    """
    return atomic_file.write(path, draw(BlockGraph.of(diagram, opened)))


def draw(graph: BlockGraph) -> str:
    """Return the SVG text of a picture of blocks and wires; the same for the same graph."""
    picture = layout(graph, _block_width)
    colours = {block.key: _colour(block) for block in graph.blocks}
    used = {port for wire in graph.wires for port in wire}
    width, height = round(picture.width), round(picture.height)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        f'font-family="{FONT_FAMILY}" font-size="{FONT_SIZE:.0f}">',
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
        *_frames(picture),
        *(part for wire in picture.wires for part in _wire(wire, colours[wire.source[0]])),
        *(part for placed in picture.blocks for part in _block(placed, colours[placed.block.key], used)),
        *_legend(graph, picture),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def _legend(graph: BlockGraph, picture: Layout) -> list[str]:
    """Return what dashes mean, where there are any."""
    if not any(port.startswith(TRUTH) for (_, port), _ in graph.wires):
        return []
    y = picture.height - 12
    return [
        f'<path d="M{picture.width - 330:.0f} {y - 4:.0f}h30" stroke="{STATION_COLOUR}" stroke-width="1.5" '
        f'stroke-dasharray="6 4"/><text x="{picture.width - 292:.0f}" y="{y:.0f}" fill="{OTHERS}">'
        "truth: for pictures and scores, never for the twin</text>"
    ]


def _colour(block: Block) -> str:
    return STATION_COLOUR if block.name == STATION else COLOURS.get(block.kind, OTHERS)


def _frames(picture: Layout) -> list[str]:
    return [
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" rx="10" '
        'fill="#f5f7fa" stroke="#cbd2d9"/>'
        f'<text x="{x + 14:.1f}" y="{y + 22:.1f}" font-size="15" font-weight="bold" fill="{INK}">{escape(name)}</text>'
        for name, x, y, width, height in picture.frames
    ]


def _wire(wire: Wire, colour: str) -> list[str]:
    dashed = wire.source[1].startswith(TRUTH)
    dash = ' stroke-dasharray="6 4"' if dashed else ""
    path = " ".join(_rounded(line) for line in wire.lines)
    title = f"<title>{escape(' '.join(wire.source))}</title>"
    parts = [f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="1.5"{dash}>{title}</path>']
    parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.8" fill="{colour}"/>' for x, y in wire.dots]
    parts += [f'<path d="M{x:.1f} {y:.1f}l-8 -4v8z" fill="{colour}"/>' for x, y in wire.arrows]
    return parts


def _rounded(line: list[Point]) -> str:
    """Return a path through points at right angles, its corners rounded."""
    points = [point for k, point in enumerate(line) if k == 0 or point != line[k - 1]]
    path = [f"M{points[0][0]:.1f} {points[0][1]:.1f}"]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        radius = min(CORNER, _distance(before, corner) / 2, _distance(corner, after) / 2)
        start, end = _towards(corner, before, radius), _towards(corner, after, radius)
        path.append(f"L{start[0]:.1f} {start[1]:.1f}Q{corner[0]:.1f} {corner[1]:.1f} {end[0]:.1f} {end[1]:.1f}")
    path.append(f"L{points[-1][0]:.1f} {points[-1][1]:.1f}")
    return "".join(path)


def _distance(a: Point, b: Point) -> float:
    return abs(a[0] - b[0]) + abs(a[1] - b[1])


def _towards(a: Point, b: Point, by: float) -> Point:
    length = max(_distance(a, b), 1e-9)
    return a[0] + (b[0] - a[0]) * by / length, a[1] + (b[1] - a[1]) * by / length


def _block(placed: Placed, colour: str, used: Collection[tuple[str, str]]) -> list[str]:
    """Return a block: its name on a bar, inputs along its left side, outputs along its right.

    Unconnected ports are faint.
    """
    block, x, y, width, height = placed.block, placed.x, placed.y, placed.width, placed.height
    bar = HEADER - 4
    place = f'x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}"'
    parts = [
        f"<g><title>{escape(block.kind)}</title>"
        f'<rect {place} rx="5" fill="#ffffff" stroke="{colour}" stroke-width="1.4"/>',
        f'<path d="M{x:.1f} {y + bar:.1f}v{5 - bar:.1f}q0 -5 5 -5h{width - 10:.1f}q5 0 5 5v{bar - 5:.1f}z" '
        f'fill="{colour}"/>',
        f'<text x="{x + width / 2:.1f}" y="{y + bar / 2 + 4.5:.1f}" text-anchor="middle" font-weight="bold" '
        f'fill="#ffffff">{escape(block.name)}</text>',
    ]
    for names, at, anchor in ((block.inputs, x + 10, "start"), (block.outputs, x + width - 10, "end")):
        for k, name in enumerate(names):
            ink = INK if (block.key, name) in used else MUTED
            style = ' font-style="italic"' if name.startswith(TRUTH) else ""
            parts.append(
                f'<text x="{at:.1f}" y="{y + HEADER + ROW * (k + 0.5) + 4:.1f}" text-anchor="{anchor}" '
                f'fill="{ink}"{style}>{escape(name)}</text>'
            )
    parts.append("</g>")
    return parts


def _block_width(block: Block) -> float:
    left = max((_text_width(name) for name in block.inputs), default=0.0)
    right = max((_text_width(name) for name in block.outputs), default=0.0)
    gap = 24 if left and right else 0
    return round(max(left + right + gap, _text_width(block.name, bold=True)) + 24)


@lru_cache(maxsize=1024)
def _text_width(text: str, bold: bool = False) -> float:
    """Return the width of a text [px], measured with the font that matplotlib brings along."""
    font = FontProperties(family="DejaVu Sans", weight="bold" if bold else "normal")
    return float(TextPath((0, 0), text, size=FONT_SIZE, prop=font).get_extents().width)
