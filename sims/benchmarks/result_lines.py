"""Results as lines of JSON, one each: a benchmark that was killed goes on with those that are whole."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def read(path: Path) -> list[dict[str, Any]]:
    """Return the results in a file; none where there is no file. A line that was cut off is left out."""
    result = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else []:
        try:
            result.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return result


def append(path: Path, result: dict[str, Any]) -> None:
    """Add a result, on a line of its own even where the last one was cut off."""
    whole = not path.is_file() or path.read_bytes()[-1:] in (b"", b"\n")
    with path.open("a", encoding="utf-8") as file:
        file.write(("" if whole else "\n") + json.dumps(result, ensure_ascii=False, default=float) + "\n")
