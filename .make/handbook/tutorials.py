"""Tutorials as notebooks, from one source: a page's blocks of Python are its cells, in order, in one namespace.

A block of `text` right after a cell is what the cell prints: numbers may differ a little from machine to machine, words
may not. A picture that a cell draws with Matplotlib is shown below it when the pages are built.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

CELL = re.compile(r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```\n)?", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])[−-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
SHARE, LEAST = 0.1, 2e-3
"""By which a number that is printed may differ from the one on the page: of itself, and at least."""


@dataclass(frozen=True)
class Cell:
    """One piece of a tutorial.

    Attributes:
        code: Python; empty for prose.
        text: prose as Markdown; of code, what it prints.
    """

    code: str
    text: str


def cells(page: str) -> list[Cell]:
    """Return a page's prose and code, in order."""
    found: list[Cell] = []
    end = 0
    for match in CELL.finditer(page):
        if prose := page[end : match.start()].strip():
            found.append(Cell("", prose))
        found.append(Cell(match.group(1), match.group(2) or ""))
        end = match.end()
    if prose := page[end:].strip():
        found.append(Cell("", prose))
    return found


def notebook(page: str) -> str:
    """Return a page as a Jupyter notebook, format 4.5."""
    made = []
    for k, cell in enumerate(cells(page)):
        if not cell.code:
            made.append({"id": f"cell-{k}", "cell_type": "markdown", "metadata": {}, "source": cell.text})
            continue
        shown = [{"output_type": "stream", "name": "stdout", "text": cell.text}] if cell.text else []
        made.append(
            {
                "id": f"cell-{k}",
                "cell_type": "code",
                "metadata": {},
                "execution_count": None,
                "source": cell.code.rstrip("\n"),
                "outputs": shown,
            }
        )
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    whole = {"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(whole, ensure_ascii=False, indent=1) + "\n"


def run(code: list[str], folder: Path, pictures: Path | None = None) -> list[str]:
    """Run cells in order in one namespace; return what each prints.

    Args:
        code: of the cells.
        folder: in which they run.
        pictures: where what a cell draws is written, by the cell's number.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    folder, pictures = folder.resolve(), pictures and pictures.resolve()
    namespace: dict[str, Any] = {"__name__": "__main__"}
    printed: list[str] = []
    before = Path.cwd()
    os.chdir(folder)
    try:
        for k, text in enumerate(code):
            told = io.StringIO()
            with contextlib.redirect_stdout(told):
                exec(compile(text, f"cell {k}", "exec"), namespace)
            printed.append(told.getvalue())
            for number in pyplot.get_fignums():
                if pictures is not None:
                    pyplot.figure(number).savefig(pictures / f"cell_{k}.svg", bbox_inches="tight")
            pyplot.close("all")
    finally:
        os.chdir(before)
    return printed


def difference(page: str, printed: str) -> str:
    """Return in one line where a cell's print differs from what the page says; empty where it does not."""
    wanted, got = page.strip().splitlines(), printed.strip().splitlines()
    if len(wanted) != len(got):
        return f"{len(got)} lines instead of {len(wanted)}: {printed!r}"
    for left, right in zip(wanted, got, strict=True):
        if NUMBER.sub("#", left).split() != NUMBER.sub("#", right).split():
            return f"{right!r} instead of {left!r}"
        for a, b in zip(_numbers(left), _numbers(right), strict=True):
            if abs(a - b) > max(SHARE * abs(a), LEAST):
                return f"{right!r} instead of {left!r}"
    return ""


def _numbers(line: str) -> list[float]:
    return [float(text.replace("−", "-")) for text in NUMBER.findall(line)]


def check(page: str, folder: Path, pictures: Path | None = None) -> list[str]:
    """Run a page's cells; return a line for each cell that prints something else than the page says.

    Args:
        page: its text.
        folder: in which the cells run.
        pictures: see `run`.
    """
    coded = [cell for cell in cells(page) if cell.code]
    printed = run([cell.code for cell in coded], folder, pictures)
    told = (difference(cell.text, text) for cell, text in zip(coded, printed, strict=True))
    return [f"cell {k}: {line}" for k, line in enumerate(told) if line]


def with_pictures(page: str, folder: str, there: set[str]) -> str:
    """Return a page that shows below each cell what it drew.

    Args:
        page: its text.
        folder: of the pictures, as links name it.
        there: names of the pictures in it.
    """
    count = -1

    def shown(match: re.Match[str]) -> str:
        nonlocal count
        count += 1
        name = f"cell_{count}.svg"
        return match.group(0) + (f"\n![drawn by the cell above]({folder}/{name})\n" if name in there else "")

    return CELL.sub(shown, page)
