"""Whether what a run leaves behind can go where it is asked to; cheap to import."""

from __future__ import annotations

from pathlib import Path

from twin_diagram.errors import TwinError
from twin_diagram.runtime.output_place import why_not


def check_places(out: Path | None, record: Path | None, log: Path | None) -> None:
    """Try whether all that is asked for can be written.

    Raises:
        TwinError: one of them cannot.
    """
    if log is not None and log.suffix not in (".csv", ".npz"):
        raise TwinError(f"--log {log}: a measured log is .csv or .npz")
    for option, path in (("--out", out), ("--record", record), ("--log", log)):
        if path is not None and (why := why_not(path, folder=option != "--log")):
            raise TwinError(f"{option} {path}: {why}")
