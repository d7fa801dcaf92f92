"""What a foreign log's columns mean: names, units, signs and torque constants, from a file or a preset.

    preset: ur_rtde                   # optional: start from a published layout, see `presets.py`
    joints: [shoulder, elbow]         # optional: names in a model's order; without them, joints are only numbered
    time: {column: timestamp, unit: ms}
    position_measured: {column: "q_{i}", first: 0, unit: deg}
    torque_measured: {columns: [iq_sh, iq_el], unit: A, torque_constant: [11.1, 9.3], sign: [1, -1]}

`{i}` in a column's name counts the joints from `first`, `{joint}` stands for their names. A current is no torque until
somebody says how many N·m at the joint an ampere gives, here by `torque_constant` or later by `--torque-constants`.
Loggers leave cells empty: what is missing in a line is NaN, and the line is left out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import pi
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import yaml

from twin_diagram.errors import LogError
from twin_diagram.logs.measured_log import SIGNALS
from twin_diagram.logs.presets import PRESETS, Preset
from twin_diagram.signals.arrays import Array

TIMES: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units of time [s]."""
POSITIONS: Final = {"rad": 1.0, "deg": pi / 180.0, "turn": 2.0 * pi, "m": 1.0, "mm": 1e-3}
"""Units of positions [rad], [m]."""
VELOCITIES: Final = {"rad/s": 1.0, "deg/s": pi / 180.0, "rpm": pi / 30.0, "m/s": 1.0, "mm/s": 1e-3}
"""Units of velocities [rad/s], [m/s]."""
TORQUES: Final = {"N·m": 1.0, "Nm": 1.0, "N*m": 1.0, "mN·m": 1e-3, "mNm": 1e-3, "kN·m": 1e3, "kNm": 1e3, "N": 1.0}
"""Units of torques and forces [N·m], [N]."""
CURRENTS: Final = {"A": 1.0, "mA": 1e-3}
"""Units of currents [A], which need a torque constant."""
TORQUES_OR_CURRENTS: Final = ("torque_measured", "torque_commanded")
"""Signals that may be either."""
UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    "position_measured": POSITIONS,
    "position_commanded": POSITIONS,
    "velocity_estimated": VELOCITIES,
    "torque_measured": {**TORQUES, **CURRENTS},
    "torque_commanded": {**TORQUES, **CURRENTS},
}
"""Units that each signal may have."""
WITHOUT_CONSTANT: Final = (
    "torque_constant: is missing; a current becomes a torque by the joint's own constant [N·m/A, motor constant times "
    "gear ratio], which nobody can guess"
)
"""Said of a current beside torques."""
FIELDS: Final = ("column", "columns", "unit", "sign", "torque_constant", "first")
"""Of a signal."""


@dataclass(frozen=True)
class Column:
    """One column of a foreign log and what a number in it is worth.

    Attributes:
        name: in the file's first line.
        scale: units of the log format for one of the column's, with its sign.
        unit: the column's.
    """

    name: str
    scale: float
    unit: str


@dataclass(frozen=True)
class ColumnMap:
    """What the columns of a foreign log mean.

    Attributes:
        source: file or preset, for messages.
        time: of the samples.
        joints: their names, or `#1`, `#2` and so on where they are only numbered.
        numbered: whether they are.
        signals: by the log format's names, one column per joint.
        link_side: whether its preset's torques are measured behind the gears.
        currents: whether its torques are currents [A] whose constants it does not tell.
    """

    source: str
    time: Column
    joints: tuple[str, ...]
    numbered: bool
    signals: Mapping[str, tuple[Column, ...]]
    link_side: bool = False
    currents: bool = False

    def names(self) -> list[str]:
        """Return the file's columns that are read."""
        return [self.time.name, *(column.name for columns in self.signals.values() for column in columns)]

    def whole(self, columns: Mapping[str, Array], source: str) -> tuple[npt.NDArray[np.int64], tuple[str, ...]]:
        """Return the indices of samples in which nothing that is read is missing (NaN), and a note where others are.

        Args:
            columns: (N,) each, by the file's names.
            source: what to call the log in messages.

        Raises:
            LogError: a column is not there, or no sample has all of them; the message names the column.
        """
        self._expect(columns, source)
        missing = {name: np.isnan(columns[name]) for name in self.names()}
        lost = np.any(list(missing.values()), axis=0)
        if not np.any(lost):
            return np.arange(len(lost)), ()
        worst = max(missing, key=lambda name: int(np.sum(missing[name])))
        most = f"most often {worst!r}, in {int(np.sum(missing[worst]))}"
        if np.all(lost):
            raise LogError(f"{source}: each of {len(lost)} samples lacks something that {self.source} reads, {most}")
        note = f"{source}: left out {int(np.sum(lost))} of {len(lost)} samples, which lack something, {most}"
        return np.flatnonzero(~lost), (note,)

    def translated(self, columns: Mapping[str, Array], source: str) -> dict[str, Array]:
        """Return columns by the log format's names, in its units; time counts from the first sample.

        Args:
            columns: (N,) each, by the file's names.
            source: what to call the log in messages.

        Raises:
            LogError: a column is missing; the message names it and those that are there.
        """
        self._expect(columns, source)
        # Counted from the first sample before it is scaled: nanoseconds since 1970 have no room for fractions.
        time = columns[self.time.name]
        result = {"time": (time - time[:1]) * self.time.scale}
        for signal, of_joints in self.signals.items():
            for joint, column in zip(self.joints, of_joints, strict=True):
                result[f"{signal}.{joint}"] = columns[column.name] * column.scale
        return result

    def _expect(self, columns: Mapping[str, Array], source: str) -> None:
        for name in self.names():
            if name not in columns:
                have = ", ".join(list(columns)[:8]) + (", …" if len(columns) > 8 else "")
                raise LogError(
                    f"{source}: has no column {name!r}, which {self.source} asks for; its columns are {have}"
                )


def column_map(given: str | Path) -> ColumnMap:
    """Return the map in a YAML file, or a preset by its name.

    Raises:
        LogError: no such file or preset, or a field that cannot be; the message names it.
    """
    if str(given) in PRESETS and not Path(given).exists():
        return parse({"preset": str(given)}, str(given))
    path = Path(given)
    if not path.is_file():
        raise LogError(f"{given}: no such map of columns; the presets are {', '.join(PRESETS)}")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError, OSError) as error:
        raise LogError(f"{path}: is no YAML file: {' '.join(str(error).split())}") from error
    if not isinstance(content, dict):
        raise LogError(f"{path}: a map of columns is a YAML mapping of `time` and signals")
    return parse(content, str(path))


def parse(content: Mapping[str, Any], source: str) -> ColumnMap:
    """Return the map that a mapping describes.

    Args:
        content: as the module shows.
        source: for messages.

    Raises:
        LogError: a field that cannot be; the message names it.
    """
    preset = _preset(content.get("preset"), source)
    arm = 0 if preset is None else preset.joints
    link_side = preset is not None and preset.side == "link"
    content = {key: value for key, value in content.items() if key != "preset"}
    content = content if preset is None else _over(preset, content)
    _known(content, ("joints", "time", *SIGNALS), source)
    joints = _joints(content.get("joints"), arm, content, source)
    time = content.get("time", {"column": "time"})
    if not isinstance(time, Mapping) or not isinstance(time.get("column"), str):
        raise LogError(f"{source}: time: names a column, as time: {{column: timestamp, unit: ms}}")
    _known(time, ("column", "unit"), f"{source}: time")
    unit = _unit(time.get("unit", "s"), TIMES, f"{source}: time")
    signals = {
        signal: _columns(signal, content[signal], joints, f"{source}: {signal}")
        for signal in SIGNALS
        if signal in content
    }
    if "position_measured" not in signals:
        raise LogError(f"{source}: position_measured: is missing; a log needs measured positions")
    if not {"torque_measured", "torque_commanded"} & set(signals):
        raise LogError(f"{source}: torque_measured: is missing; a log needs measured or commanded torques")
    named = "joints" in content
    currents = _untold_currents(content, [signal for signal in TORQUES_OR_CURRENTS if signal in signals], source)
    return ColumnMap(source, Column(time["column"], TIMES[unit], unit), joints, not named, signals, link_side, currents)


def _untold_currents(content: Mapping[str, Any], torques: Sequence[str], source: str) -> bool:
    """Return whether the torques are currents whose constants are still to be told."""
    untold = [
        signal
        for signal in torques
        if "torque_constant" not in content[signal] and CURRENTS.keys() & set(_listed(content[signal].get("unit")))
    ]
    if untold and len(untold) < len(torques):
        raise LogError(f"{source}: {untold[0]}: {WITHOUT_CONSTANT}")
    return bool(untold)


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _preset(name: Any, source: str) -> Preset | None:
    if name is None:
        return None
    preset = PRESETS.get(str(name))
    if preset is None:
        raise LogError(f"{source}: preset: {name!r} is none of {', '.join(PRESETS)}")
    return preset


def _over(preset: Preset, content: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a map says, over what its preset does."""
    merged = dict(content)
    for name, fields in {"time": preset.time, **preset.signals}.items():
        own = content.get(name, {})
        if isinstance(own, Mapping):
            kept = {key: value for key, value in fields.items() if key != "column" or "columns" not in own}
            merged[name] = {**kept, **own}
    return merged


def _joints(given: Any, arm: int, content: Mapping[str, Any], source: str) -> tuple[str, ...]:
    if given is not None:
        if not isinstance(given, list) or not given or not all(isinstance(name, str) and name for name in given):
            raise LogError(f"{source}: joints: is a list of names, in the order of the columns")
        if len(set(given)) < len(given):
            raise LogError(f"{source}: joints: names one twice")
        return tuple(given)
    fields = [field for field in content.values() if isinstance(field, Mapping)]
    count = arm or max((len(told) for field in fields for told in field.values() if isinstance(told, list)), default=0)
    if not count:
        raise LogError(f"{source}: joints: is missing; name them in the order of the columns")
    return tuple(f"#{k + 1}" for k in range(count))


def _columns(signal: str, field: Any, joints: Sequence[str], where: str) -> tuple[Column, ...]:
    if not isinstance(field, Mapping):
        raise LogError(f"{where}: is a mapping, as {{column: 'q_{{i}}', unit: rad}}")
    _known(field, FIELDS, where)
    names = _names(field, joints, where)
    default = next(iter(UNITS[signal]))
    units = [_unit(unit, UNITS[signal], where) for unit in _each(field.get("unit", default), joints, "unit", where)]
    signs = _numbers(field.get("sign", 1), joints, "sign", where)
    if not np.all(np.abs(signs) == 1.0):
        raise LogError(f"{where}: sign: {field['sign']} is neither 1 nor -1")
    scale = signs * [UNITS[signal][unit] for unit in units]
    current = [unit in CURRENTS for unit in units]
    if any(current):
        constants = field.get("torque_constant")
        if constants is None and not all(current):
            raise LogError(f"{where}: {WITHOUT_CONSTANT}")
        values = _numbers(1 if constants is None else constants, joints, "torque_constant", where)
        if not np.all(values > 0.0):
            raise LogError(f"{where}: torque_constant: {constants} is not positive; a sign goes into `sign`")
        scale = scale * np.where(current, values, 1.0)
    elif "torque_constant" in field:
        raise LogError(f"{where}: torque_constant: goes with a current; the unit is {units[0]}")
    return tuple(Column(name, float(by), unit) for name, by, unit in zip(names, scale, units, strict=True))


def _names(field: Mapping[str, Any], joints: Sequence[str], where: str) -> list[str]:
    if ("column" in field) == ("columns" in field):
        raise LogError(f"{where}: needs one of `column`, a pattern with {{i}} or {{joint}}, and `columns`, a list")
    if "columns" in field:
        listed = field["columns"]
        if not isinstance(listed, list) or len(listed) != len(joints):
            raise LogError(f"{where}: columns: lists {listed!r}; there are {len(joints)} joints")
        return [str(name) for name in listed]
    pattern, first = str(field["column"]), field.get("first", 0)
    if not isinstance(first, int) or isinstance(first, bool):
        raise LogError(f"{where}: first: {first!r} is not a whole number")
    found = set(re.findall(r"\{(\w*)\}", pattern))
    if not found <= {"i", "joint"} or (not found and len(joints) > 1):
        raise LogError(f"{where}: column: {pattern!r} needs {{i}} or {{joint}} to tell {len(joints)} joints apart")
    return [pattern.replace("{i}", str(first + k)).replace("{joint}", name) for k, name in enumerate(joints)]


def _each(value: Any, joints: Sequence[str], name: str, where: str) -> list[Any]:
    if not isinstance(value, list):
        return [value] * len(joints)
    if len(value) != len(joints):
        raise LogError(f"{where}: {name}: has {len(value)} entries; there are {len(joints)} joints")
    return value


def _numbers(value: Any, joints: Sequence[str], name: str, where: str) -> Array:
    each = _each(value, joints, name, where)
    for one in each:
        if isinstance(one, bool) or not isinstance(one, int | float) or not np.isfinite(one):
            raise LogError(f"{where}: {name}: {one!r} is not a number")
    return np.array(each, dtype=float)


def _unit(unit: Any, units: Mapping[str, float], where: str) -> str:
    if not isinstance(unit, str) or unit not in units:
        raise LogError(f"{where}: unit: {unit!r} is none of {', '.join(units)}")
    return unit


def _known(given: Mapping[str, Any], names: Sequence[str], where: str) -> None:
    for name in given:
        if name not in names:
            raise LogError(f"{where}: {name!r} is no field; there are {', '.join(names)}")
