"""Which column each block of a picture stands in."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Final

from twin_diagram.visualization.diagram_svg.graph import BlockGraph

STATION: Final = "station"
"""Name of the block that stands first."""


def columns(graph: BlockGraph) -> dict[str, int]:
    """Return the column of each block, by key: 0 for the station; the longest way from there for all that it feeds."""
    inside = {b.key for b in graph.blocks if b.parent}
    start = [b.key for b in graph.blocks if b.name == STATION and not b.parent]
    following: dict[str, set[str]] = defaultdict(set)
    for (source, _), (sink, _) in graph.wires:
        if source != sink and sink not in start:
            following[source].add(sink)
    keys = start + [b.key for b in graph.blocks if b.key not in start]
    _drop_cycles(keys, following)
    column = dict.fromkeys(keys, 1 if start else 0)
    column.update(dict.fromkeys(start, 0))
    for _ in keys:
        for key in keys:
            for after in following[key]:
                column[after] = max(column[after], column[key] + 1)
    fed = {after for key in keys for after in following[key]}
    last = max((column[key] for key in inside), default=0)
    for key in keys:
        if key not in fed and key not in start:
            # What is fed by nothing stands just before what it feeds; if that is the station, at the end of the twin.
            column[key] = max(min((column[a] - 1 for a in following[key]), default=last), column[key])
    if inside:
        for key in keys:
            if key not in inside and key not in start:
                column[key] = last + 1
    return column


def _drop_cycles(keys: Sequence[str], following: dict[str, set[str]]) -> None:
    """Remove from `following` the edges that close a cycle, as found from the first key on."""
    done: set[str] = set()
    for root in keys:
        path: list[tuple[str, list[str]]] = [] if root in done else [(root, sorted(following[root]))]
        on_path = {root}
        while path:
            key, todo = path[-1]
            if not todo:
                done.add(key)
                on_path.discard(key)
                path.pop()
                continue
            after = todo.pop()
            if after in on_path:
                following[key].discard(after)
            elif after not in done:
                on_path.add(after)
                path.append((after, sorted(following[after])))
