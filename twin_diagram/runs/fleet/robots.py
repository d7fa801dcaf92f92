"""The table of a fleet: which logs are of which robot, and of which day."""

from __future__ import annotations

import csv
import hashlib
import re
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from twin_diagram.errors import TwinError
from twin_diagram.model.description.corrected_folder import TORQUE_SIDES

COLUMNS = ("robot", "date", "model", "fit", "holdout")
"""Of the table; what else stands in it is left alone, but for `SIDE`."""

SIDE = "torque_side"
"""A column that there may be: halls have arms that measure before and behind their gears, and one option is for all."""

READ = ("--columns", "--import", "--torque-constants")
"""Options of `gap` that may name a file."""

DAY = re.compile(r"\d{4}-\d{1,2}-\d{1,2}")
"""A date that has one meaning; all else in its column may be a number or words."""


@dataclass(frozen=True)
class Visit:
    """One robot on one day.

    Attributes:
        robot: its name.
        date: as it stands in the table; see `page.by_day`.
        model: its description, or the folder of a corrected model.
        fit: logs that are fitted.
        holdout: the log that proves it.
        torque_side: of the gears that its torques are measured on; empty: as the command is told of all.
    """

    robot: str
    date: str
    model: Path
    fit: tuple[Path, ...]
    holdout: Path
    torque_side: str = ""

    def asked(self, options: tuple[str, ...] = ()) -> tuple[str, ...]:
        """Return the options of its command, of those for all: what its own line tells counts last, and so wins."""
        return (*options, "--torque-side", self.torque_side) if self.torque_side else options

    @property
    def folder(self) -> str:
        """Name of the folder that its results go to: readable, and no other visit's."""
        words = re.sub(r"[^A-Za-z0-9.-]+", "_", f"{self.robot}_{self.date}").strip("._")[:60]
        return f"{words}_{hashlib.sha256(f'{self.robot}|{self.date}'.encode()).hexdigest()[:6]}"

    def mark(self, options: tuple[str, ...] = ()) -> str:
        """Return what changes where any of its inputs does.

        Args:
            options: further ones of the command, whose words count, and the contents of the files among `READ`.

        Returns:
            Of models and logs paths, sizes and times of change count.
        """
        options = self.asked(options)
        told = [_of_option(name, value) for name, value in zip(("", *options), options, strict=False)]
        for path in (self.model, *self.fit, self.holdout):
            path = path if path.exists() else Path(str(path).partition("#")[0])  # a stream of a bag: the bag itself
            files = sorted(path.rglob("*")) if path.is_dir() else [path]
            for file in files:
                stat = file.stat() if file.is_file() else None
                told.append(f"{file}:{stat.st_size}:{stat.st_mtime_ns}" if stat else f"{file}:-")
        return hashlib.sha256("|".join(told).encode()).hexdigest()[:16]


def _of_option(before: str, word: str) -> str:
    """Return what a word after another one among the options stands for."""
    if before in READ and Path(word).is_file():
        return f"{word}:{hashlib.sha256(Path(word).read_bytes()).hexdigest()}"
    return word


def read_fleet(path: Path) -> list[Visit]:
    """Return the visits of a table, in its order; relative paths are relative to it.

    Raises:
        TwinError: no such file, a column that lacks or is there twice, an empty field, a day that no month has, a side
            that no gear has, a cell too many, or one robot twice on one day.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            table = csv.DictReader(file)
            table.fieldnames = [name.strip() for name in table.fieldnames or ()]
            # Spreadsheets write lines of nothing but commas below a table.
            rows = [(table.line_num, row) for row in table if any("".join(x or ()).strip() for x in row.values())]
            columns = table.fieldnames or ()
    except OSError as error:
        raise TwinError(f"--fleet {path}: cannot be read: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise TwinError(f"--fleet {path}: cannot be read: {error}") from error
    if not rows:
        raise TwinError(f"--fleet {path}: holds no robot; its columns are {','.join(COLUMNS)}")
    if lacking := [column for column in COLUMNS if column not in columns]:
        raise TwinError(
            f"--fleet {path}: line 1: no column {', '.join(lacking)}; with commas between they are {','.join(COLUMNS)}"
        )
    if twice := [column for column in (*COLUMNS, SIDE) if list(columns).count(column) > 1]:
        raise TwinError(f"--fleet {path}: line 1: column {twice[0]} is there {list(columns).count(twice[0])} times")
    visits: dict[tuple[str, str], Visit] = {}
    for number, row in rows:
        where = f"--fleet {path}: line {number}"
        fields = {column: (row.get(column) or "").strip() for column in COLUMNS}
        fit = tuple(path.parent / each.strip() for each in fields["fit"].split(";") if each.strip())
        fields["fit"] = fields["fit"] if fit else ""
        if empty := [column for column, value in fields.items() if not value]:
            raise TwinError(f"{where}: nothing in {', '.join(empty)}")
        if not _may_be(fields["date"]):
            raise TwinError(f"{where}: date {fields['date']!r} is on no calendar")
        if any(cell.strip() for cell in row.get(None, ())):
            raise TwinError(f"{where}: more cells than columns; fit logs stand in one, with ; between")
        side = (row.get(SIDE) or "").strip()
        if side and side not in TORQUE_SIDES:
            raise TwinError(f"{where}: {SIDE} {side!r}: it is {' or '.join(TORQUE_SIDES)}, or empty")
        key = fields["robot"], fields["date"]
        if key in visits:
            raise TwinError(f"{where}: {key[0]} on {key[1]} stands there twice")
        visits[key] = Visit(*key, path.parent / fields["model"], fit, path.parent / fields["holdout"], side)
    return list(visits.values())


def _may_be(date: str) -> bool:
    """Return whether a date can be: one such as 2026-02-30 would leave the others of its robot unsorted."""
    if DAY.fullmatch(date) is None:
        return True
    try:
        datetime.strptime(date, "%Y-%m-%d")
    except ValueError:
        return False
    return True
