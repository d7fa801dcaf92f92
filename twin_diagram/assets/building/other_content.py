"""Files that are called meshes and hold something else, told by how they begin: each with what to do about it."""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Tuning:
    """Constants of this module."""

    head: int = 400
    """Bytes by which an encoding is told: a hundred letters of four bytes each."""

    looked_at: int = 1_000_000
    """Bytes in which a number with a comma is looked for: who writes one writes them from the first vertices on."""


TUNING = Tuning()

BEGINNINGS: tuple[tuple[bytes, str], ...] = (
    (b"\x1f\x8b", "it is packed (gzip); unpack it"),
    (b"PK\x03\x04", "it is packed (ZIP); unpack it"),
    (b"7z\xbc\xaf\x27\x1c", "it is packed (7z); unpack it"),
    (b"version https://git-lfs", "it is Git LFS's pointer to a mesh, not the mesh; fetch it: git lfs pull"),
    (b"<!doctype html", "it is a web page, not a mesh; download the file itself"),
    (b"<html", "it is a web page, not a mesh; download the file itself"),
)
"""How files begin, in lower case but for what is no text, and what is said of them."""

VERTICES: dict[str, re.Pattern[bytes]] = {
    ".obj": re.compile(rb"v[nt]?[ \t][^#]*"),
    ".stl": re.compile(rb"vertex[ \t].*"),
    ".ply": re.compile(rb"[-+\d].*"),
}
"""Lines that hold coordinates, by the file's suffix; what follows a # is a remark."""

COMMA = re.compile(rb"\d,\d")
"""A number with a comma."""


def other_content(data: bytes, suffix: str) -> str | None:
    """Return what a file of that suffix holds in a mesh's place, and what to do; None: nothing that is known here.

    Args:
        data: the file's bytes.
        suffix: its ending, in lower case, with the dot.
    """
    start = data[: TUNING.head].lstrip()
    for beginning, said in BEGINNINGS:
        if data.startswith(beginning) or start.lower().startswith(beginning):
            return said
    encoding = wide_encoding(data[: TUNING.head], marked=suffix != ".stl")
    if encoding and suffix != ".dae":  # XML tells its own
        return f"its text is {encoding}; save it as UTF-8"
    if suffix in VERTICES and not _is_binary(data, suffix) and (number := _with_comma(data, suffix)):
        return f"its numbers have decimal commas ({number}); save it with decimal points"
    return None


def _with_comma(data: bytes, suffix: str) -> str | None:
    """Return the first coordinate with a comma in a text file; None: it has none."""
    body = data[: TUNING.looked_at].replace(b"\r", b"\n")
    for met in COMMA.finditer(body, max(body.find(b"end_header"), 0) if suffix == ".ply" else 0):
        before = body[body.rfind(b"\n", 0, met.start()) + 1 : met.end()].lstrip()
        if VERTICES[suffix].fullmatch(before):
            return (before.split()[-1] + body[met.end() : met.end() + 20].split(maxsplit=1)[0]).decode(errors="replace")
    return None


def wide_encoding(head: bytes, marked: bool) -> str | None:
    """Return the name of an encoding with several bytes a letter, of a text's beginning; None: it has none of those.

    ASCII letters leave all other bytes of theirs 0, which neither numbers nor an empty head of a binary file do.

    Args:
        head: its first bytes.
        marked: whether a byte-order mark tells enough; the head of a binary file may begin with anything.
    """
    for name, little in (("UTF-32", b"\xff\xfe\0\0"), ("UTF-16", b"\xff\xfe")):
        width, marks = len(little), (little, little[::-1])
        if marked and head.startswith(marks):
            return name
        text = head[width:] if head.startswith(marks) else head
        for own in (0, width - 1):
            letters, others = text[own::width], [text[k::width] for k in range(width) if k != own]
            plain = all(32 <= letter < 127 or letter in b"\t\n\r" for letter in letters)
            if len(letters) >= width and plain and not any(map(any, others)):
                return name
    return None


def _is_binary(data: bytes, suffix: str) -> bool:
    """Return whether a file is one of the binary kind of STL or PLY."""
    if suffix == ".ply":
        return b"format ascii" not in data[: TUNING.head]
    return b"\0" in data[: TUNING.head]
