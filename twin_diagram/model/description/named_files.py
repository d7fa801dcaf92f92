"""Finds the files that a description names: beside it, in its packages, and in the folders above it."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import escape, unescape

from pydrake.multibody.parsing import LoadModelDirectives

DIRECTIVES = (".yaml", ".yml")
"""Suffixes of files that add models from other files: Drake's .dmd.yaml."""
_RELATIVE_FILE = re.compile(rb"""(<uri>|filename\s*=\s*["']|\bfile\s*=\s*["'])\s*([^"'<>]+?)\s*(?=["'<])""")
"""Of a URDF, SDF or MJCF: what stands before a file's name, and the name."""
_FOLDER = re.compile(rb"""(\b(?:meshdir|texturedir|assetdir)\s*=\s*["'])\s*([^"']+?)\s*(?=["'])""")
"""Of an MJCF's meshes and pictures, which its files are looked up in."""
_IN_PACKAGE = re.compile(rb"""(?<=["'>])\s*(?:package|model)://([^/"'<>\s]+)/([^"'<>]+?)\s*(?=["'<])""")
"""Of a URI: the package, and the file's path in it."""
_MANIFEST_NAME = re.compile(rb"<name>\s*([^<\s]+)\s*</name>")
"""Of a ROS package."""


def anchored(text: bytes, description: Path, prefix: bytes = b"") -> bytes:
    """Return a description's text, with the files beside it or in packages above it named by absolute paths.

    Args:
        text: of the description.
        description: the file that it is from.
        prefix: of absolute paths: `file://` where the text itself is parsed, and in directives.
    """
    # What is not there is named, too, where it is read: a text has no folder, and Drake looks in the user's.
    named = bool(prefix) or not _FOLDER.search(text)
    write = os.fsencode if description.suffix.lower() in DIRECTIVES else _in_xml

    def file(match: re.Match[bytes]) -> bytes:
        path = description.parent / unescape(os.fsdecode(match[2]))
        relative = b"://" not in match[2] and (path.is_file() or named)
        return match[1] + prefix + write(path.resolve()) if relative else match[0]

    def folder(match: re.Match[bytes]) -> bytes:
        return match[1] + write((description.parent / unescape(os.fsdecode(match[2]))).resolve())

    def in_package(match: re.Match[bytes]) -> bytes:
        package = package_above(description, os.fsdecode(match[1]), os.fsdecode(match[2]))
        return match[0] if package is None else prefix + write(package / unescape(os.fsdecode(match[2])))

    if description.suffix.lower() == ".xml":
        text = _FOLDER.sub(folder, text)
    return _IN_PACKAGE.sub(in_package, _RELATIVE_FILE.sub(file, text))


def _in_xml(path: Path) -> bytes:
    """Return a path as it stands in a description."""
    return os.fsencode(escape(str(path), {'"': "&quot;", "'": "&apos;"}))


def packages_above(text: bytes, description: Path, known: Mapping[str, Path]) -> dict[str, Path]:
    """Return the folders of packages that a description names, nobody told, and a folder above it is or holds.

    Args:
        text: of the description.
        description: the file that it is from.
        known: folders of those that were told.
    """
    found: dict[str, Path] = {}
    for match in _IN_PACKAGE.finditer(text):
        name = os.fsdecode(match[1])
        if name not in known and name not in found:
            package = package_above(description, name, os.fsdecode(match[2]))
            if package is not None:
                found[name] = package
    return found


def package_above(description: Path, name: str, rest: str) -> Path | None:
    """Return the folder of a package that holds a file, looked for upwards from a description; None: there is none.

    A folder is a package by its own name, as ROS lays them out, or by what its package.xml says.

    Args:
        description: where to begin.
        name: of the package.
        rest: the file's path in it.
    """
    for above in description.resolve().parents:
        if (above / name / rest).is_file():
            return above / name
        if (above / rest).is_file() and (above.name == name or _named_in_manifest(above) == name):
            return above
    return None


def _named_in_manifest(folder: Path) -> str | None:
    try:
        match = _MANIFEST_NAME.search((folder / "package.xml").read_bytes())
    except OSError:
        return None
    return None if match is None else os.fsdecode(match[1])


def place_of(name: str, folder: Path, packages: Mapping[str, Path]) -> Path | None:
    """Return the file that a description means; None where there is no such file.

    Args:
        name: a path or URI as it stands there.
        folder: that relative paths begin in.
        packages: folders by package name.
    """
    scheme, _, rest = name.strip().rpartition("://")
    if scheme in ("package", "model"):
        package, _, rest = rest.partition("/")
        path = packages[package] / rest if package in packages else None
    else:
        path = Path(rest) if scheme == "file" else folder / rest if not scheme else None
    return path if path is not None and path.is_file() else None


def parts_of(description: Path, packages: Mapping[str, Path]) -> tuple[Path, ...]:
    """Return the files whose models a description adds: those that a .dmd.yaml names, each once, or it itself.

    Args:
        description: the file.
        packages: folders by package name.
    """
    found: dict[Path, None] = {}

    def read(path: Path) -> None:
        if path in found:
            return
        found[path] = None
        for _, place in named_in(path, packages):
            read(place)

    read(description)
    kept = tuple(path for path in found if path.suffix.lower() not in DIRECTIVES)
    return kept or (description,)


def named_in(path: Path, packages: Mapping[str, Path]) -> list[tuple[str, Path]]:
    """Return the files that directives add models from, as they are written and where they are; of others none.

    Args:
        path: of the directives.
        packages: folders by package name.
    """
    if path.suffix.lower() not in DIRECTIVES or not path.is_file():
        return []
    try:
        directives = LoadModelDirectives(str(path)).directives
    except RuntimeError:  # which the parser says better
        return []
    names = [each.file for one in directives if (each := one.add_model or one.add_directives) is not None]
    places = ((name, place_of(name, path.parent, packages)) for name in names)
    return [(name, place) for name, place in places if place is not None]
