"""Chooses the tests that have the best chance to notice a mutant within a budget of time."""

from __future__ import annotations

import ast
import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

UNMAPPED = {"test_mutants.py", "test_packaging.py", "test_readme.py"}
"""They run other programs or read sources: no fault in memory reaches them."""


@dataclass(frozen=True)
class Chosen:
    """Tests in the order in which they run, and the seconds that they should take."""

    tests: tuple[str, ...]
    seconds: float


class Ranked(NamedTuple):
    """A test that could run: the less it weighs, the sooner. Seconds are its own and those of what it shares."""

    weight: float
    name: str
    file: str
    seconds: float
    shared: float

    @property
    def group(self) -> str:
        """The file, where tests share something slow and had better stay together; else the test alone."""
        return self.file if self.shared > 0.05 else self.name


class Map:
    """What is known of each file of tests: seconds, outcomes, blocks reached. Kept on disk until something changes."""

    def __init__(self, root: Path, folder: Path):
        self.root, self.folder = root, folder
        paths = [path for path in (root / "tests").rglob("test_*.py") if path.name not in UNMAPPED]
        self.files = sorted(path.relative_to(root).as_posix() for path in paths)
        self.records: dict[str, dict[str, Any]] = {}
        self.excluded: set[str] = set()

    def _place(self, file: str) -> Path:
        return self.folder / (file.replace("/", "-") + ".json")

    def load(self) -> list[str]:
        """Read what still holds; return the files of tests that must run again."""
        left = []
        for file in self.files:
            place = self._place(file)
            record = json.loads(place.read_text()) if place.is_file() else None
            if record is not None and all(digest(self.root, path) == known for path, known in record["needs"].items()):
                self.records[file] = record
            else:
                left.append(file)
        return left

    def keep(self, file: str, answer: dict[str, Any]) -> None:
        """Remember what a run of a file of tests said."""
        record = {**answer, "needs": {path: digest(self.root, path) for path in answer["needs"]}}
        self.records[file] = record
        self.folder.mkdir(parents=True, exist_ok=True)
        part = self._place(file).with_suffix(".part")
        part.write_text(json.dumps(record))
        part.rename(self._place(file))

    def unsound(self) -> list[str]:
        """Return the tests that fail without any mutant."""
        records = self.records.values()
        return [name for record in records for name, test in record["tests"].items() if test["outcome"] == "failed"]

    def choose(self, path: str, blocks: set[str], budget: float, most: int) -> Chosen:
        """Return tests that reach one of the blocks: close and fast ones first, of each function few variants."""
        ranked, variants = list[Ranked](), Counter[str]()
        for file, record in self.records.items():
            mask = sum(1 << index for index, name in enumerate(record["blocks"]) if name in blocks)
            near = distance(self.root, file, path) if mask else 0
            tests = record["tests"].items() if mask else ()
            for name, test in sorted(tests, key=lambda item: float(item[1].get("seconds", 0.0))):
                if test["outcome"] == "passed" and name not in self.excluded and int(test["blocks"], 16) & mask:
                    shared = sum(record["shared"].get(fixture, 0.0) for fixture in test["shared"])
                    function = name.partition("[")[0]
                    weight = (0.05 + test["seconds"] + shared) * (1 + near) * (1 + variants[function])
                    ranked.append(Ranked(weight, name, file, test["seconds"], shared))
                    variants[function] += 1
        return within(sorted(ranked), {file: record["import"] for file, record in self.records.items()}, budget, most)


def within(ranked: Sequence[Ranked], imports: dict[str, float], budget: float, most: int) -> Chosen:
    """Take the best until the budget is spent; order them so that what tests share is made once."""
    taken: list[Ranked] = []
    spent, files, shared_in = 0.0, set[str](), set[str]()
    for one in ranked:
        # Most of a file's time to be ready is the import of the package, which happens once.
        ready = 0.0 if one.file in files else 0.3 * imports[one.file]
        cost = one.seconds + ready + (0.0 if one.file in shared_in else one.shared)
        if taken and spent + cost > budget:
            continue
        taken.append(one)
        spent += cost
        files.add(one.file)
        if one.shared:
            shared_in.add(one.file)
        if len(taken) == most:
            break
    groups: dict[str, float] = {}
    for one in taken:
        groups[one.group] = min(one.weight, groups.get(one.group, one.weight))
    order = sorted(taken, key=lambda one: (groups[one.group], one.group, one.weight))
    return Chosen(tuple(one.name for one in order), spent)


def digest(root: Path, path: str) -> str:
    """Return a digest of a file, or nothing where there is none."""
    file = root / path
    return _digest(file, file.stat().st_mtime_ns) if file.is_file() else ""


@cache
def _digest(file: Path, _: int) -> str:
    return hashlib.sha1(file.read_bytes()).hexdigest()[:12]


@cache
def imported_by(file: Path) -> frozenset[str]:
    """Return the dotted names that a file imports, those of what it takes from packages, too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module)
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return frozenset(names)


def distance(root: Path, file: str, path: str) -> int:
    """Return how far a file of tests is from a module: 0 mirrored, 1 imports it, 2 imports its package, 3 neither."""
    stem = Path(path).stem
    if Path(file).stem == f"test_{stem}":
        return 0
    dotted = path.removesuffix(".py").replace("/", ".")
    names = imported_by(root / file)
    if dotted in names:
        return 1
    return 2 if dotted.rpartition(".")[0] in names else 3
