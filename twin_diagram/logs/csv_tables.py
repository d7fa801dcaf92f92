"""Reads the numbers of CSV files: a line of names, perhaps one of units, comments in lines of their own."""

from __future__ import annotations

import csv
import math
import reprlib
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin_diagram.errors import LogError
from twin_diagram.logs.csv_head import cells_of, commented, head_of
from twin_diagram.logs.csv_units import known, without_units
from twin_diagram.logs.measured_log import SIGNALS
from twin_diagram.signals.arrays import Array

BLOCK = 1 << 24
"""Bytes of a file that are looked at at a time."""
NOTHING = ("", "null", "none", "na", "n/a")
"""What foreign loggers write, besides NaN, where they have no number."""

POINTS = "; decimals are written with points"
"""Said where a file's look as if they were written with commas, as some languages do."""


@dataclass(frozen=True)
class Table:
    """The numbers of a CSV file.

    Attributes:
        columns: each (N,), by the file's names.
        lines: of the file in which the samples stand, counted from one.
        units: of the columns, as the file's line of units says, or brackets behind names; empty where it has none.
        told: which line says so.
    """

    columns: dict[str, Array]
    lines: Sequence[int]
    units: Mapping[str, str]
    told: int

    def where(self, sample: int) -> str:
        """Return what to call a sample in messages."""
        return f"line {self.lines[sample]}"


def read_columns(path: Path) -> dict[str, Array]:
    """Return the columns of a CSV file of numbers; see `read_table`."""
    return read_table(path).columns


def read_table(path: Path) -> Table:
    """Return the numbers of a CSV file with one line of names, which may begin with `#`.

    What is no number in a column that the log format does not know is NaN.

    The file is read piece by piece: a log of ten minutes at 5 kHz is half a gigabyte of text.
    """
    try:
        with path.open(encoding="utf-8-sig") as file:
            head = head_of(file, ("time", *SIGNALS), path)
    except UnicodeDecodeError as error:
        raise _no_text(path) from error
    for mark, called in ((";", "semicolons"), ("\t", "tabs")):
        if head.text.count(mark) > head.text.count(","):
            raise LogError(f"{path}: columns are separated by {called}; a .csv log uses commas; --columns reads others")
    names, behind = without_units(cells_of(head.text, ","))
    if len(names) == 1:
        raise LogError(f"{path}: its first line must name the columns; it is {reprlib.repr(head.text)}")
    if not any(math.isnan(_number_or_none(name)) for name in names):
        raise LogError(f"{path}: line {head.line} holds numbers; a line above them must name the columns")
    for name in names:
        if name and names.count(name) > 1:
            raise LogError(f"{path}: column {name!r} is there {names.count(name)} times")
    told, units = head.units(names, [name for name in names if known(name)], ",")
    above = max(told, head.line)
    table = _quickly(path, len(names), above)
    lines: Sequence[int] = range(above + 1, above + 1 + (0 if table is None else len(table)))
    if table is None:
        table, lines = _slowly(path, names, above)
    return Table({name: table[:, k] for k, name in enumerate(names)}, lines, {**behind, **units}, above)


def read_foreign_table(path: Path, wanted: Sequence[str]) -> Table:
    """Return those of the wanted columns that a foreign CSV file has; what else stands in it may be text.

    Cells are separated by commas, semicolons, tabs or spaces, whichever the line of names shows; that may begin with
    `#`.

    Raises:
        LogError: as `reading.read_log`.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise _no_text(path) from error
    head = head_of(lines, wanted, path)
    mark = next((mark for mark in ",;\t" if mark in head.text), "")
    names = cells_of(head.text, mark)
    told, units = head.units(names, wanted, mark)
    there = [k for k in range(max(told, head.line), len(lines)) if not commented(lines[k])]
    while there and not lines[there[-1]].strip(f"{mark} "):
        there.pop()
    rows = [cells_of(lines[k], mark) for k in there]
    numbers = [k + 1 for k in there]
    for number, row in zip(numbers, rows, strict=True):
        if len(row) != len(names):
            raise LogError(f"{path}: line {number} has {len(row)} cell(s), the first line names {len(names)} columns")
    if lacks := [name for name in wanted if name not in names]:
        said = f"none of the columns {few(lacks)}" if len(lacks) == len(wanted) else f"no column {lacks[0]!r}"
        raise LogError(f"{path}: has {said}, which --columns asks for; its columns are {few(names)}")
    for name in wanted:
        if names.count(name) > 1:
            raise LogError(f"{path}: column {name!r} is there {names.count(name)} times")
    places = {name: names.index(name) for name in wanted}
    comma = "," if mark != "," else "."  # of decimals, as some languages write them
    columns = {name: array("d") for name in places}
    for number, row in zip(numbers, rows, strict=True):
        for name, k in places.items():
            cell = "nan" if row[k].lower() in NOTHING else row[k].replace(comma, ".", 1)
            columns[name].append(_number(cell, f"{path}: line {number}: {name}"))
    return Table({name: np.array(column) for name, column in columns.items()}, numbers, units, told)


def few(names: Sequence[str]) -> str:
    """Return the first of some names, as messages list them."""
    return ", ".join(names[:6]) + (", …" if len(names) > 6 else "") if names else "none"


def _no_text(path: Path) -> LogError:
    return LogError(f"{path}: not a text file; a .csv log is UTF-8 text")


def _quickly(path: Path, width: int, above: int) -> Array | None:
    """Return the numbers (N, width) below the lines above; None where not every line holds as many."""
    with path.open("rb") as file:
        last, lines = b"", 0
        while block := file.read(BLOCK):
            last, lines = block[-1:], lines + block.count(b"\n")
    lines += last not in (b"\n", b"")
    if lines <= above:  # NumPy warns of what is empty
        return None
    try:
        with path.open(encoding="utf-8-sig") as file:
            table = np.loadtxt(file, delimiter=",", ndmin=2, comments=None, skiprows=above)
    except UnicodeDecodeError as error:
        raise _no_text(path) from error
    except ValueError:
        return None
    return table if table.shape == (lines - above, width) else None  # NumPy skips blank lines


def _slowly(path: Path, names: Sequence[str], above: int) -> tuple[Array, list[int]]:
    """Read cell by cell, and tell each sample's line.

    Quoted cells, comments and blank lines at the end pass, anything else is named.
    """
    cells, lines = array("d"), array("q")
    counts = [known(name) for name in names]
    blank: list[tuple[int, int]] = []
    try:
        with path.open(encoding="utf-8-sig") as file:
            for at, row in _rows(file, above):
                if not any(cell.strip() for cell in row):
                    blank.append((at, len(row)))
                    continue
                for place, width in [*blank, (at, len(row))]:
                    if width != len(names):
                        said = f"line {place} has {width} cell(s), the first line names {len(names)} columns"
                        raise LogError(f"{path}: {said}{POINTS * (len(names) < width <= 2 * len(names))}")
                if blank:
                    raise LogError(f"{path}: line {blank[0][0]}: {names[0]} is empty")
                cells.extend(
                    _number(cell, f"{path}: line {at}: {name}") if count else _number_or_none(cell)
                    for name, cell, count in zip(names, row, counts, strict=True)
                )
                lines.append(at)
    except UnicodeDecodeError as error:
        raise _no_text(path) from error
    except csv.Error as error:
        raise LogError(f"{path}: is no table of numbers: {error}") from error
    return np.array(cells).reshape(-1, len(names)), list(lines)


def _rows(file: Iterable[str], above: int) -> Iterator[tuple[int, list[str]]]:
    """Yield the cells of each line below the lines above that is no comment, and which line that is."""
    at = 0

    def plain() -> Iterator[str]:
        nonlocal at
        for at, line in enumerate(file, 1):
            if at > above and not commented(line):
                yield line

    for row in csv.reader(plain()):
        yield at, row


def _number(cell: str, where: str) -> float:
    try:
        return float(cell)
    except ValueError:
        shown = "is empty" if not cell.strip() else f"is {cell.strip()[:40]!r}, not a number"
        comma = not math.isnan(_number_or_none(cell.replace(",", ".", 1)))
        raise LogError(f"{where} {shown}{POINTS * comma}") from None


def _number_or_none(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
