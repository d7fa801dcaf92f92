"""Places of a module's source where a fault can be put, and the faults: a text in the place of another."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass

SILENT_FUNCTIONS = {"__repr__", "__str__", "__format__", "sentence", "sentences", "title", "words", "describe", "say"}
"""Functions that make words: nothing in them is mutated."""
SILENT_CALLS = {"print", "say", "warn", "debug", "info", "warning", "error", "exception", "log", "field_words"}
NO_SWAP = {"isinstance", "issubclass", "getattr", "setattr", "hasattr", "cast", "replace", "zip", "field"} | {
    *("min", "max", "minimum", "maximum", "hypot", "isclose", "allclose", "array_equal", "logical_and", "logical_or")
}
"""Calls whose arguments are not swapped: symmetric ones, and those where it is only a type error."""
SHAPE_CALLS = {
    *("range", "reshape", "zeros", "ones", "empty", "full", "eye", "identity", "arange", "linspace", "repeat", "roll"),
    *("tile", "split", "array_split", "moveaxis", "swapaxes", "transpose", "expand_dims", "stack", "concatenate"),
}
SHAPE_KEYWORDS = {"axis", "shape", "size", "ndmin", "ndim", "maxlen", "maxsize", "decimals"}
COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.GtE),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.LtE),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
}
OPPOSITES = {"min": "max", "minimum": "maximum", "any": "all", "argmin": "argmax", "nanmin": "nanmax"}
OPPOSITES |= {there: here for here, there in OPPOSITES.items()}
STRINGS = (ast.JoinedStr, ast.List, ast.Tuple, ast.ListComp)


@dataclass(frozen=True)
class Change:
    """One fault that can be put at a site."""

    operator: str
    text: str


@dataclass(frozen=True)
class Site:
    """A place in a source: its span in bytes, and what can be put there."""

    line: int
    begin: int
    end: int
    before: str
    changes: tuple[Change, ...]


def sites(source: str) -> list[Site]:
    """Return the sites of a module's `source`, in the order of the text."""
    starts = [0]
    for text in source.encode().splitlines(keepends=True):
        starts.append(starts[-1] + len(text))
    found = []
    for node, trail in walk(ast.parse(source), ()):
        changes = tuple(change for change in changes_of(node, trail) if change.text != ast.unparse(node))
        if changes:
            where: ast.expr | ast.stmt = node.func if isinstance(node, ast.Call) and swaps_name(changes) else node
            end = starts[(where.end_lineno or 1) - 1] + (where.end_col_offset or 0)
            begin = starts[where.lineno - 1] + where.col_offset
            found.append(Site(where.lineno, begin, end, ast.unparse(where), changes))
    return sorted(found, key=lambda site: (site.begin, -site.end))


def swaps_name(changes: tuple[Change, ...]) -> bool:
    """Return true where a call's function is replaced, not the call."""
    return changes[0].operator == "opposite"


def mutated(source: str, site: Site, change: Change) -> str:
    """Return the source with one fault in it."""
    text = source.encode()
    return (text[: site.begin] + change.text.encode() + text[site.end :]).decode()


Trail = tuple[tuple[ast.AST, str], ...]


def walk(node: ast.AST, trail: Trail) -> Iterator[tuple[ast.expr | ast.stmt, Trail]]:
    """Yield each node that may be changed, with the nodes above it and the fields that lead down to it."""
    if isinstance(node, ast.expr | ast.stmt):
        yield node, trail
    for name, value in ast.iter_fields(node):
        if skipped(node, name):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not silent(child):
                yield from walk(child, (*trail, (node, name)))


def skipped(node: ast.AST, name: str) -> bool:
    """Return true for fields that hold types or messages."""
    return name in {"annotation", "returns", "decorator_list"} or (isinstance(node, ast.Assert) and name == "msg")


def silent(node: ast.AST) -> bool:
    """Return true for what says something and computes nothing."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return node.name in SILENT_FUNCTIONS
    if isinstance(node, ast.If):
        return any(word in ast.unparse(node.test) for word in ("TYPE_CHECKING", "__name__"))
    if isinstance(node, ast.Call):
        return name_of(node.func) in SILENT_CALLS
    return isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom)


def name_of(node: ast.expr) -> str:
    """Return the last part of a dotted name."""
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def changes_of(node: ast.expr | ast.stmt, trail: Trail) -> Iterator[Change]:
    """Yield the faults that can be put in the place of a node."""
    if isinstance(node, ast.Constant):
        yield from constants(node, trail)
    elif isinstance(node, ast.Compare):
        yield from comparisons(node)
    elif isinstance(node, ast.BinOp):
        yield from terms(node)
    elif isinstance(node, ast.AugAssign) and isinstance(node.op, ast.Add | ast.Sub) and not worded(node.value):
        other = "-" if isinstance(node.op, ast.Add) else "+"
        yield Change("sign", f"{ast.unparse(node.target)} {other}= {ast.unparse(node.value)}")
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub) and not axis(node, trail):
        yield Change("unary minus", f"({ast.unparse(node.operand)})")
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield Change("not", f"({ast.unparse(node.operand)})")
    elif isinstance(node, ast.BoolOp):
        op: ast.boolop = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield Change("and/or", f"({ast.unparse(ast.BoolOp(op, node.values))})")
    elif isinstance(node, ast.Call):
        yield from calls(node)


def constants(node: ast.Constant, trail: Trail) -> Iterator[Change]:
    """Yield half and double of a number: of each float, and of integers that multiply, divide or are powers."""
    value = node.value
    if isinstance(value, float) and abs(value) not in (0.0, float("inf")):
        yield Change("constant", repr(2 * value))
        yield Change("constant", repr(value / 2))
    elif isinstance(value, int) and not isinstance(value, bool) and value and trail and not indexing(trail):
        above, field = trail[-1]
        op = above.op if isinstance(above, ast.BinOp) else None
        if isinstance(op, ast.Pow) and field == "right":
            yield Change("constant", repr(value + 1))
        elif isinstance(op, ast.Mult | ast.Div | ast.Pow) and not worded(above):
            yield Change("constant", repr(2 * value))
            yield Change("constant", repr(value // 2 if value % 2 == 0 else value / 2))


def axis(node: ast.UnaryOp, trail: Trail) -> bool:
    """Return true for a −1 that counts from the end."""
    return isinstance(node.operand, ast.Constant) and isinstance(node.operand.value, int) and indexing(trail)


def indexing(trail: Trail) -> bool:
    """Return true inside an index, a shape or an axis."""
    for node, field in trail:
        if isinstance(node, ast.Subscript) and field == "slice":
            return True
        if isinstance(node, ast.keyword) and node.arg in SHAPE_KEYWORDS:
            return True
        if isinstance(node, ast.Call) and field == "args" and name_of(node.func) in SHAPE_CALLS:
            return True
    return False


def comparisons(node: ast.Compare) -> Iterator[Change]:
    """Yield the comparison with one of its operators changed."""
    for index, op in enumerate(node.ops):
        for other in COMPARISONS.get(type(op), ()):
            ops = [*node.ops[:index], other(), *node.ops[index + 1 :]]
            yield Change("comparison", f"({ast.unparse(ast.Compare(node.left, ops, node.comparators))})")


def worded(node: ast.AST) -> bool:
    """Return true where a sum or product is plainly one of texts or lists."""
    if isinstance(node, ast.BinOp):
        return worded(node.left) or worded(node.right)
    return isinstance(node, STRINGS) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def terms(node: ast.BinOp) -> Iterator[Change]:
    """Yield a sum with its sign changed, and a sum or product without its second term."""
    if worded(node):
        return
    if isinstance(node.op, ast.Add | ast.Sub):
        op: ast.operator = ast.Sub() if isinstance(node.op, ast.Add) else ast.Add()
        yield Change("sign", f"({ast.unparse(ast.BinOp(node.left, op, node.right))})")
    if isinstance(node.op, ast.Add | ast.Sub | ast.Mult):
        yield Change("dropped term", f"({ast.unparse(node.left)})")


def calls(node: ast.Call) -> Iterator[Change]:
    """Yield the opposite of min, max, any and all; else the call with two neighbouring arguments swapped."""
    name = name_of(node.func)
    if name in OPPOSITES:
        yield Change("opposite", ast.unparse(node.func)[: -len(name)] + OPPOSITES[name])
    elif name not in NO_SWAP:
        for index, (one, two) in enumerate(zip(node.args, node.args[1:], strict=False)):
            named = isinstance(one, ast.Name | ast.Attribute) and isinstance(two, ast.Name | ast.Attribute)
            if named and ast.unparse(one) != ast.unparse(two):
                arguments = [*node.args[:index], two, one, *node.args[index + 2 :]]
                yield Change("swapped arguments", ast.unparse(ast.Call(node.func, arguments, node.keywords)))
