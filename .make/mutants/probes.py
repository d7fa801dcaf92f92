"""Which blocks of the package a test reaches: probes in the source, served from memory at import.

A probe is one call of a set's `add` at the head of each function's body, of each branch and loop, and behind each.
"""

from __future__ import annotations

import ast
import builtins
import functools
import importlib.machinery
import importlib.util
import itertools
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

PROBE = "__reached_by_this_test__"
Change = Callable[[str, str], "ast.Module | str"]
"""From a module's path in the checkout and its source to what is compiled in its stead."""


class Served(importlib.machinery.SourceFileLoader):
    """Loads a module from its source as changed in memory; nothing is written."""

    def __init__(self, fullname: str, path: str, relative: str, change: Change):
        super().__init__(fullname, path)
        self.relative, self.change = relative, change

    def get_code(self, fullname: str) -> CodeType:
        """Compile the changed source under the file's own name."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)
            changed = self.change(self.relative, Path(self.path).read_text())
            return compile(changed, self.path, "exec", dont_inherit=True)


class Finder:
    """Serves the package's modules with changes, wherever they are imported from."""

    def __init__(self, root: Path, package: str, change: Change, only: str | None = None):
        self.root, self.package, self.change, self.only = root, package, change, only

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Return the spec of a module of the package that is to be changed, else None."""
        if fullname.partition(".")[0] != self.package:
            return None
        place = self.root.joinpath(*fullname.split("."))
        file = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
        relative = file.relative_to(self.root).as_posix()
        if not file.is_file() or (self.only is not None and relative != self.only):
            return None
        loader = Served(fullname, str(file), relative, self.change)
        return importlib.util.spec_from_file_location(fullname, file, loader=loader)


def install(finder: Finder) -> None:
    """Put the finder first and the checkout on the path."""
    sys.meta_path.insert(0, finder)
    sys.path.insert(0, str(finder.root))


def is_compiled(path: str) -> bool:
    """Return true for a module whose functions are compiled: probes would not."""
    return path.endswith("_kernels.py")


def probed(relative: str, source: str) -> ast.Module:
    """Return a module's tree with a probe in each of its functions' blocks."""
    tree = ast.parse(source)
    if is_compiled(relative):
        return tree
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            put_probes(node, relative)
    return ast.fix_missing_locations(tree)


def put_probes(node: ast.AST, relative: str) -> None:
    """Put a probe at the head of each suite below a function, and behind each compound statement."""
    for name in ("body", "orelse", "finalbody"):
        suite = getattr(node, name, None)
        if not isinstance(suite, list) or not suite:
            continue
        for below in suite:
            if not isinstance(below, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                for part in (below, *getattr(below, "handlers", ()), *getattr(below, "cases", ())):
                    put_probes(part, relative)
        heads = set(block_heads(suite))
        parts = [with_probe(one, index in heads, relative) for index, one in enumerate(suite)]
        setattr(node, name, list(itertools.chain.from_iterable(parts)))


def with_probe(statement: ast.stmt, head: bool, relative: str) -> Iterator[ast.stmt]:
    """Yield a statement, behind a probe where it heads a block."""
    if head:
        call = ast.Call(ast.Name(PROBE, ast.Load()), [ast.Constant(f"{relative}:{statement.lineno}")], [])
        yield ast.copy_location(ast.Expr(call), statement)
    yield statement


def block_heads(suite: list[ast.stmt]) -> Iterator[int]:
    """Yield the indices of the statements of a suite that head a block: the first, and those behind a compound one."""
    first = 0
    if isinstance(suite[0], ast.Expr) and isinstance(suite[0].value, ast.Constant) and len(suite) > 1:
        first = 1  # the docstring stays where it is
    yield first
    for index in range(first + 1, len(suite)):
        if isinstance(suite[index - 1], ast.If | ast.For | ast.While | ast.Try | ast.With):
            yield index


class Reached:
    """The blocks entered since the last clearing; what was computed once and kept counts for all who read it."""

    def __init__(self) -> None:
        self.blocks: set[str] = set()

    def install(self) -> None:
        """Give the probes something to call, and have caches tell."""
        setattr(builtins, PROBE, self.blocks.add)
        functools.lru_cache = self._lru_cache(functools.lru_cache)
        functools.cache = lambda function: functools.lru_cache(maxsize=None)(function)
        functools.cached_property = self._cached_property()  # type: ignore[misc]

    @contextmanager
    def apart(self) -> Iterator[set[str]]:
        """Collect into a set of its own what is entered meanwhile; afterwards all of it counts."""
        before, entered = set(self.blocks), set[str]()
        self.blocks.clear()
        try:
            yield entered
        finally:
            entered.update(self.blocks)
            self.blocks.update(before)

    def _lru_cache(self, original: Any) -> Any:
        def lru_cache(maxsize: Any = 128, typed: bool = False) -> Any:
            if callable(maxsize):
                return lru_cache()(maxsize)

            def decorate(function: Any) -> Any:
                seen: set[str] = set()

                @functools.wraps(function)
                def miss(*args: Any, **given: Any) -> Any:
                    with self.apart() as entered:
                        value = function(*args, **given)
                    seen.update(entered)
                    return value

                cached = original(maxsize, typed)(miss)

                @functools.wraps(function)
                def call(*args: Any, **given: Any) -> Any:
                    value = cached(*args, **given)
                    self.blocks.update(seen)
                    return value

                for name in ("cache_clear", "cache_info", "cache_parameters"):
                    setattr(call, name, getattr(cached, name))
                return call

            return decorate

        return lru_cache

    def _cached_property(self) -> Any:
        reached = self

        class CachedProperty(functools.cached_property):  # type: ignore[type-arg]
            seen: set[str]

            def __get__(self, instance: Any, owner: Any = None) -> Any:
                if instance is None:
                    return self
                self.seen = getattr(self, "seen", set())
                if self.attrname not in instance.__dict__:
                    with reached.apart() as entered:
                        instance.__dict__[self.attrname] = self.func(instance)
                    self.seen |= entered
                reached.blocks.update(self.seen)
                return instance.__dict__[self.attrname]

            def __set__(self, instance: Any, value: Any) -> None:
                instance.__dict__[self.attrname] = value

        return CachedProperty
