"""Measure the structure of the project's own code from its source text and print 'what | now | aim'.

`python .make/house.py` exits with 1 where an aim is missed; `--list WHAT` prints the offenders of each row whose name
holds WHAT. A room is a module or package right below a package; a floor is a step of the longest way down through the
rooms' imports; an arrow is a pair of rooms of which one imports the other, be it for type checking alone or within a
function. A face is a package's `__init__`: who takes a name from it depends on the module that the name comes from.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import sys
import tokenize
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from house_graph import (
    PACKAGE,
    Graph,
    Source,
    all_arrows,
    arrows_up,
    assigned,
    circles,
    heights,
    imports_of,
    listed,
    read_sources,
    room_of,
    rooms_graph,
    strings_in,
)

NOT_ENTRIES = {"__init__.py", "__main__.py", "__pycache__", "py.typed"}
CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]+")
GETTERS = {"property", "cached_property", "abstractproperty", "setter"}
NO_VERBS = frozenset(
    "a an the this that these those its their all any each every both either no none one two three some such same "
    "other whether if how what which who whom whose when where why by see in on at of for from to with within without "
    "between above below after before as per about against along beside under over until while because only not "
    "i we you they it he she there here nothing everything something".split()
)
VERBS_IN_S = frozenset({"bias", "focus", "canvas"})  # and all in 'ss': pass, process, express …

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Measure:
    """One row: what is counted, how many there are now, how many there may be (None: just told), and which they are."""

    what: str
    now: int
    aim: int | None
    offenders: tuple[str, ...] = ()

    @property
    def met(self) -> bool:
        """Whether the aim holds."""
        return self.aim is None or self.now <= self.aim


def none_of(what: str, offenders: Iterable[str]) -> Measure:
    """Return the row of something of which there should be none."""
    found = tuple(sorted(offenders))
    return Measure(what, len(found), 0, found)


def entries(root: Path) -> list[str]:
    """Return what a listing of the package shows: modules, folders that hold files, data; not `NOT_ENTRIES`."""

    def counts(path: Path) -> bool:
        if path.name in NOT_ENTRIES or path.name.startswith("."):
            return False
        return path.is_file() or any(p.is_file() and "__pycache__" not in p.parts for p in path.rglob("*"))

    return sorted(path.name for path in (root / PACKAGE).iterdir() if counts(path))


def floors(what: str, graph: Graph, aim: int) -> Measure:
    """Return the row about the number of floors, with what stands on each."""
    on = heights(graph)
    highest = max(on.values(), default=0)
    told = (f"{floor}: {', '.join(sorted(n for n in on if on[n] == floor))}" for floor in range(highest, 0, -1))
    return Measure(what, highest, aim, tuple(told))


def structure(root: Path, sources: Mapping[str, Source]) -> Iterator[Measure]:
    """Yield the rows about rooms, floors, arrows and circles."""
    arrows = all_arrows(sources)
    files: dict[str, set[str]] = {module: set() for module in sources}
    for arrow in arrows:
        files[arrow.source] |= {arrow.home} - {arrow.source}
    rooms = rooms_graph(sources, arrows, PACKAGE)
    pairs = tuple(f"{a} → {b}" for a in sorted(rooms) for b in sorted(rooms[a]))
    found = tuple(entries(root))
    yield Measure("entries of twin_diagram/", len(found), 18, found)
    yield Measure("rooms", len(rooms), None, tuple(sorted(rooms)))
    yield floors("floors of rooms", rooms, 8)
    yield Measure("arrows between rooms", len(pairs), 100, pairs)
    yield none_of("arrows up between rooms", (f"{a} → {b}" for a, b in arrows_up(rooms)))
    yield none_of("rooms in circles", (name for circle in circles(rooms) for name in circle))
    yield none_of("files in circles", (sources[name].path for circle in circles(files) for name in circle))
    for name, aim in (("gap", 7), ("estimation", 5)):
        inner = rooms_graph(sources, arrows, f"{PACKAGE}.{name}")
        yield floors(f"floors of {name}/", inner, aim)
        yield none_of(f"rooms of {name}/ in circles", (room for circle in circles(inner) for room in circle))


# Names.


def at_import(body: Iterable[ast.stmt]) -> Iterator[ast.stmt]:
    """Yield the statements that importing a module runs, those under `if`, `try` and `with` included."""
    for node in body:
        yield node
        typing_only = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        if isinstance(node, (ast.If, ast.Try, ast.With, ast.For)):
            for field in ("body", "orelse", "finalbody"):
                if not (typing_only and field == "body"):
                    yield from at_import(getattr(node, field, []))
            for handler in getattr(node, "handlers", []):
                yield from at_import(handler.body)


def loaded(source: Source, sources: Mapping[str, Source], seen: set[str]) -> set[str]:
    """Return the own modules that importing a module loads, with their packages."""
    for target, _ in imports_of(source, at_import(source.tree.body), sources):
        while target not in seen and target != PACKAGE:
            seen.add(target)
            loaded(sources[target], sources, seen)
            target = target.rpartition(".")[0]
    return seen


def tells_what_it_shows(face: Source) -> bool:
    """Return true if a face has a `__dir__`, be it defined or assigned, alone or beside `__getattr__`."""
    stored = (node for node in face.nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store))
    made = {node.name for node in face.tree.body if isinstance(node, ast.FunctionDef)}
    return "__dir__" in made | {node.id for node in stored}


def names_shown(sources: Mapping[str, Source]) -> set[str]:
    """Return the public names that `dir(twin_diagram)` shows after its import, which are no part of what it offers."""
    face = sources[PACKAGE]
    if tells_what_it_shows(face):
        return set()  # `dir` shows what the face says; tests/test_faces.py asks it
    bound = {room_of(module, PACKAGE) for module in loaded(face, sources, set())}  # each is put into its package
    gone: set[str] = set()
    for node in at_import(face.tree.body):
        if isinstance(node, (ast.Import, ast.ImportFrom)) and getattr(node, "module", "") != "__future__":
            whole = isinstance(node, ast.ImportFrom)
            bound |= {alias.asname or (alias.name if whole else alias.name.split(".")[0]) for alias in node.names}
        elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            bound.add(node.name)
        elif isinstance(node, ast.Delete):
            gone |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    bound |= {name for name, _, _ in assigned(at_import(face.tree.body))}
    return {name for name in bound - gone - listed(face) if not name.startswith("_")}


def decorators(node: ast.ClassDef | Function) -> set[str]:
    """Return the last parts of a definition's decorators' names."""
    plain = (part.func if isinstance(part, ast.Call) else part for part in node.decorator_list)
    return {ast.unparse(part).split(".")[-1] for part in plain}


def effect_names(sources: Mapping[str, Source]) -> list[str]:
    """Return the names of the catalogue: of classes below a package `effects` that are decorated with `register`."""
    names = []
    for source in sources.values():
        if "effects" in source.module.split("."):
            for node in source.nodes:
                if isinstance(node, ast.ClassDef) and "register" in decorators(node):
                    names += [s for name, _, value in assigned(node.body) if name == "name" for s in strings_in(value)]
    return sorted(set(names))


def literals(source: Source) -> set[str]:
    """Return the strings that stand in a module as literals: no docstrings, no text of f-strings."""
    no_literals: set[int] = set()
    found = []
    for node in source.nodes:
        if isinstance(node, ast.Expr):
            no_literals.add(id(node.value))
        elif isinstance(node, ast.JoinedStr):
            no_literals.update(map(id, node.values))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.append(node)
    return {str(node.value) for node in found if id(node) not in no_literals}


def defined(sources: Mapping[str, Source], kind: type | tuple[type, ...]) -> dict[str, list[str]]:
    """Return where each public class or function stands at the level of a module."""
    places: dict[str, list[str]] = defaultdict(list)
    for source in sources.values():
        for name in {node.name for node in source.tree.body if isinstance(node, kind)}:  # type: ignore[attr-defined]
            if not name.startswith("_"):
                places[name].append(source.path)
    return places


def naming(sources: Mapping[str, Source]) -> Iterator[Measure]:
    """Yield the rows about names: shown ones, effects', and those that stand for several things."""
    yield none_of("names shown beside __all__", names_shown(sources))
    said = {source.path: literals(source) for source in sources.values()}
    for name in effect_names(sources):
        places = tuple(path for path, strings in said.items() if name in strings)
        # A filter's block of parameters and a field of scenarios are called payload as well.
        yield Measure(f"files naming {name}", len(places), None if name == "payload" else 2, places)
    classes = {name: places for name, places in defined(sources, ast.ClassDef).items() if len(places) > 1}
    classes.pop("Tuning", None)  # each module's own constants
    yield none_of("class names of several modules", (f"{name}: {', '.join(p)}" for name, p in classes.items()))
    functions = sorted(defined(sources, (ast.FunctionDef, ast.AsyncFunctionDef)).items())
    often = tuple(f"{name}: {', '.join(p)}" for name, p in functions if len(p) > 3)
    yield Measure("function names of over 3 modules", len(often), None, often)
    tests = (s.path for s in sources.values() if re.search(r"(^|/)(test_[^/]*|[^/]*_test)\.py$", s.path))
    yield none_of("product modules named like tests", tests)


# Sizes, constants and words.


def sizes(root: Path, sources: Mapping[str, Source]) -> Iterator[Measure]:
    """Yield the rows about lengths: functions, constructors, modules, scripts."""
    long, wide = [], []
    for source in sources.values():
        for node in source.nodes:
            if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                lines = (node.end_lineno or node.lineno) - node.lineno + 1  # from `def`, not from the decorators
                if lines > 60:
                    long.append(f"{source.path}:{node.lineno}: {node.name} ({lines})")
            elif isinstance(node, ast.ClassDef):
                for part in node.body:
                    if isinstance(part, ast.FunctionDef) and part.name == "__init__":
                        count = len([*part.args.posonlyargs, *part.args.args, *part.args.kwonlyargs]) - 1
                        if count > 8:
                            wide.append(f"{source.path}:{part.lineno}: {node.name} ({count})")
    yield none_of("functions over 60 lines", long)
    yield none_of("constructors over 8 arguments", wide)
    lengths = {source.path: len(source.text.splitlines()) for source in sources.values()}
    yield none_of("modules over 400 lines", (f"{path} ({n})" for path, n in lengths.items() if n > 400))
    scripts = {path.name: len(path.read_text(encoding="utf-8").splitlines()) for path in (root / "sims").glob("*.py")}
    yield none_of("scripts of sims/ over 60 lines", (f"sims/{name} ({n})" for name, n in scripts.items() if n > 60))


def explained(source: Source) -> set[int]:
    """Return the lines of the assignments with a string behind them, a comment on their lines, or one right above."""
    beside: set[int] = set()
    above: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source.text).readline):
        if token.type == tokenize.COMMENT:
            (above if token.line.lstrip().startswith("#") else beside).add(token.start[0])
    tunings = [node.body for node in source.tree.body if isinstance(node, ast.ClassDef) and node.name == "Tuning"]
    lines = set()
    for node, after in (
        pair for body in (source.tree.body, *tunings) for pair in zip(body, [*body[1:], None], strict=False)
    ):
        said = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and bool(strings_in(after))
        own = set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
        if said or own & (beside | above) or node.lineno - 1 in above:
            lines.add(node.lineno)
    return lines


def constants(sources: Mapping[str, Source]) -> Iterator[Measure]:
    """Yield the rows about what modules assign: upper-case constants and the type `Array`."""
    every, fields, bare, arrays = [], [], [], []
    for source in sources.values():
        reasons = explained(source)
        for name, node, _ in assigned(source.tree.body):
            place = f"{source.path}:{node.lineno}: {name}"
            if name == "Array":
                arrays.append(place)
            elif CONSTANT.fullmatch(name):
                every.append(place)
                bare += [] if node.lineno in reasons or name == "TUNING" else [place]
        for tuning in (node for node in source.tree.body if isinstance(node, ast.ClassDef) and node.name == "Tuning"):
            for name, node, _ in assigned(tuning.body):
                fields.append(f"{source.path}:{node.lineno}: {name}")
                bare += [] if node.lineno in reasons else fields[-1:]
    yield Measure("upper-case constants", len(every), None, tuple(every))
    yield Measure("constants in a Tuning", len(fields), None, tuple(fields))
    yield none_of("constants without a reason", bare)
    yield Measure("definitions of Array", len(arrays), 1, tuple(arrays))


def begins_with_verb(docstring: str) -> bool:
    """Guess whether a docstring's first word is a verb: no article and the like, no number, not in -s ('Returns')."""
    if docstring.startswith("See `"):
        return True  # an override, whose law is told where it is declared
    word = docstring.split(maxsplit=1)[0].rstrip(".,:;").lower() if docstring.strip() else ""
    if not word or not word[0].isalpha() or word in NO_VERBS:
        return False
    return not word.endswith("s") or word.endswith("ss") or word in VERBS_IN_S


def public_functions(body: Iterable[ast.stmt]) -> Iterator[Function]:
    """Yield a module's public functions and its public classes' public methods, properties left out."""
    for node in body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from public_functions(node.body)
        elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            if not node.name.startswith("_") and not decorators(node) & GETTERS:
                yield node


def words(sources: Mapping[str, Source]) -> Iterator[Measure]:
    """Yield the row about docstrings."""
    wrong = []
    for source in sources.values():
        for node in public_functions(source.tree.body):
            said = ast.get_docstring(node)
            if said and not begins_with_verb(said):
                wrong.append(f"{source.path}:{node.lineno}: {node.name}: {said.splitlines()[0]}")
    yield none_of("docstrings without a verb first", wrong)


def measure(root: Path) -> list[Measure]:
    """Return all rows about a checkout."""
    sources = read_sources(root)
    return [
        *structure(root, sources),
        *naming(sources),
        *sizes(root, sources),
        *constants(sources),
        *words(sources),
    ]


def main(arguments: list[str] | None = None) -> int:
    """Print the table, or the offenders of the rows asked for; return 1 where one of them misses its aim."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--list", metavar="WHAT", help="print each offender of the rows whose name holds WHAT")
    parser.add_argument("root", nargs="?", type=Path, default=Path(__file__).resolve().parent.parent)
    options = parser.parse_args(arguments)
    rows = [row for row in measure(options.root) if (options.list or "") in row.what]
    if not rows:
        parser.error(f"no row's name holds {options.list!r}; without --list all of them are printed")
    width = max(len(row.what) for row in rows)
    print(f"{'what':{width}} | {'now':>4} | aim")
    for row in rows:
        aim = "–" if row.aim is None else f"≤ {row.aim}" if row.aim else "0"
        print(f"{row.what:{width}} | {row.now:4} | {aim}{'' if row.met else '  missed'}")
        for offender in row.offenders if options.list is not None else ():
            print(f"    {offender}")
    return 0 if all(row.met for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
