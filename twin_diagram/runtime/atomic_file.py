"""Files appear whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path


def write(path: str | Path, content: bytes | str) -> Path:
    """Write a file under a temporary name beside it and renames it; makes the folder where there is none."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return path
