"""Results as lines of JSON, one each: a benchmark that was killed goes on with whole ones of the same code."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parents[2] / "twin_diagram"


def digest(files: Iterable[Path]) -> str:
    """Return a digest of files' contents."""
    total = hashlib.sha256()
    for file in files:
        total.update(file.read_bytes())
    return total.hexdigest()[:12]


@cache
def code() -> str:
    """Return a digest of the package's sources as they were when first asked."""
    return digest(sorted(PACKAGE.rglob("*.py")))


def read(path: Path, *, of_any_code: bool = False) -> list[dict[str, Any]]:
    """Return the results in a file; none where there is no file. A line that was cut off is left out.

    Lines of other code than this are left out, too, and stderr tells of them; `of_any_code` returns all as they are.
    """
    result, others = [], 0
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else []:
        try:
            found = json.loads(line)
        except json.JSONDecodeError:
            continue
        if of_any_code or found.get("code") == code():
            result.append(found)
        else:
            others += 1
    if others:
        print(f"{path}: {others} results of other code are not counted", file=sys.stderr)
    return result


def append(path: Path, result: dict[str, Any]) -> None:
    """Add a result with its code, on a line of its own even where the last one was cut off."""
    whole = not path.is_file() or path.read_bytes()[-1:] in (b"", b"\n")
    line = json.dumps({**result, "code": code()}, ensure_ascii=False, default=float)
    with path.open("a", encoding="utf-8") as file:
        file.write(("" if whole else "\n") + line + "\n")
