"""Files and folders appear whole or not at all: they are written aside, on the same disk, and then renamed."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

ASIDE_FILE: Final = re.compile(r"\.(.+)\.[0-9]+\.part")
"""Names that `write` gives files until they are whole."""
ASIDE_FOLDER: Final = re.compile(r"\.(.+)\.[a-z0-9_]{8}")
"""Names that `make_aside` gives folders: eight characters of `tempfile` at the end."""


def write(path: str | Path, content: bytes | str) -> Path:
    """Write a file under a temporary name beside it and rename it; make the folder where there is none."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)
        os.replace(temporary, path)
    except OSError as error:  # of a disk that is full the system names no file
        error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)
    return path


@contextmanager
def folder(path: str | Path, parts: Collection[str] = ()) -> Iterator[Path]:
    """Yield an empty folder that takes the place of `path` at the end; an exception leaves `path` as it was.

    Args:
        path: may exist.
        parts: files and folders that are replaced in a `path` that exists, all else in it stays; none: it goes as a
            whole.
    """
    path = Path(path).absolute()
    above = [each for each in path.parents if not each.exists()]
    aside = make_aside(path, inside=bool(parts))
    try:
        yield aside
        put_in_place(aside, path, parts)
    except OSError as error:  # as above
        error.filename = error.filename or str(path)
        raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)
        if not path.exists():
            _remove_empty(above)


def _remove_empty(folders: list[Path]) -> None:
    """Remove folders that were made for nothing, the innermost first; what somebody else put there stays."""
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return


def make_aside(path: Path, *, inside: bool = False) -> Path:
    """Make an empty folder beside an absolute `path`, or, where that may be a link or a disk of its own, inside it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    place = path if inside and path.exists() else path.parent
    aside = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=place))
    aside.chmod(0o755)
    return aside


def put_in_place(aside: Path, path: Path, parts: Collection[str] = ()) -> None:
    """Give a folder that was made by `make_aside` its name; arguments as of `folder`."""
    if not path.exists():
        os.replace(aside, path)
        return
    old = make_aside(path, inside=bool(parts))
    try:
        for part in parts:
            if (path / part).exists():
                os.replace(path / part, old / part)
            if (aside / part).exists():
                os.replace(aside / part, path / part)
        if not parts:
            os.replace(path, old / path.name)
            os.replace(aside, path)
    finally:
        shutil.rmtree(old, ignore_errors=True)


def unfinished(path: Path) -> str | None:
    """Return the name that a file or folder was to get when its writing was cut off; None: it is nothing of the kind.

    A foreign file can look the same by chance: compare the name with those that are written there.
    """
    if path.is_symlink():
        return None
    told = (ASIDE_FOLDER if path.is_dir() else ASIDE_FILE).fullmatch(path.name)
    return told[1] if told else None
