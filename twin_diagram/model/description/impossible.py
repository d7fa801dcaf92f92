"""Refuses what no arm can have: Drake takes a negative mass for a positive one, and ends the program at some limits."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

from twin_diagram.errors import ModelError
from twin_diagram.model.description import unparsed


def refuse_impossible(path: Path) -> None:
    """Refuse a URDF, SDF or MJCF with a negative mass, or with a joint whose lower limit lies above its upper one.

    Numbers that are none are left to the parser, which names them.

    Raises:
        ModelError: names the link or the joint, and the value.
    """
    said = {".urdf": _urdf, ".sdf": _sdf, ".xml": _mjcf}.get(path.suffix.lower())
    if said is None or not path.is_file():
        return
    for what, name, low, high in said(unparsed.tree(path)):
        if what == "mass" and high < 0:
            raise ModelError(f"{path}: link {name!r}: a mass of {high:g} kg; it cannot be negative")
        if what == "limits" and low > high:
            raise ModelError(f"{path}: joint {name!r}: its lower limit {low:g} lies above its upper one {high:g}")


Found = Iterator[tuple[str, str, float, float]]
"""`mass` of a link, twice, or `limits` of a joint."""


def _urdf(root: Element) -> Found:
    for link in root.findall("link"):
        mass = link.find("inertial/mass")
        if mass is not None:
            yield from _numbers("mass", link, [mass.get("value")] * 2)
    for joint in root.findall("joint"):
        limit = joint.find("limit")
        if limit is not None and joint.get("type") in ("revolute", "prismatic"):
            yield from _numbers("limits", joint, [limit.get("lower", "0"), limit.get("upper", "0")])


def _sdf(root: Element) -> Found:
    for link in root.iter("link"):
        yield from _numbers("mass", link, [link.findtext("inertial/mass")] * 2)
    for joint in root.iter("joint"):
        limit = joint.find("axis/limit")
        if limit is not None:
            yield from _numbers("limits", joint, [limit.findtext("lower"), limit.findtext("upper")])


def _mjcf(root: Element) -> Found:
    for body in root.iter("body"):
        for part in (*body.findall("inertial"), *body.findall("geom")):
            yield from _numbers("mass", body, [part.get("mass")] * 2)
    for joint in root.iter("joint"):
        if joint.get("limited") != "false":
            yield from _numbers("limits", joint, (joint.get("range") or "").split())


def _numbers(what: str, element: Element, words: list[str | None] | list[str]) -> Found:
    try:
        low, high = (float(word) for word in words if word is not None)
    except ValueError:
        return
    yield what, element.get("name", element.get("class", "")), low, high
