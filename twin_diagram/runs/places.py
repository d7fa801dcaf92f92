"""Whether what a run leaves behind can go where it is asked to; cheap to import."""

from __future__ import annotations

from pathlib import Path

from twin_diagram.errors import TwinError
from twin_diagram.runtime.output_place import why_not


def places_for(
    out: str | Path | None, record: str | Path | None, log: str | Path | None
) -> tuple[Path | None, Path | None, Path | None]:
    """Try whether all that is asked for can be written, and return where.

    Raises:
        TwinError: one of them cannot.
    """
    folder, recording, file = (None if place is None else Path(place) for place in (out, record, log))
    if file is not None and file.suffix not in (".csv", ".npz"):
        raise TwinError(f"--log {file}: a measured log is .csv or .npz")
    for option, path in (("--out", folder), ("--record", recording), ("--log", file)):
        if path is not None and (why := why_not(path, folder=option != "--log")):
            raise TwinError(f"{option} {path}: {why}")
    return folder, recording, file
