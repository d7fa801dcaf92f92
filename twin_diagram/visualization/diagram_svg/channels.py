"""In which order wires run up and down in the channel between two columns of blocks, so that few of them cross."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

Ends = tuple[Sequence[float], Sequence[float]]
"""Heights at which a wire meets the left side of a channel, and the right side."""

OVERLAP: Final = 100
"""What it costs when two wires would lie on one another."""


def order_tracks(wires: Sequence[Ends]) -> list[int]:
    """Return the track of each wire, 0 being the leftmost; a track holds one wire."""
    order: list[int] = []
    for wire in sorted(range(len(wires)), key=lambda k: (-len(wires[k][0]) - len(wires[k][1]), k)):
        places = range(len(order) + 1)
        costs = [_cost_of(wire, order[:place], order[place:], wires) for place in places]
        order.insert(costs.index(min(costs)), wire)
    improved = True
    while improved:
        improved = False
        for wire in range(len(wires)):
            rest = [other for other in order if other != wire]
            costs = [_cost_of(wire, rest[:place], rest[place:], wires) for place in range(len(order))]
            here = order.index(wire)
            if min(costs) < costs[here]:
                order = [*rest[: costs.index(min(costs))], wire, *rest[costs.index(min(costs)) :]]
                improved = True
    tracks = [0] * len(wires)
    for track, wire in enumerate(order):
        tracks[wire] = track
    return tracks


def _cost_of(wire: int, left: Sequence[int], right: Sequence[int], wires: Sequence[Ends]) -> int:
    return sum(crossings(wires[other], wires[wire]) for other in left) + sum(
        crossings(wires[wire], wires[other]) for other in right
    )


def crossings(first: Ends, second: Ends) -> int:
    """Return how often two wires cross when the first one's track lies left of the second's.

    The first wire's runs to the right pass the second's track, and the second's runs to the left pass the first's.
    """
    span_first, span_second = _span(first), _span(second)
    count = sum(span_second[0] < y < span_second[1] for y in first[1])
    count += sum(span_first[0] < y < span_first[1] for y in second[0])
    # On one height, the first's run to the right would lie on the second's run to the left.
    return count + OVERLAP * sum(abs(a - b) < 1 for a in first[1] for b in second[0])


def _span(wire: Ends) -> tuple[float, float]:
    heights = [*wire[0], *wire[1]]
    return min(heights), max(heights)
