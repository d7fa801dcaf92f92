"""Where blocks and wires of a picture go, left to right: the way from heights to finished lines at right angles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from twin_diagram.visualization.diagram_svg.channels import order_tracks
from twin_diagram.visualization.diagram_svg.graph import Block, BlockGraph, Port
from twin_diagram.visualization.diagram_svg.heights import FRAME, Heights, WireStep

TRACK_GAP: Final = 11.0
"""Between upright runs of wires in a channel [px]."""
MARGIN: Final = 24.0
"""About the picture [px]."""

Point = tuple[float, float]


@dataclass(frozen=True)
class Wire:
    """A drawn net: polylines from the source, one arrow per sink, dots where it branches."""

    source: Port
    lines: list[list[Point]]
    arrows: list[Point]
    dots: list[Point]


@dataclass(frozen=True)
class Placed:
    """A block's place: left, top, width and height."""

    block: Block
    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True)
class Layout:
    """A finished picture, from (0, 0) to (width, height)."""

    blocks: list[Placed]
    wires: list[Wire]
    frames: list[tuple[str, float, float, float, float]]
    width: float
    height: float


def layout(graph: BlockGraph, width_of: Callable[[Block], float]) -> Layout:
    """Place a graph.

    Args:
        graph: blocks and wires.
        width_of: how wide a block has to be for its texts.
    """
    heights = Heights(graph)
    tracks = [order_tracks([heights.ends(step) for step in steps]) for steps in heights.steps]
    return _Routes(heights, tracks, width_of).picture()


class _Routes:
    def __init__(self, heights: Heights, tracks: list[list[int]], width_of: Callable[[Block], float]) -> None:
        self.heights, self.tracks = heights, tracks
        column, blocks = heights.column, heights.graph.blocks
        self.inside = {column[b.key] for b in blocks if b.parent}
        self.top = MARGIN + (FRAME + 22 if self.inside else 0.0)
        self.left_of: list[float] = []
        self.right_of: list[float] = []
        self.channel_x: list[float] = []
        count = len(heights.stacks)
        x = MARGIN
        for c in range(count + 1):
            x += FRAME if c - 1 in self.inside and c not in self.inside else 0.0
            self.channel_x.append(x + 1.5 * TRACK_GAP)
            x += TRACK_GAP * (len(tracks[c]) + 2) if tracks[c] or 0 < c < count else 0.0
            x += FRAME if c in self.inside and c - 1 not in self.inside else 0.0
            if c < count:
                self.left_of.append(x)
                x += max(width_of(b) for b in blocks if column[b.key] == c)
                self.right_of.append(x)
        self.width = x + MARGIN

    def picture(self) -> Layout:
        placed = [
            Placed(item.block, self.left_of[c], item.y + self.top, self.right_of[c] - self.left_of[c], item.height)
            for c, stack in enumerate(self.heights.stacks)
            for item in stack
            if item.block is not None
        ]
        wires = [self._wire(number) for number in range(len(self.heights.nets))]
        height = self.heights.floor + self.top + 1.5 * MARGIN
        return Layout(placed, wires, self._frames(), self.width, height)

    def _frames(self) -> list[tuple[str, float, float, float, float]]:
        frames = []
        blocks, column, stacks = self.heights.graph.blocks, self.heights.column, self.heights.stacks
        for name in dict.fromkeys(b.parent for b in blocks if b.parent):
            held = {column[b.key] for b in blocks if b.parent == name}
            items = [item for c in range(min(held), max(held) + 1) for item in stacks[c]]
            y0 = min(item.y for item in items) + self.top - FRAME - 10
            y1 = max(item.y + item.height for item in items) + self.top + 0.7 * FRAME
            x0, x1 = self.left_of[min(held)] - FRAME, self.right_of[max(held)] + FRAME
            frames.append((name, x0, y0, x1 - x0, y1 - y0))
        return frames

    def _wire(self, number: int) -> Wire:
        net = self.heights.nets[number]
        bottom = net.bottom_y + self.top
        wire = Wire(net.source, [], [], [])
        down: list[list[Point]] = []
        up: list[list[Point]] = []
        for c, steps in enumerate(self.heights.steps):
            for k, step in enumerate(steps):
                if step.net != number:
                    continue
                track = self.channel_x[c] + TRACK_GAP * self.tracks[c][k]
                first: list[Point] = [(track, bottom)]
                if step.left is not None:
                    y0 = step.left[0].port_y(step.left[1], False) + self.top
                    first = [(self.right_of[c - 1], y0), (track, y0)]
                    if step.bottom:
                        down.append([*first, (track, bottom)])
                ys = []
                for item, port in step.right:
                    ys.append(item.port_y(port, True) + self.top)
                    end = (self.left_of[c], ys[-1])
                    line = [*first, (track, ys[-1]), end]
                    if item.block is not None:
                        wire.arrows.append(end)
                    else:
                        line.append((self.right_of[c], ys[-1]))
                    (wire.lines if step.left is not None else up).append(line)
                wire.dots.extend(_branches(track, first[-1][1], ys, step, bottom))
        if len(down) == len(up) == 1:
            wire.lines.append(down[0] + up[0])
        elif down:
            wire.lines.extend([*down, *up])
            ends = [line[-1][0] for line in down] + [line[0][0] for line in up]
            wire.lines.append([(min(ends), bottom), (max(ends), bottom)])
        return wire


def _branches(x: float, y0: float, ys: list[float], step: WireStep, bottom: float) -> list[Point]:
    """Return the points on a track where more than two directions meet."""
    ends = [y0, *ys] + ([bottom] if step.bottom and step.left is not None else [])
    if len(ends) < 3:
        return []
    low, high = min(ends), max(ends)
    inner = [y for y in set(ends) if low < y < high]
    doubled = [y for y in (low, high) if low < high and ends.count(y) > 1]
    return [(x, y) for y in inner + doubled if not (step.bottom and y == bottom)]
