"""Refuses what no arm can have, and what would be read as something else.

Drake takes a negative mass for a positive one, warns of a negative moment of inertia among a hundred other things, ends
the program at some limits, and of a number with a decimal comma reads what stands before it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from xml.etree.ElementTree import Element

from twin_diagram.errors import ModelError
from twin_diagram.model.description import mjcf_bodies, unparsed

Told = tuple[Sequence[tuple[Element, str | None]], Sequence[tuple[Element, str | None, str | None]]]
"""Links with their masses, joints with their lower and upper limits."""

ROUNDING = 1e-6
"""So far below zero a moment of inertia may be [kg·m²]: descriptions made by programs hold zeros rounded to less."""
_MOMENTS = ("ixx", "iyy", "izz")
"""About the axes: as attributes and as elements."""


_ROUNDED = 1e-9
"""By this share moments may be off; what is nearer Drake itself takes or refuses."""
_MADE = ("replicate", "attach", "composite")
"""Of an MJCF: what MuJoCo makes bodies and shapes of."""
_SAVE = 'give its <compiler> saveinertial="true", load it in MuJoCo, save it by mujoco.mj_saveLastXML, and use that'
"""States what MuJoCo makes of it."""

_COMMA = re.compile(r"[-+]?\d*,\d+")
"""A number as exporters write it where their system's language has decimal commas."""
_VECTOR = re.compile(r"Expected 3 values for attribute (\w+) got (.*)", re.DOTALL)
"""What Drake's parser says of a URDF's, without saying whose."""
_NO_NUMBERS = frozenset({"name", "filename", "file", "uri", "link", "parent", "child"})
"""Attributes and elements whose words may look like one."""


def refuse_impossible(path: Path) -> None:
    """Refuse a URDF, SDF or MJCF with negative masses or moments, decimal commas, or a lower limit above its upper one.

    Numbers that are none are left to the parser, which names them.

    Raises:
        ModelError: names the link or the joint, and the value.
    """
    if path.suffix.lower() not in (".urdf", ".sdf", ".xml") or not path.is_file():
        return
    root = unparsed.tree(path)
    if path.suffix.lower() == ".xml":  # a tree of its own each time, see `unparsed`
        _refuse(path, root)
    else:
        _refuse_once(path, root)


@lru_cache(maxsize=16)  # an arm is parsed seven times as a loop is built; what is refused is not kept
def _refuse_once(path: Path, root: Element) -> None:
    _refuse(path, root)


def _refuse(path: Path, root: Element) -> None:
    """Refuse what is impossible in a file whose root is given."""
    reads = {".urdf": _urdf, ".sdf": _sdf, ".xml": _mjcf}[path.suffix.lower()]
    _refuse_commas(path, root)
    _refuse_unread(path, root)
    _refuse_unbalanced(path, root)
    masses, limits = reads(root)
    for link, word in masses:
        if (mass := _number(word)) < 0:
            raise ModelError(f"{path}: link {_name(link)!r}: a mass of {mass:g} kg; it cannot be negative")
    for link, word in _moments(root):
        if (moment := _number(word)) < -ROUNDING:
            raise ModelError(f"{path}: link {_name(link)!r}: a moment of {moment:g} kg·m²; it cannot be negative")
    for joint, *words in limits:
        low, high = map(_number, words)
        if low > high:
            raise ModelError(
                f"{path}: joint {_name(joint)!r}: its lower limit {low:g} lies above its upper one {high:g}"
            )


def with_owner(path: Path, said: str) -> str:
    """Return what Drake's parser says of a description, with the link or joint where it is of a vector and names none.

    Args:
        path: of the description.
        said: by the parser.
    """
    found = _VECTOR.fullmatch(said)
    if found is None or path.suffix.lower() != ".urdf":
        return said
    key, text = found.groups()
    parts = [part for part in unparsed.tree(path) if part.tag in ("link", "joint")]
    owners = (part for part in parts if any(each.get(key, "").split() == text.split() for each in part.iter()))
    whose = next((f"{part.tag} {_name(part)!r}: " for part in owners), "")
    left = "; $(…) is left of a xacro, which must be expanded" if "$(" in text else ""
    return f"{whose}{key} is {text!r}; it is three numbers with blanks between them{left}"


def _refuse_unread(path: Path, root: Element) -> None:
    """Refuse what of an MJCF Drake passes over although masses or bodies come of it."""
    for compiler in root.iter("compiler"):
        if _number(total := compiler.get("settotalmass")) > 0.0:
            raise ModelError(f"{path}: settotalmass {total}: Drake does not scale masses; state them as they are")
    for tag in _MADE:
        if root.find(f"worldbody//body//{tag}") is not None:
            raise ModelError(f"{path}: Drake does not read <{tag}>; {_SAVE}")
    shells = {mesh.get("name", Path(mesh.get("file", "")).stem) for mesh in root.iter("mesh") if _is_shell(mesh.attrib)}
    for geom, said, counts in mjcf_bodies.shapes(root):
        if counts and (_is_shell(said) or said.get("mesh") in shells):
            raise ModelError(f"{path}: geom {_name(geom)!r} is a shell, which Drake takes for solid; {_SAVE}")


def _refuse_unbalanced(path: Path, root: Element) -> None:
    """Refuse principal moments of an MJCF's body that no body has; Drake does not say which body's they are."""
    if any(compiler.get("inertiafromgeom") == "true" for compiler in root.iter("compiler")):
        return
    stated = [(body, inertial) for body in root.iter("body") for inertial in body.findall("inertial")]
    for body, inertial in stated:
        moments = [_number(word) for word in inertial.get("diaginertia", "").split()]
        if _number(inertial.get("mass")) > 0.0 and 2.0 * max(moments, default=0.0) > (1.0 + _ROUNDED) * sum(moments):
            said = " ".join(f"{moment:g}" for moment in moments)
            raise ModelError(
                f"{path}: body {_name(body)!r}: moments of inertia {said} kg·m²: none can be more than the other two "
                "together; Drake does not balance them as MuJoCo can"
            )


def _is_shell(said: Mapping[str, str]) -> bool:
    return said.get("shellinertia") == "true" or said.get("inertia") == "shell"


def _refuse_commas(path: Path, element: Element, owner: str = "") -> None:
    if element.tag in ("link", "body", "joint"):
        owner = f"{element.tag} {_name(element)!r}"
    for key, text in (*element.items(), (element.tag, element.text or "")) if owner else ():
        comma = key not in _NO_NUMBERS and next(filter(_COMMA.fullmatch, text.split()), "")
        if comma:
            raise ModelError(f"{path}: {owner}: {key} is {comma}; write a point, {comma.replace(',', '.')}")
    for child in element:
        _refuse_commas(path, child, owner)


def _moments(root: Element) -> list[tuple[Element, str | None]]:
    """Return the links of a URDF or SDF with their moments of inertia; an MJCF's are checked where it is parsed."""
    return [
        (link, one.get(name) or one.findtext(name))
        for link in root.iter("link")
        for one in link.findall("inertial/inertia")
        for name in _MOMENTS
    ]


def _urdf(root: Element) -> Told:
    masses = [(link, one.get("value")) for link in root.findall("link") for one in link.findall("inertial/mass")]
    bounded = [joint for joint in root.findall("joint") if joint.get("type") in ("revolute", "prismatic")]
    limits = [
        (joint, one.get("lower", "0"), one.get("upper", "0")) for joint in bounded for one in joint.findall("limit")
    ]
    return masses, limits


def _sdf(root: Element) -> Told:
    limits = [(joint, one) for joint in root.iter("joint") for one in joint.findall("axis/limit")]
    return (
        [(link, link.findtext("inertial/mass")) for link in root.iter("link")],
        [(joint, one.findtext("lower"), one.findtext("upper")) for joint, one in limits],
    )


def _mjcf(root: Element) -> Told:
    parts = [(body, part) for body in root.iter("body") for part in (*body.findall("inertial"), *body.findall("geom"))]
    ranges = [(joint, (joint.get("range") or "").split()) for joint in root.iter("joint")]
    return (
        [(body, part.get("mass")) for body, part in parts],
        [(joint, words[0], words[1]) for joint, words in ranges if len(words) == 2 and joint.get("limited") != "false"],
    )


def _number(word: str | None) -> float:
    """Return a number, or NaN, which is neither above nor below any."""
    try:
        return math.nan if word is None else float(word)
    except ValueError:
        return math.nan


def _name(element: Element) -> str:
    return element.get("name", element.get("class", ""))
