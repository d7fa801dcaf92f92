"""Read the package's imports from its source text and draw the graphs of files and rooms, for `house.py`."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

PACKAGE = "twin_diagram"

Graph = Mapping[str, set[str]]


@dataclass(frozen=True)
class Source:
    """A file of the package: its dotted module, its path from the checkout, its text and its tree."""

    module: str
    path: str
    text: str

    @cached_property
    def tree(self) -> ast.Module:
        """The parsed text."""
        return ast.parse(self.text, self.path)

    @cached_property
    def nodes(self) -> list[ast.AST]:
        """All of the tree's nodes, parents first."""
        return list(ast.walk(self.tree))

    @property
    def is_face(self) -> bool:
        """Whether it is a package's `__init__`."""
        return self.path.endswith("__init__.py")


@dataclass(frozen=True)
class Arrow:
    """An import: who imports, the module that is named, and the module in which the imported name is at home."""

    source: str
    target: str
    home: str


def read_sources(root: Path) -> dict[str, Source]:
    """Read each module of the package below a checkout, by its dotted name."""
    sources = {}
    for path in sorted((root / PACKAGE).rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        sources[module] = Source(module, path.relative_to(root).as_posix(), path.read_text(encoding="utf-8"))
    return sources


# Imports.


def imports_of(source: Source, nodes: Iterable[ast.AST], sources: Mapping[str, Source]) -> Iterator[tuple[str, str]]:
    """Yield the own modules that some of a file's nodes import, each with the name taken from it ('' for the whole)."""
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                parts = alias.name.split(".")
                while parts and ".".join(parts) not in sources:
                    parts.pop()
                if parts:
                    yield ".".join(parts), ""
        elif isinstance(node, ast.ImportFrom):
            above = source.module.split(".")
            above = above[: len(above) - node.level + source.is_face] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            for alias in node.names:
                if f"{base}.{alias.name}" in sources:
                    yield f"{base}.{alias.name}", ""
                elif base in sources:
                    yield base, alias.name


def strings_in(node: ast.AST | None) -> set[str]:
    """Return the string constants below a node."""
    found = [] if node is None else [n.value for n in ast.walk(node) if isinstance(n, ast.Constant)]
    return {value for value in found if isinstance(value, str)}


def assigned(body: Iterable[ast.stmt]) -> Iterator[tuple[str, ast.stmt, ast.expr | None]]:
    """Yield the plain names that statements assign, with statement and value."""
    for node in body:
        if isinstance(node, ast.Assign):
            yield from ((target.id, node, node.value) for target in node.targets if isinstance(target, ast.Name))
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            yield node.target.id, node, node.value


def listed(source: Source) -> set[str]:
    """Return the names in `__all__`."""
    return set().union(*(strings_in(value) for name, _, value in assigned(source.tree.body) if name == "__all__"))


def shown_by(face: Source, sources: Mapping[str, Source]) -> dict[str, str]:
    """Return what a face shows of its own package, name by module: from `__all__` or a table of strings."""
    below = face.module + "."
    public = listed(face)
    table = {}
    for node in face.nodes:
        for target, name in imports_of(face, [node], sources):
            if target.startswith(below) and name in public:
                table[name] = target
        if isinstance(node, ast.Dict):  # a lazy face: {"Ekf": "twin_diagram.estimation.filter.ekf"} or {"Ekf": "ekf"}
            for key, value in zip(node.keys, node.values, strict=True):
                for name in strings_in(key):
                    for module in strings_in(value):
                        full = module if module in sources else below + module.removeprefix(".")
                        if full in sources and full.startswith(below):
                            table[name] = full
    return table


def all_arrows(sources: Mapping[str, Source]) -> set[Arrow]:
    """Return each import of one own module by another; a face that only shows what is below it is no arrow."""
    faces = {name: shown_by(source, sources) for name, source in sources.items() if source.is_face}
    arrows = set()
    for source in sources.values():
        for target, name in imports_of(source, source.nodes, sources):
            if source.is_face and faces[source.module].get(name) == target:
                continue
            home = target
            while name in faces.get(home, {}):  # ends: each step is one further down
                home = faces[home][name]
            arrows.add(Arrow(source.module, target, home))
    return arrows


# Graphs.


def room_of(module: str, package: str) -> str:
    """Return the child of a package that holds a module; the package's own face is a room, too."""
    rest = module.removeprefix(package).lstrip(".")
    return rest.split(".")[0] if rest else "__init__"


def rooms_graph(sources: Iterable[str], arrows: Iterable[Arrow], package: str) -> dict[str, set[str]]:
    """Return which children of a package import which."""
    inside = {module for module in sources if f"{module}.".startswith(f"{package}.")}
    graph: dict[str, set[str]] = {room_of(module, package): set() for module in inside}
    for arrow in arrows:
        target = arrow.home if arrow.target == package else arrow.target
        if arrow.source in inside and target in inside:
            a, b = room_of(arrow.source, package), room_of(target, package)
            if a != b:
                graph[a].add(b)
    return graph


def circles(graph: Graph) -> list[list[str]]:
    """Return the nodes that reach one another, circle by circle (strongly connected components of more than one)."""
    reach: dict[str, set[str]] = {}
    for start in graph:
        seen: set[str] = set()
        pending = list(graph[start])
        while pending:
            node = pending.pop()
            if node not in seen:
                seen.add(node)
                pending.extend(graph[node])
        reach[start] = seen
    groups = {tuple(sorted(b for b in reach[a] if a in reach[b])) for a in graph}
    return [list(group) for group in sorted(groups) if len(group) > 1]


def heights(graph: Graph) -> dict[str, int]:
    """Return the floor of each node, from 1: of the longest way down, on which each circle is one step."""
    group = {name: name for name in graph}
    for circle in circles(graph):
        group.update(dict.fromkeys(circle, circle[0]))
    below: dict[str, set[str]] = defaultdict(set)
    for a, targets in graph.items():
        below[group[a]] |= {group[b] for b in targets} - {group[a]}

    @cache
    def height(name: str) -> int:
        return 1 + max((height(other) for other in sorted(below[name])), default=0)

    return {name: height(group[name]) for name in graph}


def arrows_up(graph: Graph) -> list[tuple[str, str]]:
    """Return the arrows that run up in the order of nodes which, as far as a search by moves finds, has the fewest."""
    result: list[tuple[str, str]] = []

    def against(order: list[str]) -> list[tuple[str, str]]:
        place = {name: index for index, name in enumerate(order)}
        return [(a, b) for a in order for b in sorted(graph[a]) if b in place and place[b] < place[a]]

    for circle in circles(graph):
        inside = set(circle)
        order = sorted(circle, key=lambda name: (-len(graph[name] & inside), name))
        gaining = True
        while gaining:
            before = len(against(order))
            for name in circle:
                rest = [other for other in order if other != name]
                moved = [rest[:index] + [name] + rest[index:] for index in range(len(order))]
                order = min([order, *moved], key=lambda trial: len(against(trial)))
            gaining = len(against(order)) < before
        result += against(order)
    return sorted(result)
