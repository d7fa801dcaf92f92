"""Draws mutants by seed: in turn over packages, in each over its modules, in each over its sites."""

from __future__ import annotations

import difflib
import hashlib
import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mutants.maths_modules import maths_modules, package_of
from mutants.sites import Change, Site, mutated, sites


@dataclass(frozen=True)
class Mutant:
    """One fault in one module."""

    path: str
    source: str
    site: Site
    change: Change

    @property
    def identity(self) -> str:
        """What names the mutant for as long as its module stays as it is."""
        what = (self.path, self.source, str(self.site.begin), str(self.site.end), self.change.text)
        return hashlib.sha1("\0".join(what).encode()).hexdigest()[:8]

    @property
    def package(self) -> str:
        """The package that it is counted under."""
        return package_of(self.path)

    @property
    def text(self) -> str:
        """The whole module with the fault in it."""
        return mutated(self.source, self.site, self.change)

    def diff(self, context: int = 0) -> str:
        """Return the change as a unified diff with lines of context."""
        pair = self.source.splitlines(), self.text.splitlines()
        return "\n".join(difflib.unified_diff(*pair, self.path, self.path, n=context, lineterm=""))

    def line(self) -> str:
        """Return the change on one line."""
        before, after = (" ".join(text.split()) for text in (self.site.before, self.change.text))
        return f"{self.identity}  {self.path}:{self.site.line}  {self.change.operator}:  {before}  →  {after}"


def in_turn(streams: list[Iterator[Mutant]]) -> Iterator[Mutant]:
    """Yield one of each stream, again and again, until all have run dry."""
    while streams:
        left = []
        for stream in streams:
            mutant = next(stream, None)
            if mutant is not None:
                left.append(stream)
                yield mutant
        streams = left


def of_module(root: Path, path: str, seed: int) -> Iterator[Mutant]:
    """Yield a module's mutants: each site once with one of its changes, then each once more with another."""
    chance = random.Random(f"{seed}:{path}")
    source = (root / path).read_text()
    decks = [(site, chance.sample(site.changes, len(site.changes))) for site in sites(source)]
    chance.shuffle(decks)
    for turn in range(max((len(changes) for _, changes in decks), default=0)):
        for site, changes in decks:
            if turn < len(changes):
                yield Mutant(path, source, site, changes[turn])


def draw(root: Path, seed: int, count: int, only: str = "") -> list[Mutant]:
    """Return `count` mutants of the maths modules, or of those of one package or file alone."""
    packages: dict[str, list[str]] = {}
    for path in maths_modules(root):
        if not only or only == package_of(path) or path.removeprefix("twin_diagram/").startswith(trimmed(only)):
            packages.setdefault(package_of(path), []).append(path)
    streams = []
    for package, paths in sorted(packages.items()):
        random.Random(f"{seed}:{package}").shuffle(paths)
        streams.append(in_turn([of_module(root, path, seed) for path in paths]))
    return [mutant for mutant, _ in zip(in_turn(streams), range(count), strict=False)]


def trimmed(only: str) -> str:
    """Return what `--only` names, relative to the package."""
    return only.removeprefix("./").removeprefix("twin_diagram/")
