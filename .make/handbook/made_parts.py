"""The parts of the handbook that are made of the code: fields, commands, ports, effects, words.

A page asks for one by a block of code in the language `{made}`, whose one line says which: ``ports MODULE:CLASS``,
``effect NAME``, ``fields``, ``commands``, ``words``. Each is Markdown.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import math
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import get_type_hints

from twin_diagram.cli import _parser
from twin_diagram.gap.candidates.records import record_of
from twin_diagram.model.effects import REGISTRY, ParameterKind
from twin_diagram.scenario import Scenario
from twin_diagram.scenario.field_table import rows, sections

CHECKOUT = Path(__file__).resolve().parent.parent.parent
BLOCK = re.compile(r"^```\{made\}\n(.*?)\n```$", re.MULTILINE | re.DOTALL)


def expand(page: str) -> str:
    """Return a page with its made parts in place.

    Raises:
        ValueError: a part is asked for that there is not.
    """
    return BLOCK.sub(lambda match: made(match.group(1)), page)


def made(line: str) -> str:
    """Return one part.

    Args:
        line: what is asked for, and of what.

    Raises:
        ValueError: there is no such part.
    """
    kind, _, rest = line.strip().partition(" ")
    if kind not in PARTS:
        raise ValueError(f"{{made}} {line}: there is {', '.join(PARTS)}")
    return PARTS[kind](rest)


def table(head: Iterable[str], lines: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table."""
    head = list(head)
    cells = [head, ["---"] * len(head), *(list(line) for line in lines)]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in cells) + "\n"


def ports(place: str) -> str:
    """Return a system's ports and what its docstring says below them.

    Args:
        place: ``module:Class``.
    """
    module, _, name = place.partition(":")
    text = inspect.getdoc(getattr(importlib.import_module(module), name)) or ""
    head, block, below = text.partition(".. pydrake_system::")
    if not block:
        raise ValueError(f"{place} shows no ports")
    lines = below.strip("\n").splitlines()
    count = next((k for k, line in enumerate(lines) if line and not line.startswith(" ")), len(lines))
    sides: dict[str, list[str]] = {}
    for line in lines[:count]:
        if found := re.match(r"\s+(input|output)_ports:", line):
            side = sides.setdefault(found.group(1), [])
        elif found := re.match(r"\s+- (.+)", line):
            side.append(found.group(1))
    told, rest = _told_ports(lines[count:])
    shown = [
        (
            side,
            f"`{port.removesuffix(' (optional)')}`" + (" (optional)" if "optional" in port else ""),
            told.get(key, ""),
        )
        for side, names in sides.items()
        for port in names
        for key in [port.removesuffix(" (optional)")]
    ]
    columns = 3 if told else 2
    head_cells = ("", "port", "what it carries")[:columns]
    summary = head.strip().splitlines()[0]
    return (
        f"**`{name}`**: {summary[0].lower()}{summary[1:]}\n\n{table(head_cells, (x[:columns] for x in shown))}\n{rest}"
    )


def _told_ports(lines: list[str]) -> tuple[dict[str, str], str]:
    """Return what a docstring's ``Ports:`` says of each, and its other paragraphs; ``Attributes:`` are left out."""
    told: dict[str, str] = {}
    rest: list[str] = []
    section, last = "", ""
    for line in lines:
        if re.match(r"(Ports|Attributes|Args|Raises):$", line):
            section = line
        elif line and not line.startswith(" "):
            section = ""
        if not section:
            rest.append(line)
        elif section == "Ports:" and (found := re.match(r"    (\w+): (.+)", line)):
            last = found.group(1)
            told[last] = found.group(2)
        elif section == "Ports:" and line.strip() and last:
            told[last] += " " + line.strip()
    return told, "\n".join(rest).strip() + "\n"


def effect(name: str) -> str:
    """Return what the catalogue says of an effect: its picture, in words, and its parameters."""
    cls, record = REGISTRY[name], record_of(name)
    doc = inspect.getdoc(cls) or ""
    lines = [(f"`{key}`", _unit(kind), _bounds(kind), _default(kind), kind.help) for key, kind in cls.kinds.items()]
    where = "joints" if cls.per_joint or name == "coupled_friction" else "links" if _on_links(name) else "the whole arm"
    woken = ", ".join(sorted(wakes.value for wakes in record.wakes))
    return (
        f"**{record.title}.** {record.explanation}\n\n![{record.title}](pictures/effects/{name}.svg)\n\n{doc}\n\n"
        f"Sits on {where}. What brings it out: {woken}.\n\n"
        + table(("parameter", "unit", "bounds", "default", ""), lines)
    )


def _on_links(name: str) -> bool:
    return name in ("payload", "inertial_parameters", "external_force")


def _unit(kind: ParameterKind) -> str:
    size = f" ({kind.size})" if kind.size not in (None, 1) else ""
    return f"{kind.unit}{size}"


def _bounds(kind: ParameterKind) -> str:
    low, high = kind.lower, kind.upper
    text = f"≥ {low:g}" if math.isfinite(low) and not math.isfinite(high) else f"{low:g} to {high:g}"
    if not math.isfinite(low) and not math.isfinite(high):
        text = "any"
    return text + ("; less, where the description states some" if kind.lessens else "")


def _default(kind: ParameterKind) -> str:
    if kind.default is not None:
        return f"{kind.default:g}"
    return "one form or the other" if kind.optional else "must be given"


def fields(_: str) -> str:
    """Return all fields of scenarios, section by section, top down."""
    return "\n".join(
        f"## `{path}`\n\n{_summary(cls)}\n\n"
        + table(
            ("field", "type", "default", "means"),
            ((f"`{row.name}`", f"`{row.kind}`", f"`{row.default}`", _plain(row.meaning)) for row in rows(cls)),
        )
        for path, cls in walk()
    )


def walk() -> Iterator[tuple[str, type]]:
    """Yield each section of a scenario once, with the first path that leads to it, near ones first."""
    waiting: list[tuple[str, type]] = [("scenario", Scenario)]
    seen: set[type] = set()
    while waiting:
        path, cls = waiting.pop(0)
        if cls in seen:
            continue
        seen.add(cls)
        yield path, cls
        before = "" if cls is Scenario else f"{path}."
        waiting += [(before + name, inner) for name, kind in get_type_hints(cls).items() for inner in sections(kind)]


def _summary(cls: type) -> str:
    return (inspect.getdoc(cls) or "").split("\n\n")[0].replace("\n", " ")


def _plain(text: str) -> str:
    """Return a docstring's text as Markdown: angle brackets are no HTML."""
    return text.replace("<", "&lt;").replace("``", "`")


def commands(_: str) -> str:
    """Return every command with its arguments."""
    (choices,) = [action for action in _parser()._actions if isinstance(action, argparse._SubParsersAction)]
    helps = {action.dest: action.help or "" for action in choices._choices_actions}
    return "\n".join(_command(name, parser, helps.get(name, "")) for name, parser in choices.choices.items())


def _command(name: str, parser: argparse.ArgumentParser, summary: str) -> str:
    lines = []
    for action in parser._actions:
        if isinstance(action, argparse._HelpAction) or action.help == argparse.SUPPRESS:
            continue
        flag = action.option_strings[-1] if action.option_strings else str(action.metavar or action.dest)
        value = f" {action.metavar or action.dest.upper()}" if action.option_strings and action.nargs != 0 else ""
        said = (action.help or "").replace("%(default)s", str(action.default)).replace("%%", "%")
        lines.append((f"`{flag}{value}`", said + ("" if action.required is False else " (required)")))
    return f"## `twin-diagram {name}`\n\n{summary[:1].upper()}{summary[1:]}.\n\n{table(('argument', 'means'), lines)}"


def words(_: str) -> str:
    """Return the words of CONTRIBUTING as a list of definitions."""
    text = (CHECKOUT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    section = text.split("\n## Words\n")[1].split("\n## ")[0]
    entries = re.findall(r"^\| (?!word )(?!---)(.+?) \| (.+) \|$", section, re.MULTILINE)
    return "\n".join(f"{word}\n: {meaning[0].upper()}{meaning[1:]}.\n" for word, meaning in entries)


PARTS: dict[str, Callable[[str], str]] = {
    "ports": ports,
    "effect": effect,
    "fields": fields,
    "commands": commands,
    "words": words,
}
