"""Reads measured logs, and says in one line which column and line cannot be read."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin_diagram.errors import LogError, expect_path
from twin_diagram.logs.column_map import column_map
from twin_diagram.logs.csv_tables import few, read_foreign_table, read_table
from twin_diagram.logs.csv_units import CURRENT, converted, expect_agreement
from twin_diagram.logs.measured_log import SIGNALS, SPARE, Log
from twin_diagram.signals.arrays import Array


@dataclass(frozen=True)
class Tuning:
    """Constants of this module, chosen by hand."""

    fewest: int = 10
    """Samples that make a log: a spline of fifth order and its ends need as many."""


TUNING = Tuning()

TORQUES = ("torque_measured", "torque_commanded")
"""Signals of which a log needs one."""
FOREIGN = "; --columns tells what other names mean"
"""Said where a log's columns are not the format's."""
BAGS = (".mcap", ".db3", ".bag")
"""Endings of ROS bags: ROS 2's two stores, and ROS 1."""
LCM_LOGS = (".lcm", ".lcmlog", ".log")
"""Endings of LCM logs; `lcm-logger` itself asks for none."""


def read_log(path: str | Path, columns: str | Path | None = None) -> Log:
    """Read a measured log: CSV or .npz in the log format, a ROS bag, or an LCM log.

    CSV and .npz have columns `time` [s], then `<signal>.<joint>` with the signals of `measured_log.SIGNALS`, or
    `current_measured` [A] where there is no torque; columns of other names are left out. Of a ROS bag (.mcap, .db3,
    .bag, or a bag's folder) the joint states are read (`ros_bag`), of an LCM log the status messages of an iiwa or a
    Panda (`lcm_log`); `FILE#NAME` names the topic or channel where there are several. The values are taken as they are,
    but for what no one could use; `checking.check` looks at their sense.

    Args:
        path: the file.
        columns: what the columns of a foreign CSV or .npz mean: a YAML file or a preset (`column_map`).

    Raises:
        LogError: missing, empty, unreadable or ragged file; text where a number must be; a value that is missing or not
            finite; time that does not rise. The message names column and line. Left out, with a note, are a joint that
            has no torque where others have, and samples of a foreign log with a value missing.
    """
    expect_path(path, "log", "a measured log")
    path, stream = _parted(Path(path))
    suffix = path.suffix.lower()
    if columns is not None:
        return _foreign(path, columns)
    bag = suffix in BAGS or (path.is_dir() and (path / "metadata.yaml").is_file())
    if path.is_dir() and not bag:
        raise LogError(f"{path}: is a folder, and no ROS 2 bag: it has no metadata.yaml; name the log in it")
    if not path.exists():
        raise LogError(f"{path}: no such log file")
    if bag:
        from twin_diagram.logs.ros_bag import read_ros_bag

        return _checked(read_ros_bag(path, stream))
    from twin_diagram.logs.lcm_log import is_lcm_log, read_lcm_log

    if suffix in LCM_LOGS or "lcmlog" in path.name or is_lcm_log(path):
        return _checked(read_lcm_log(path, stream))
    if stream:
        raise LogError(f"{path}#{stream}: only ROS bags and LCM logs hold several streams")
    if suffix == ".csv":
        table = read_table(path)
        found, said = converted(table.columns, table.units, f"{path}: line {table.told}")
        log = log_from_columns(found, str(path), table.where)
        return replace(log, notes=(said, *log.notes)) if said else log
    if suffix == ".npz":
        return log_from_columns(_read_npz(path), str(path), lambda sample: f"sample {sample}")
    packed = "; unpack it first" * (suffix in (".gz", ".bz2", ".xz", ".zst", ".zip"))
    raise LogError(f"{path}: is none of .csv, .npz, a ROS bag (.mcap, .db3, .bag) and an LCM log{packed}")


def _foreign(path: Path, columns: str | Path) -> Log:
    """Return the log in a file whose columns have names and units of their own."""
    meaning = column_map(columns)
    if not path.is_file():
        raise LogError(f"{path}: no such log file")
    suffix = path.suffix.lower()
    if suffix not in (".csv", ".npz", ".txt"):
        raise LogError(f"{path}: a map of columns goes with a .csv or .npz log; bags and LCM logs name their signals")
    where: Callable[[int], str] = "sample {}".format
    if suffix == ".npz":
        found = _read_npz(path)
    else:
        table = read_foreign_table(path, meaning.names())
        expect_agreement(table.units, meaning, f"{path}: line {table.told}")
        found, where = table.columns, table.where
    kept, notes = meaning.whole(found, str(path))
    translated = meaning.translated({name: found[name][kept] for name in meaning.names()}, str(path))
    log = log_from_columns(translated, str(path), lambda sample: where(int(kept[sample])))
    log = replace(log, notes=log.notes + notes, currents=meaning.currents)
    return replace(log, numbered=meaning.numbered, link_side=meaning.link_side)


def _parted(path: Path) -> tuple[Path, str]:
    """Return a file and the stream in it that is meant."""
    text = str(path)
    if "#" not in text or path.exists():
        return path, ""
    file, _, stream = text.partition("#")
    return Path(file), stream


def _checked(log: Log) -> Log:
    """Return what every log must be, whatever it was read from."""
    return replace(
        log_from_columns(log.columns(), log.source, lambda sample: f"sample {sample}"),
        notes=log.notes,
        numbered=log.numbered,
        link_side=log.link_side,
    )


def log_from_columns(columns: Mapping[str, Array], source: str, where: Callable[[int], str]) -> Log:
    """Return a log from columns by the names of the log format.

    Args:
        columns: each (N,).
        source: what to call the log in messages.
        where: what to call a sample in messages.

    Raises:
        LogError: as `read_log`.
    """
    if "time" not in columns:
        raise LogError(f"{source}: has no column `time`; its columns are {few(list(columns))}{FOREIGN}")
    joints = [name.partition(".")[2] for name in columns if name.startswith("position_measured.")]
    if not joints:
        there = few(list(columns))
        raise LogError(f"{source}: has no column `position_measured.<joint>`; its columns are {there}{FOREIGN}")
    columns, currents = _currents_as_torques(_without_unsaid(columns))
    idle = _without_torque(columns, joints)
    joints = [joint for joint in joints if joint not in idle]
    columns = {name: values for name, values in columns.items() if name.partition(".")[2] not in idle}
    time = columns["time"]
    if len(time) < TUNING.fewest:
        raise LogError(f"{source}: holds {len(time)} sample(s); at least {TUNING.fewest} are needed")
    for name, values in columns.items():
        if name != "time" and name.partition(".")[0] not in SIGNALS:
            continue
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            shown = name.replace(TORQUES[0], CURRENT) if currents else name
            raise LogError(f"{source}: {where(int(bad[0]))}: {shown} is {_say(values[bad[0]])}")
    _check_time(time, columns, source, where)
    signals: dict[str, Any] = {
        attribute: signal
        for name, attribute in SIGNALS.items()
        if (signal := _signal(columns, name, joints, source)) is not None
    }
    lacks = CURRENT if currents else _counting(columns)
    notes = tuple(f"{source}: {joint} has no {lacks} and is left out" for joint in idle)
    return Log(time=time, joints=tuple(joints), source=source, notes=notes, currents=currents, **signals)


def _without_unsaid(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Return the columns without those that are NaN throughout where a joint need not have them: drives write it so."""
    spare = (*SPARE, *TORQUES, CURRENT)
    return {name: x for name, x in columns.items() if name.partition(".")[0] not in spare or not np.all(np.isnan(x))}


def _currents_as_torques(columns: Mapping[str, Array]) -> tuple[dict[str, Array], bool]:
    """Return the columns with currents in the place of torques where there are no torques, and whether it is so."""
    signals = {name.partition(".")[0] for name in columns}
    if CURRENT not in signals or signals & set(TORQUES):
        return dict(columns), False
    return {name.replace(f"{CURRENT}.", f"{TORQUES[0]}.", 1): values for name, values in columns.items()}, True


def _without_torque(columns: Mapping[str, Array], joints: Sequence[str]) -> list[str]:
    """Return the joints that have none where others have some.

    Fingers and mobile bases, which few drives tell the torque of, or only the commanded one where others are measured.
    """
    counts = _counting(columns)
    idle = [joint for joint in joints if f"{counts}.{joint}" not in columns]
    return idle if len(idle) < len(joints) else []


def _counting(columns: Mapping[str, Array]) -> str:
    """Return the signal that is the log's torque: the measured one, where there is any."""
    return TORQUES[0] if any(name.startswith(f"{TORQUES[0]}.") for name in columns) else TORQUES[1]


def _signal(columns: Mapping[str, Array], signal: str, joints: Sequence[str], source: str) -> Array | None:
    present = [name.partition(".")[2] for name in columns if name.startswith(f"{signal}.")]
    if not present:
        return None
    for joint in present:
        if joint not in joints:
            raise LogError(f"{source}: has {signal}.{joint} but no position_measured.{joint}")
    none = np.full(len(columns["time"]), np.nan)
    return np.stack([columns.get(f"{signal}.{joint}", none) for joint in joints], axis=1)


def _check_time(time: Array, columns: Mapping[str, Array], source: str, where: Callable[[int], str]) -> None:
    steps = np.diff(time)
    if len(bad := np.flatnonzero(steps <= 0.0)):
        k, again = int(bad[0]), np.flatnonzero(steps == 0.0)
        what = f"{'is the same as' if steps[k] == 0.0 else 'is before'} the one above it; time must rise"
        if len(again) and all(np.array_equal(column[again], column[again + 1]) for column in columns.values()):
            what += ". Such samples are the same in all columns: leave one of each"
        elif np.median(steps) == 0.0 and not np.any(steps < 0.0):
            what += ". So it is of most: they were written with too few digits"
        raise LogError(f"{source}: {where(k + 1)}: time {float(time[k + 1])!r} {what}")


def _read_npz(path: Path) -> dict[str, Array]:
    columns: dict[str, Array] = {}
    try:
        with np.load(path, allow_pickle=False) as archive:
            for name in archive.files:
                values = archive[name]
                if values.dtype.kind not in "fiu":
                    raise LogError(f"{path}: {name} holds {values.dtype}, not numbers")
                if values.ndim != 1:
                    why = "it must be a list of numbers, for each joint its own: position_measured.JOINT"
                    raise LogError(f"{path}: {name} is {values.ndim}-dimensional, {why}")
                columns[name] = values.astype(float)
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        if isinstance(error, LogError):
            raise
        reason = "it holds Python objects" if "Object arrays" in str(error) else "it is damaged or no .npz file"
        raise LogError(f"{path}: cannot be read: {reason}") from error
    lengths = {len(values) for values in columns.values()}
    if len(lengths) > 1:
        first = next(iter(columns))
        other = next(name for name in columns if len(columns[name]) != len(columns[first]))
        raise LogError(f"{path}: {first} has {len(columns[first])} samples, {other} has {len(columns[other])}")
    return columns


def _say(value: float) -> str:
    return "not a number (NaN)" if math.isnan(value) else f"{value}, not finite"
