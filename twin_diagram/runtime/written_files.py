"""Lists of what was written into a folder, left there so that the next run can remove it, and nothing else.

A list is a text file, one relative path to a line with `/` between its parts. What it says is not believed: a path that
leads out of the folder, be it through `..` or a link, is passed over, and so is what is no file.
"""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

from twin_diagram.runtime import atomic_file


def note(folder: Path, name: str, paths: Iterable[str]) -> None:
    """Add paths to the list of that name; call it before they are written, so that a killed run leaves none unknown."""
    with (folder / name).open("a", encoding="utf-8", errors="surrogateescape", newline="") as file:
        file.write("".join(f"{path}\n" for path in paths if "\n" not in path))


def listed(folder: Path, name: str) -> list[str]:
    """Return the paths of a list that lie in the folder; none where there is no such list."""
    try:
        text = (folder / name).read_text(encoding="utf-8", errors="surrogateescape")
    except (OSError, ValueError):
        return []
    return list(dict.fromkeys(line for line in text.split("\n") if _inside(line)))


def _inside(path: str) -> bool:
    """Return whether a path names something below where it begins, as far as its words tell."""
    parts = path.split("/")
    return "\0" not in path and not PurePosixPath(path).is_absolute() and not {"", ".", ".."} & set(parts)


def remove(folder: Path, name: str, unlisted: Iterable[str] = ()) -> None:
    """Remove the files of a list, folders of theirs that this leaves empty, and the list itself.

    Args:
        folder: stays, and so does all that is not listed.
        name: of the list.
        unlisted: what to take for the list where there is none, as of those who did not leave one.
    """
    has = stat.S_ISREG(_mode(folder / name))
    emptied: set[Path] = set()
    for path in listed(folder, name) if has else filter(_inside, unlisted):
        file = folder / path
        above = [folder.joinpath(*path.split("/")[:k]) for k in range(1, path.count("/") + 1)]
        if not all(map(_is_own_folder, above)):
            continue
        if _is_file(file):
            file.unlink(missing_ok=True)
        emptied.update(above)
    for part in sorted(emptied, key=lambda part: len(part.parts), reverse=True):
        with suppress(OSError):  # something else is in it
            part.rmdir()
    if has:
        (folder / name).unlink(missing_ok=True)


def _mode(path: Path) -> int:
    """Return what `path` is, no link followed; 0 where there can be nothing of that name."""
    try:
        return path.lstat().st_mode
    except OSError:
        return 0


def _is_file(path: Path) -> bool:
    return _mode(path) != 0 and not stat.S_ISDIR(_mode(path))


def _is_own_folder(path: Path) -> bool:
    return stat.S_ISDIR(_mode(path))


def files_of(folder: Path) -> Iterator[str]:
    """Yield the paths of all files in a folder, as a list holds them; no link is followed."""
    for place, _, names in os.walk(folder):
        for name in sorted(names):
            yield Path(place, name).relative_to(folder).as_posix()


@contextmanager
def folder(path: str | Path, name: str, unlisted: Collection[str] = ()) -> Iterator[Path]:
    """Yield an empty folder, whose files in the end come into `path` for those of the list; an exception leaves that.

    Args:
        path: may exist.
        name: of the list.
        unlisted: as of `remove`.
    """
    path = Path(path).absolute()
    aside = atomic_file.make_aside(path, inside=True)
    try:
        yield aside
        note(aside, name, list(files_of(aside)))
        if path.exists():
            remove(path, name, unlisted)
            move(aside, path, first=name)
        else:
            os.replace(aside, path)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def move(aside: Path, folder: Path, first: str = "", last: str = "") -> None:
    """Move what is in one folder into another on the same disk, in an order that counts, and remove the former.

    A file takes the place of one of its name; other files stay.
    """
    for entry in sorted(aside.iterdir(), key=lambda entry: (entry.name != first, entry.name == last, entry.name)):
        target = folder / entry.name
        if entry.is_dir() and target.is_dir() and not target.is_symlink():
            move(entry, target)
        else:
            os.replace(entry, target)
    aside.rmdir()
