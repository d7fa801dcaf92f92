"""Writes measured logs and other tables without loss, and never half."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from twin_diagram.errors import LogError, expect
from twin_diagram.logs.measured_log import Log
from twin_diagram.runtime import atomic_file
from twin_diagram.signals.arrays import Array


def write_log(log: Log, path: str | Path) -> None:
    """Write a log as .csv or .npz; what is read back is equal to the bit.

    Raises:
        LogError: another suffix, or the folder cannot be written.
    """
    expect(log, Log, "log", "a Log (as read_log returns it)")
    write_columns(log.columns(), path)


def write_columns(columns: Mapping[str, Array], path: str | Path) -> None:
    """Write columns of numbers (N,) under their names, whole or not at all; raises as `write_log`."""
    path = Path(path)
    check_kind(path)
    content = _npz(columns) if path.suffix.lower() == ".npz" else _csv(columns)
    try:
        atomic_file.write(path, content)
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror}") from error


def check_kind(path: Path) -> None:
    """Check that a table can be written under this name.

    Raises:
        LogError: another suffix, or a folder.
    """
    if path.suffix.lower() not in (".csv", ".npz"):
        raise LogError(f"{path}: is written as .csv or .npz")
    if path.is_dir():
        raise LogError(f"{path}: there is a folder of that name")


def _npz(columns: Mapping[str, Array]) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **{key: np.asarray(values) for key, values in columns.items()})  # type: ignore[arg-type]
    return buffer.getvalue()


def _csv(columns: Mapping[str, Array]) -> str:
    table = np.stack(list(columns.values()), axis=1).tolist()
    head = io.StringIO()
    csv.writer(head, lineterminator="\n").writerow(columns)  # a joint's name may hold a comma
    return head.getvalue() + "".join(",".join(map(repr, row)) + "\n" for row in table)  # repr loses nothing
