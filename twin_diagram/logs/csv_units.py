"""Reads the units that some loggers write below the names, or in brackets behind them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final

from twin_diagram.errors import LogError
from twin_diagram.logs.column_map import CURRENTS, POSITIONS, TIMES, TORQUES, VELOCITIES, ColumnMap
from twin_diagram.logs.measured_log import SIGNALS
from twin_diagram.signals.arrays import Array

CURRENT: Final = "current_measured"
"""A signal that stands for torques [A] where a log has none of them."""
WORDS: Final = {"sec": "s", "°": "deg", "degrees": "deg", "radians": "rad", "N.m": "N·m", "N⋅m": "N·m", "N m": "N·m"}
"""Other ways to write some units."""
OF_SIGNALS: Final[Mapping[str, Mapping[str, float]]] = {
    "time": TIMES,
    "position_measured": POSITIONS,
    "position_commanded": POSITIONS,
    "velocity_estimated": VELOCITIES,
    "torque_measured": TORQUES,
    "torque_commanded": TORQUES,
    CURRENT: CURRENTS,
}
"""Units that each of the log format's columns may have, in its own."""
BEHIND: Final = re.compile(r"(.*?)\s*[\[(]\s*([^\[\]()]*?)\s*[\])]")
"""A name and a unit in brackets behind it."""
ALL: Final = {unit: scale for units in OF_SIGNALS.values() for unit, scale in units.items()}
"""All of them."""


def known(name: str) -> bool:
    """Return whether a column is one of the log format's."""
    return name == "time" or name.partition(".")[0] in (*SIGNALS, CURRENT)


def units_in(cells: Mapping[str, str]) -> dict[str, str]:
    """Return the units that a line tells; empty where it tells none, or something that is no unit.

    Where time has one, it is a line of units, whatever the others are said to be in.

    Args:
        cells: of the line, by the names of their columns.
    """
    bare = {name: cell.strip(" []()") for name, cell in cells.items()}
    units = {name: WORDS.get(cell, cell) for name, cell in bare.items() if cell}
    return units if set(units.values()) <= set(ALL) or units.get("time") in TIMES else {}


def without_units(names: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """Return names without the units that stand in brackets behind those of the log format, and these by name."""
    bare, units = list(names), {}
    for k, name in enumerate(names):
        found = BEHIND.fullmatch(name)
        if found is not None and known(found[1]):
            bare[k] = found[1]
            units[found[1]] = WORDS.get(found[2], found[2])
    return bare, units


def converted(columns: Mapping[str, Array], units: Mapping[str, str], where: str) -> tuple[dict[str, Array], str]:
    """Return a log format's columns in its own units, and what is said of those that were in others.

    Args:
        columns: each (N,).
        units: as the file tells them.
        where: they stand.

    Raises:
        LogError: a unit of something else.
    """
    scales = {}
    for name, unit in units.items():
        allowed = OF_SIGNALS[name.partition(".")[0]]
        if unit not in allowed:
            raise LogError(f"{where}: {name} is in {unit!r}, which is none of {', '.join(allowed)}; name it what it is")
        scales[name] = allowed[unit]
    other = {unit: "" for name, unit in units.items() if scales[name] != 1.0}
    said = f"{where} tells units; {', '.join(other)} are made SI units" if other else ""
    return {name: values * scales.get(name, 1.0) for name, values in columns.items()}, said


def expect_agreement(units: Mapping[str, str], meaning: ColumnMap, where: str) -> None:
    """Refuse a map of columns that reads some in other units than the file tells.

    Args:
        units: as the file tells them.
        meaning: the map.
        where: they stand.

    Raises:
        LogError: so it is; the message names the column.
    """
    for column in (meaning.time, *(column for columns in meaning.signals.values() for column in columns)):
        told = units.get(column.name, column.unit)
        if ALL[told] != ALL[column.unit] or (told in CURRENTS) != (column.unit in CURRENTS):
            raise LogError(
                f"{where}: {column.name!r} is in {told!r}, and {meaning.source} reads it in {column.unit!r}: tell "
                f"`unit: {told}` there"
            )
