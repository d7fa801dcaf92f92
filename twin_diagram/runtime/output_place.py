"""Whether a file or a folder can be written, tried before anything is computed for it."""

from __future__ import annotations

import tempfile
from pathlib import Path


def why_not(path: str | Path, *, folder: bool) -> str | None:
    """Return why something cannot be written, None where it can; tries it, and leaves nothing behind.

    Args:
        path: of the file or folder; folders above it may be missing.
        folder: which of them it is.
    """
    path = Path(path).absolute()
    try:
        if path.exists() and path.is_dir() != folder:
            return f"there is a {'file' if folder else 'folder'} of that name"
        ways = [path, *path.parents] if folder else list(path.parents)
        above = next(way for way in ways if way.exists() or way.is_symlink())
        if not above.is_dir():
            return f"{above} is no folder that can be written to"
        with tempfile.NamedTemporaryFile(prefix=".room.", dir=above):
            pass
    except OSError as error:
        return f"cannot be written: {error.strerror or error}"
    return None
