"""Where the published data lies that benchmarks read, and one line where it is not there."""

from __future__ import annotations

import os
import sys
from pathlib import Path

DATA = Path(os.environ.get("TWIN_DIAGRAM_DATA") or Path(__file__).resolve().parents[3] / "shared" / "data")
"""`$TWIN_DIAGRAM_DATA`, or `../shared/data` beside the checkout."""


def need(part: str) -> Path:
    """Answer a folder of the published data; where it is not there, end the program with one line and status 2.

    Args:
        part: the folder's name, as `ycb`.
    """
    folder = DATA / part
    if not folder.is_dir():
        print(f"{folder}: no such folder; set TWIN_DIAGRAM_DATA to the folder that holds {part}", file=sys.stderr)
        raise SystemExit(2)
    return folder
