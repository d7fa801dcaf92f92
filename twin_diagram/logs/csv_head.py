"""Finds what stands above a CSV file's numbers: the line of names, perhaps one of units, comments."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from twin_diagram.errors import LogError
from twin_diagram.logs.csv_units import units_in

COMMENT = "#"
"""Begins a line that holds no numbers; NumPy writes it before the names, too."""


@dataclass(frozen=True)
class Head:
    """The line of names, and what stands between it and the numbers.

    Attributes:
        text: the names, as they stand there.
        line: in which they do, counted from one.
        below: comments below it, then the first line that is none, each with its number.
    """

    text: str
    line: int
    below: Sequence[tuple[int, str]]

    def units(self, names: Sequence[str], wanted: Sequence[str], mark: str) -> tuple[int, Mapping[str, str]]:
        """Return the line that tells the wanted columns' units, and them; 0 and none where there is no such line.

        Args:
            names: of all columns.
            wanted: those that are read.
            mark: what parts cells.
        """
        for number, line in self.below:
            cells = cells_of(line, mark)
            told = {name: cell for name, cell in zip(names, cells, strict=False) if name in wanted}
            if len(cells) == len(names) and (units := units_in(told)):
                return number, units
        return 0, {}


def head_of(lines: Iterable[str], wanted: Sequence[str], path: Path) -> Head:
    """Return what stands above the numbers.

    Names stand in the comment, or in the first line that is none, that holds most of the wanted ones.

    Raises:
        LogError: nothing stands there at all.
    """
    filled: list[tuple[int, str]] = []
    plain: list[int] = []
    for number, line in enumerate(lines, 1):
        text = line.strip(" \r\n").lstrip(f"{COMMENT} ")  # tabs at its ends stand beside columns without a name
        if not text.strip():
            continue
        if not commented(line):
            plain.append(len(filled))
        filled.append((number, text))
        if len(plain) == 2:
            break
    if not filled:
        raise LogError(f"{path}: is empty; its first line must name the columns")
    first = plain[0] if plain else len(filled) - 1
    at = max(range(first + 1), key=lambda k: (sum(name in filled[k][1] for name in wanted), k))
    end = plain[1] if at == first and len(plain) == 2 else first
    return Head(filled[at][1], filled[at][0], filled[at + 1 : end + 1])


def commented(line: str) -> bool:
    """Return whether a line is a comment."""
    return line.lstrip().startswith(COMMENT)


def cells_of(line: str, mark: str) -> list[str]:
    """Return the cells of a line that a mark parts, or spaces where there is none."""
    parted = next(csv.reader([line], delimiter=mark, skipinitialspace=True), []) if mark else line.split()
    return [cell.strip() for cell in parted]
