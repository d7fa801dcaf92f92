"""Tells of each field of a scenario what it means, in which unit, and what it is by default."""

from __future__ import annotations

import ast
import difflib
import inspect
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import MISSING, Field, fields, is_dataclass
from functools import cache
from typing import Any, NamedTuple, TypeVar, get_args, get_type_hints

from twin_diagram.errors import ScenarioError

Section = TypeVar("Section")
"""A dataclass of the scenario."""


class Row(NamedTuple):
    """One field of a scenario.

    Attributes:
        name: within its section.
        kind: its type, as in Python.
        default: as in YAML; `…` for a section, `required` where there is none.
        meaning: with the unit in brackets.
    """

    name: str
    kind: str
    default: str
    meaning: str


@cache
def meanings(cls: type) -> dict[str, str]:
    """Return the text below each field of a dataclass, on one line."""
    source = inspect.getsource(sys.modules[cls.__module__])
    found: dict[str, str] = {}
    for node in ast.parse(source).body:
        if isinstance(node, ast.ClassDef) and node.name == cls.__name__:
            for field, text in zip(node.body, node.body[1:], strict=False):
                if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
                    value = ast.literal_eval(text.value)
                    found[ast.unparse(field.target)] = " ".join(str(value).split())
    return found


def rows(cls: type) -> list[Row]:
    """Return a row for each field of a section of the scenario.

    Args:
        cls: a dataclass of `twin_diagram.scenario`.
    """
    hints = get_type_hints(cls)
    told = meanings(cls)
    return [Row(f.name, _kind(hints[f.name]), _default(f), told.get(f.name, "")) for f in fields(cls)]


def table(rows: Iterable[Row]) -> str:
    """Return fields as text, two lines each."""
    return "\n".join(f"{row.name}: {row.kind} = {row.default}\n    {row.meaning}" for row in rows)


def rows_at(root: type, path: str) -> list[Row]:
    """Return the fields that a dotted path leads to: those of a section, or the one that it names.

    Args:
        root: where the path begins.
        path: names joined by dots, as in ``twin.filter``; it goes on into the entries of lists and mappings
            (``world.objects.X_WO``); empty: the root's own fields.

    Raises:
        ScenarioError: there is no such field; the message lists what there is.
    """
    here: type | None = root
    found: list[Row] = []
    names = path.split(".") if path else []
    for k, name in enumerate(names):
        here_fields = {} if here is None else {row.name: row for row in rows(here)}
        if here is None or name not in here_fields:
            there = nearest(name, here_fields) if here_fields else f"{names[k - 1]} has no fields of its own"
            raise ScenarioError(".".join(names[: k + 1]), f"no such field; {there}")
        found = [here_fields[name]]
        here = next(sections(get_type_hints(here)[name]), None)
    return found if here is None else rows(here)


def nearest(name: str, known: Iterable[str]) -> str:
    """Return what may have been meant by a name that is none of those that are known, or these."""
    known = list(known)
    near = difflib.get_close_matches(name, known, n=1)
    return f"did you mean {near[0]!r}?" if near else f"it is one of {', '.join(known)}"


def sections(kind: Any) -> Iterator[type]:
    """Yield the dataclasses that a field's type holds, such as those of a list's entries."""
    if isinstance(kind, type) and is_dataclass(kind):
        yield kind
    for part in get_args(kind):
        yield from sections(part)


def document(cls: type[Section]) -> type[Section]:
    """Return a dataclass whose docstring, which `help` shows, tells of each field."""
    cls.__doc__ = f"{(cls.__doc__ or '').rstrip()}\n\nFields, in a scenario or as keywords:\n\n{table(rows(cls))}\n"
    return cls


def _kind(kind: Any) -> str:
    text = kind.__name__ if isinstance(kind, type) and not get_args(kind) else str(kind)
    return re.sub(r"(?:\w+\.)+(\w+)", r"\1", text).replace("NoneType", "None")


def _default(field: Field[Any]) -> str:
    if field.default is not MISSING:
        return _yaml(field.default)
    if field.default_factory is not MISSING:
        return _yaml(field.default_factory())
    return "required"


def _yaml(value: Any) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return repr(value) if value else "''"
    return "…" if is_dataclass(value) else str(value)
