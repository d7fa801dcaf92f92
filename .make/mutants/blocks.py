"""Which blocks a mutant can be noticed in: its own, or for a constant those that read its name."""

from __future__ import annotations

import ast
from collections import defaultdict
from functools import cached_property
from pathlib import Path

from mutants.draw import Mutant
from mutants.maths_modules import PACKAGE
from mutants.probes import PROBE, is_compiled, probed

Place = tuple[int, int]


class Module:
    """One module's blocks, and who reads which name in it."""

    def __init__(self, path: str, source: str):
        self.path, self.source = path, source
        self.tree = ast.parse(source)
        self.blocks: list[tuple[Place, Place, str]] = []
        self.reads: dict[str, set[str]] = defaultdict(set)
        self.feeds: dict[str, set[str]] = defaultdict(set)
        self.imported: set[str] = set()
        for node in ast.walk(probed(path, source)):
            for name in ("body", "orelse", "finalbody"):
                suite = getattr(node, name, None)
                if isinstance(suite, list):
                    self._add_blocks(suite)
        self._add_names()

    def _add_blocks(self, suite: list[ast.stmt]) -> None:
        open_at: tuple[Place, str] | None = None
        end: Place = (0, 0)
        for statement in suite:
            name = probe_name(statement)
            if name is None:
                end = (statement.end_lineno or 0, statement.end_col_offset or 0)
                continue
            if open_at:
                self.blocks.append((open_at[0], end, open_at[1]))
            open_at = (statement.lineno, statement.col_offset), name
        if open_at:
            self.blocks.append((open_at[0], end, open_at[1]))

    def _add_names(self) -> None:
        for node in ast.walk(self.tree):
            if isinstance(node, ast.ImportFrom):
                self.imported.update(alias.name for alias in node.names)
                self.imported.add((node.module or "").rpartition(".")[2])
            name = node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""
            if name and isinstance(node, ast.expr) and isinstance(getattr(node, "ctx", None), ast.Load):
                where = (node.lineno, node.col_offset)
                block = self.block_at(where)
                if block:
                    self.reads[name].add(block)
                else:
                    owners = self.owners(where)
                    self.feeds[name].update(owners)
                    self.reads[name].update(owner for owner in owners if ":" in owner)

    def block_at(self, where: Place) -> str:
        """Return the innermost block around a place, or nothing for one that runs at import."""
        around = [(end[0] - begin[0], name) for begin, end, name in self.blocks if begin <= where < end]
        return min(around)[1] if around else ""

    def owners(self, where: Place) -> set[str]:
        """Return what a place outside functions makes: names of constants, or the first block of a function's own."""
        suite, found = self.tree.body, set[str]()
        while suite:
            statement = next((one for one in suite if holds(one, where)), None)
            if statement is None:
                break
            if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
                found.update({name for begin, _, name in self.blocks if begin == head(statement)})
            targets = getattr(statement, "targets", None) or [getattr(statement, "target", None)]
            for target in targets:
                if isinstance(target, ast.AST):
                    found.update(node.id for node in ast.walk(target) if isinstance(node, ast.Name))
            suite = statement.body if isinstance(statement, ast.ClassDef | ast.If | ast.With) else []
        return found


def holds(statement: ast.stmt, where: Place) -> bool:
    """Return true where a place lies within a statement."""
    end = statement.end_lineno or 0, statement.end_col_offset or 0
    return (statement.lineno, statement.col_offset) <= where < end


def head(function: ast.FunctionDef | ast.AsyncFunctionDef) -> Place:
    """Return where a function's first block begins."""
    first = function.body[0]
    documented = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and len(function.body) > 1
    first = function.body[1] if documented else first
    return first.lineno, first.col_offset


def probe_name(statement: ast.stmt) -> str | None:
    """Return the block that a statement is the probe of, if it is one."""
    call = statement.value if isinstance(statement, ast.Expr) else None
    if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == PROBE:
        argument = call.args[0]
        return str(argument.value) if isinstance(argument, ast.Constant) else None
    return None


class Package:
    """All modules of the package."""

    def __init__(self, root: Path):
        self.root = root

    @cached_property
    def modules(self) -> dict[str, Module]:
        """The modules by path."""
        paths = {path.relative_to(self.root).as_posix(): path for path in (self.root / PACKAGE).rglob("*.py")}
        return {name: Module(name, path.read_text()) for name, path in sorted(paths.items())}

    def blocks_of(self, mutant: Mutant) -> set[str]:
        """Return the blocks that a test must reach to have a chance of noticing a mutant."""
        module = self.modules[mutant.path]
        if is_compiled(mutant.path):
            return self.callers(module)
        before = mutant.source.encode()[: mutant.site.begin]
        where = mutant.site.line, len(before) - (before.rfind(b"\n") + 1)
        block = module.block_at(where)
        if block:
            return {block}
        names, found = module.owners(where), set[str]()
        for _ in range(4):
            found |= {name for name in names if ":" in name}
            names |= set[str]().union(*(module.feeds[name] for name in list(names)))
        for name in names:
            found |= self.readers(module, name)
        return found or {name for _, _, name in module.blocks}

    def callers(self, kernels: Module) -> set[str]:
        """Return the blocks that call compiled functions of a module, through other compiled ones, too."""
        names: set[str] = set()
        left = [kernels]
        while left:
            module = left.pop()
            own = {node.name for node in module.tree.body if isinstance(node, ast.FunctionDef)} - names
            names |= own
            stem = Path(module.path).stem
            compiled = (other for other in self.modules.values() if is_compiled(other.path))
            left += [other for other in compiled if own and stem in other.imported]
        plain = [module for module in self.modules.values() if not is_compiled(module.path)]
        return set[str]().union(*(module.reads[name] for module in plain for name in names & module.imported))

    def readers(self, module: Module, name: str) -> set[str]:
        """Return the blocks that read a module's constant or field: in the module, and where it is imported."""
        found = set(module.reads[name])
        stem = Path(module.path).stem
        for other in self.modules.values():
            if other is not module and (name in other.imported or stem in other.imported):
                found |= other.reads[name]
        return found
