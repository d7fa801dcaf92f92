"""Reads the materials of an OBJ mesh: of each its colour and its texture's file."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_diagram.errors import AssetError


@dataclass
class Material:
    """One material of an .mtl file: its colour (RGB in [0, 1]) and its texture's file, where it tells them."""

    colour: tuple[float, float, float] | None = None
    texture: str | None = None


def materials_of(text: str, where: str) -> dict[str, Material]:
    """Return the materials of an .mtl file's text by name; `where` begins the message of an error.

    Raises:
        AssetError: a colour is none.
    """
    found: dict[str, Material] = {}
    material = Material()
    for line in text.splitlines():
        key, *rest = line.split() or [""]
        if key == "newmtl":
            material = found.setdefault(" ".join(rest), Material())
        elif key == "Kd":
            material.colour = _colour(rest, f"{where}: a colour is three numbers, not {line.strip()!r}")
        elif key.lower() == "map_kd":
            material.texture = _texture_name(rest)
    return found


def _colour(words: list[str], wrong: str) -> tuple[float, float, float]:
    """Return RGB: of three numbers, of one for all three, or of four, of which the last is no colour's.

    Raises:
        AssetError: it is none; `wrong` is the message.
    """
    if len(words) not in (1, 3, 4) or not all(map(_is_number, words)):
        raise AssetError(wrong)
    told = [float(word) for word in words]
    if not np.isfinite(told).all():
        raise AssetError(wrong)
    r, g, b = told[:3] if len(told) > 1 else 3 * told
    return r, g, b


def _texture_name(words: list[str]) -> str:
    """Return the file that a line `map_Kd` names, without the options before it."""
    at = 0
    while at < len(words) and words[at].startswith("-") and len(words) > at + 1:
        option, at = words[at], at + 1
        if option in ("-o", "-s", "-t"):  # one to three numbers
            while at < len(words) - 1 and _is_number(words[at]):
                at += 1
        else:
            at += 2 if option == "-mm" else 1
    return " ".join(words[at:])


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
