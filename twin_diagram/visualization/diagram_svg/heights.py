"""How high blocks and wires stand in a picture of a Diagram, after Sugiyama, Tagawa and Toda (1981).

Blocks stand in columns along the flow of data, the station first. All wires from one port form a net, which runs in a
lane through the columns that it passes and branches in the channels between them. What runs against the flow, or past
the opened Diagram, goes along the bottom. Lengths are pixels, y points down.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from statistics import fmean, median_low
from typing import Final

from twin_diagram.visualization.diagram_svg.columns import columns
from twin_diagram.visualization.diagram_svg.graph import Block, BlockGraph, Port

HEADER: Final = 28.0
"""Of a block's title [px]: a line of text and its margins."""
ROW: Final = 20.0
"""Of a port [px]."""
BLOCK_GAP: Final = 40.0
"""Between blocks of a column [px]: room for a wire's branches."""
LANE_GAP: Final = 14.0
"""Between wires that pass below [px]."""
FRAME: Final = 30.0
"""Between the opened Diagram's frame and what is in it."""
NUDGE: Final = 16.0
"""How far an item may be moved to straighten a wire [px]."""
NUDGED_GAP: Final = 9.0
"""What has to be left to its neighbours then [px]."""
SWEEPS: Final = 40
"""Over the columns, to and fro; in the second half both sides of a column count at once."""


@dataclass
class Item:
    """A block, or a lane that a net takes through a column; `net` tells which."""

    height: float
    block: Block | None = None
    net: int = -1
    y: float = 0.0

    def port_y(self, port: str, is_input: bool) -> float:
        """Height of a port's wire; a lane has but one."""
        return self.y + self.offset(port, is_input)

    def offset(self, port: str, is_input: bool) -> float:
        """Return the same from the item's top."""
        if self.block is None:
            return self.height / 2
        names = self.block.inputs if is_input else self.block.outputs
        return HEADER + ROW * (names.index(port) + 0.5)


@dataclass(frozen=True)
class WireStep:
    """Part of a net in one channel: from one height on its left to heights on its right (or to a bottom lane)."""

    net: int
    left: tuple[Item, str] | None
    right: list[tuple[Item, str]]
    bottom: bool = False


@dataclass
class Net:
    """All wires from one port."""

    source: Port
    sinks: list[Port]
    lanes: dict[int, Item] = field(default_factory=dict)
    bottom_sinks: list[Port] = field(default_factory=list)
    bottom_y: float = 0.0


class Heights:
    """Columns of blocks and lanes, ordered so that few wires cross, at heights that make many of them straight.

    Attributes:
        graph: what is laid out.
        column: of each block, by key.
        stacks: items of each column, from the top; the uppermost begins at 0.
        nets: the wires, by their source.
        steps: what runs in each channel; channel c lies left of column c, the last one right of all.
        floor: below everything.
    """

    def __init__(self, graph: BlockGraph) -> None:
        self.graph = graph
        self.column = columns(graph)
        self.count = max(self.column.values()) + 1
        self.items = {b.key: Item(HEADER + ROW * max(len(b.inputs), len(b.outputs), 1) + 4, b) for b in graph.blocks}
        self.stacks: list[list[Item]] = [[] for _ in range(self.count)]
        for b in graph.blocks:
            self.stacks[self.column[b.key]].append(self.items[b.key])
        self.nets = self._nets()
        self.steps: list[list[WireStep]] = [[] for _ in range(self.count + 1)]
        self._make_steps()
        self._place_vertically()
        self.floor = self._place_bottom_lanes()

    # Nets and their steps.

    def _nets(self) -> list[Net]:
        nets: dict[Port, Net] = {}
        inside = {b.key for b in self.graph.blocks if b.parent}
        for source, sink in self.graph.wires:
            net = nets.setdefault(source, Net(source, []))
            passes_by = bool(inside) and source[0] not in inside and sink[0] not in inside
            against = self.column[sink[0]] <= self.column[source[0]]
            (net.bottom_sinks if passes_by or against else net.sinks).append(sink)
        return list(nets.values())

    def _make_steps(self) -> None:
        for number, net in enumerate(self.nets):
            first = self.column[net.source[0]]
            last = max((self.column[key] for key, _ in net.sinks), default=first)
            for c in range(first + 1, last):
                net.lanes[c] = Item(0.0, None, number)
                self.stacks[c].append(net.lanes[c])
            left: tuple[Item, str] = (self.items[net.source[0]], net.source[1])
            for c in range(first + 1, last + 1):
                right = [(self.items[key], port) for key, port in net.sinks if self.column[key] == c]
                if c in net.lanes:
                    right.append((net.lanes[c], ""))
                down = c == first + 1 and bool(net.bottom_sinks)
                self.steps[c].append(WireStep(number, left, right, down))
                if c in net.lanes:
                    left = (net.lanes[c], "")
            if net.bottom_sinks and last == first:
                self.steps[first + 1].append(WireStep(number, left, [], True))
            for c in sorted({self.column[key] for key, _ in net.bottom_sinks}):
                right = [(self.items[key], port) for key, port in net.bottom_sinks if self.column[key] == c]
                self.steps[c].append(WireStep(number, None, right, True))

    def ends(self, step: WireStep) -> tuple[list[float], list[float]]:
        """Return the heights at which a step meets its channel's left and right side; a bottom lane is on both."""
        bottom = [self.nets[step.net].bottom_y] if step.bottom else []
        if step.left is None:
            return bottom, [item.port_y(port, True) for item, port in step.right]
        left = [step.left[0].port_y(step.left[1], False)]
        return left, [item.port_y(port, True) for item, port in step.right] + bottom

    # Heights.

    def _place_vertically(self) -> None:
        for stack in self.stacks:
            _stack(stack, [0.0] * len(stack))
        best: tuple[float, list[list[Item]], list[list[float]]] | None = None
        for sweep in range(SWEEPS):
            order = range(self.count) if sweep % 2 == 0 else range(self.count - 1, -1, -1)
            sides = (True, False) if sweep > SWEEPS // 2 else ((True,) if sweep % 2 == 0 else (False,))
            for c in order:
                self._settle(c, sides)
            cost = self._cost(self.steps)
            if best is None or cost < best[0]:
                best = (cost, [list(s) for s in self.stacks], [[i.y for i in s] for s in self.stacks])
        assert best is not None
        _, self.stacks, heights = best
        for stack, ys in zip(self.stacks, heights, strict=True):
            for item, y in zip(stack, ys, strict=True):
                item.y = y
        self._swap_neighbours()
        # Keep the order and make as many wires straight as can be: a median, unlike a mean, is where one of them ends.
        for sweep in range(12):
            for c in range(self.count) if sweep % 2 == 0 else range(self.count - 1, -1, -1):
                self._settle(c, (True, False), reorder=False, average=median_low)
        for c in range(1, self.count):
            self._settle(c, (True,), reorder=False, average=median_low)
        top = min(item.y for stack in self.stacks for item in stack)
        for stack in self.stacks:
            for item in stack:
                item.y = round(item.y - top)
        for c in range(self.count):
            self._straighten(c)

    def _swap_neighbours(self) -> None:
        """Swap neighbours in a column as long as that makes the picture better."""
        improved = True
        while improved:
            improved = False
            for c, stack in enumerate(self.stacks):
                beside = self.steps[c : c + 2]  # no other channel's wires end at this column
                for k in range(len(stack) - 1):
                    before, heights = self._cost(beside), [item.y for item in stack]
                    stack[k], stack[k + 1] = stack[k + 1], stack[k]
                    _stack(stack, heights)
                    if self._cost(beside) < before - 1e-6:
                        improved = True
                        continue
                    stack[k], stack[k + 1] = stack[k + 1], stack[k]
                    for item, y in zip(stack, heights, strict=True):
                        item.y = y

    def _straighten(self, c: int) -> None:
        """Nudge a column's items by a few pixels where that makes more of their wires straight."""
        stack = self.stacks[c]
        for k, item in enumerate(stack):
            moves = []
            for channel in (c, c + 1):
                for step in self.steps[channel]:
                    for other, port in step.right if step.left is not None else []:
                        assert step.left is not None
                        jog = other.port_y(port, True) - step.left[0].port_y(step.left[1], False)
                        moves += [-jog] if other is item else [jog] if step.left[0] is item else []
            low = stack[k - 1].y + stack[k - 1].height + NUDGED_GAP if k > 0 else item.y - NUDGE
            high = stack[k + 1].y - NUDGED_GAP - item.height if k + 1 < len(stack) else item.y + NUDGE
            fitting = [m for m in moves if abs(m) <= NUDGE and low <= item.y + m <= high]
            best = max(fitting, key=lambda m: (moves.count(m), -abs(m)), default=0.0)
            if moves.count(best) > moves.count(0.0):
                item.y += best

    def _settle(
        self, c: int, sides: Sequence[bool], reorder: bool = True, average: Callable[[list[float]], float] = fmean
    ) -> None:
        """Move a column's items to where their wires on the given sides (True: left) would be straight."""
        wanted: dict[int, list[float]] = defaultdict(list)
        for is_left, channel in ((True, c), (False, c + 1)):
            if is_left not in sides:
                continue
            for step in self.steps[channel]:
                if step.left is None:
                    continue
                item, port = step.left
                y_left, offset = item.port_y(port, False), item.offset(port, False)
                for other, other_port in step.right:
                    if is_left:
                        wanted[id(other)].append(y_left - other.offset(other_port, True))
                    else:
                        wanted[id(item)].append(other.port_y(other_port, True) - offset)
        stack = self.stacks[c]
        goals = {id(item): (average(w) if (w := wanted[id(item)]) else item.y) for item in stack}
        if reorder:
            stack.sort(key=lambda item: goals[id(item)] + item.height / 2)
        _stack(stack, [goals[id(item)] for item in stack])

    def _cost(self, channels: Sequence[Sequence[WireStep]]) -> float:
        """Return the cost of channels: of crossings, then of length."""
        cost = 0.0
        for steps in channels:
            pairs = []
            for step in steps:
                left, right = self.ends(step)
                if step.left is not None:
                    # Two lanes that swap places between two columns look odd; a crossing beside a block does not.
                    lane = step.left[0].block is None
                    pairs += [
                        (left[0], y, 1.5 if lane and item.block is None else 1.0)
                        for y, (item, _) in zip(right, step.right, strict=False)
                    ]
            cost += sum(abs(a - b) for a, b, _ in pairs) / 200
            cost += sum(v * w for i, (a, b, v) in enumerate(pairs) for c, d, w in pairs[:i] if (a - c) * (b - d) < 0)
        return cost

    def _place_bottom_lanes(self) -> float:
        """Place lanes below everything: those that pass by above those that run back; return the lowest height."""
        floor = max(item.y + item.height for stack in self.stacks for item in stack) + FRAME

        def outermost(net: Net) -> tuple[bool, int, float]:
            back = any(self.column[key] <= self.column[net.source[0]] for key, _ in net.bottom_sinks)
            y = self.items[net.source[0]].port_y(net.source[1], False)
            return back, self.column[net.source[0]], -y

        for net in sorted((net for net in self.nets if net.bottom_sinks), key=outermost):
            floor += LANE_GAP
            net.bottom_y = floor
        return floor


def _stack(stack: list[Item], goals: list[float]) -> None:
    """Place items below one another, as near to their goals as their order and gaps allow (least squares)."""
    shift, shifts = 0.0, []
    for above, item in zip([None, *stack[:-1]], stack, strict=True):
        if above is not None:
            both_lanes = above.block is None and item.block is None
            one_lane = above.block is None or item.block is None
            shift += above.height + (LANE_GAP if both_lanes else BLOCK_GAP / 2 if one_lane else BLOCK_GAP)
        shifts.append(shift)
    # Isotonic regression by pooling adjacent violators, on goals less what the items above need.
    pools: list[tuple[float, float, int]] = []
    for item, goal, need in zip(stack, goals, shifts, strict=True):
        weight = 1.0 if item.block is not None else 3.0
        total, weights, count = (goal - need) * weight, weight, 1
        while pools and pools[-1][0] / pools[-1][1] > total / weights:
            above_total, above_weights, above_count = pools.pop()
            total, weights, count = total + above_total, weights + above_weights, count + above_count
        pools.append((total, weights, count))
    index = 0
    for total, weights, count in pools:
        for item in stack[index : index + count]:
            item.y = total / weights + shifts[index]
            index += 1
