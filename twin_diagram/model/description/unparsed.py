"""What descriptions say of their joints that Drake's parsers leave unread: dry friction, MJCF's springs and rotors.

A description that states friction is a model with friction; without this, its own friction would be taken for an effect
that it lacks.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TypeVar
from xml.etree.ElementTree import Element

from twin_diagram.errors import ModelError

T = TypeVar("T")
_PREFIX = re.compile(rb"(?<=[<\s/])(\w+):(?=\w[\w.-]*[\s=>/])")
"""`drake:` and its like in names of elements and attributes."""
_MIMIC = re.compile(r"(?:\{.*\}|\w+_)?mimic")
"""With a namespace that is declared, or one that `_root` made part of the name."""
_MOTORS = ("general", "motor", "position", "velocity", "intvelocity", "damper")
"""Of an MJCF: motors at joints; its classes of defaults take them for one kind."""
_DIFFERENTIAL = "DifferentialTransmission"
"""Of a URDF: what two motors and two joints share."""
_HOW_IT_FOLLOWS = {"multiplier": "1", "offset": "0", "reference": "0"}
"""What is said of a joint that follows: attributes, or SDF's elements; and what counts where they are missing."""


@dataclass(frozen=True)
class StatedDynamics:
    """What a description states of an arm's joints; those of which it states nothing are left out.

    Attributes:
        friction: level of dry friction per joint [N·m].
        springs: stiffness [N·m/rad] and position at rest [rad] per joint.
    """

    friction: Mapping[str, float] = field(default_factory=dict)
    springs: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def of_all(read: Callable[[Path], Mapping[str, T]], parts: Sequence[Path]) -> dict[str, T]:
    """Return what is read of all files of a description, by joint; of two of one name, what the first file says.

    Args:
        read: `armatures`, `following`, `driven` or `effort_limits`.
        parts: the files, see `named_files.parts_of`.

    Raises:
        ModelError: a number that cannot be read.
    """
    return {name: value for part in reversed(parts) for name, value in read(part).items()}


def stated_dynamics(parts: Sequence[Path], joints: Sequence[str]) -> StatedDynamics:
    """Return the friction and springs of an arm's joints that its description states.

    Args:
        parts: its files: URDF, SDF or MJCF; others state none here.
        joints: the arm's.

    Raises:
        ModelError: a number that cannot be read.
    """
    found = of_all(_stated, parts)
    own = {joint: found[joint] for joint in joints if joint in found}
    return StatedDynamics(
        {joint: friction for joint, (friction, _, _) in own.items() if friction > 0.0},
        {joint: (stiffness, rest) for joint, (_, stiffness, rest) in own.items() if stiffness > 0.0},
    )


def _stated(path: Path) -> dict[str, tuple[float, float, float]]:
    """Return friction, stiffness and position at rest of a file's joints."""
    suffix = path.suffix.lower()
    if suffix not in (".urdf", ".sdf", ".xml"):
        return {}
    root = _root(path)
    try:
        if suffix == ".xml":
            return {name: values[:3] for name, values in _mjcf(root, path.parent)}
        return {name: (friction, 0.0, 0.0) for name, friction in _urdf_or_sdf(root)}
    except ValueError as error:
        raise ModelError(f"{path}: joint: {error}") from error


def armatures(path: Path) -> dict[str, float]:
    """Return rotor inertias of an MJCF's joints; Drake itself keeps those of joints with a `motor` or `position` alone.

    Raises:
        ModelError: a number that cannot be read.
    """
    if path.suffix.lower() != ".xml":
        return {}
    try:
        return {name: values[3] for name, values in _mjcf(_root(path), path.parent)}
    except ValueError as error:
        raise ModelError(f"{path}: joint: {error}") from error


@dataclass(frozen=True)
class Following:
    """How a joint follows another one, and so has no motor: `multiplier` times the leader's position, and `offset`."""

    leader: str
    multiplier: float
    offset: float


def following(path: Path) -> dict[str, Following]:
    """Return the joints of a URDF, SDF or MJCF that follow another one, by name; fixed ones do not.

    Of two joints that an MJCF holds equal in proportion, the one without a motor follows. An SDF says it in its own
    words, which Drake passes over, or in Drake's.

    Raises:
        ModelError: a number that cannot be read.
    """
    if path.suffix.lower() == ".xml":
        return _held_equal(path)
    if path.suffix.lower() not in (".urdf", ".sdf"):
        return {}
    found = {}
    for joint in _root(path).iter("joint"):
        mimic = next((each for each in joint.iter() if _MIMIC.fullmatch(each.tag)), None)
        if mimic is None or joint.get("type") == "fixed":
            continue
        words = [mimic.get(key) or mimic.findtext(key) or usual for key, usual in _HOW_IT_FOLLOWS.items()]
        try:
            multiplier, offset, reference = map(float, words)
        except ValueError as error:
            raise ModelError(f"{path}: mimic of joint {joint.get('name', '')!r}: {error}") from error
        leader = mimic.get("joint", "").rpartition("::")[2]
        found[joint.get("name", "")] = Following(leader, multiplier, offset - multiplier * reference)
    return found


def _held_equal(path: Path) -> dict[str, Following]:
    """Return `following` of an MJCF: what its ``<equality>`` says of joints, which Drake passes over."""
    root, found = tree(path), {}
    driven = {motor.get("joint") for actuator in root.iter("actuator") for motor in actuator}
    for joint in (joint for equality in root.findall("equality") for joint in equality.findall("joint")):
        name, leader = joint.get("joint1", ""), joint.get("joint2", "")
        try:
            offset, multiplier, *bends = map(float, joint.get("polycoef", "0 1 0 0 0").split())
        except ValueError as error:
            raise ModelError(f"{path}: equality of joint {name!r}: polycoef: {error}") from error
        if not leader or any(bends) or joint.get("active") == "false":
            continue
        if name in driven and leader not in driven and multiplier != 0.0:
            name, leader, multiplier, offset = leader, name, 1.0 / multiplier, -offset / multiplier
        found[name] = Following(leader, multiplier, offset)
    return found


def effort_limits(path: Path) -> dict[str, float]:
    """Return the effort limits of a URDF's or MJCF's joints.

    Of a URDF Drake itself keeps those of joints with a transmission alone, of an MJCF those that a `motor` or
    `position` states itself, without its gear.

    Raises:
        ModelError: a number that cannot be read.
    """
    if path.suffix.lower() == ".xml":
        try:
            return dict(_motor_limits(tree(path)))
        except ValueError as error:
            raise ModelError(f"{path}: actuator: {error}") from error
    if path.suffix.lower() != ".urdf":
        return {}
    each = [(joint.get("name", ""), joint.find("limit")) for joint in _root(path).iter("joint")]
    efforts = {name: float(limit.get("effort", "0")) for name, limit in each if limit is not None}
    return {name: effort for name, effort in efforts.items() if effort > 0.0}


def driven(path: Path) -> dict[str, bool]:
    """Return whether each joint of an MJCF has a motor of its own; Drake passes over most kinds of them.

    Nothing is said of the joints of one in which no joint has a motor, and of a URDF's but of those that two motors
    move through a differential, as many wrists: of these Drake keeps no motor.
    """
    if path.suffix.lower() == ".urdf":
        geared = [gear for gear in _root(path).iter("transmission") if _DIFFERENTIAL in (gear.findtext("type") or "")]
        return {joint.get("name", ""): True for gear in geared for joint in gear.iter("joint")}
    if path.suffix.lower() != ".xml":
        return {}
    root = tree(path)
    motors = {motor.get("joint") for actuator in root.iter("actuator") for motor in actuator} - {None}
    joints = (joint.get("name", "") for world in root.iter("worldbody") for joint in world.iter("joint"))
    return {name: name in motors for name in joints} if motors else {}


def pulls_tendons(path: Path) -> bool:
    """Return whether a motor of an MJCF pulls a tendon; Drake reads neither."""
    if path.suffix.lower() != ".xml":
        return False
    return any(motor.get("tendon") for actuator in tree(path).iter("actuator") for motor in actuator)


def _motor_limits(root: Element) -> Iterator[tuple[str, float]]:
    """Yield what each motor of an MJCF gives its joint at most, where that is limited."""
    limited = "false" if any(each.get("autolimits") == "false" for each in root.findall("compiler")) else "true"
    classes = of_classes(root, _MOTORS)
    for motor in (motor for actuator in root.iter("actuator") for motor in actuator if motor.get("joint")):
        said = {"gear": "1", "gainprm": "1", **classes.get(motor.get("class", "main"), {}), **motor.attrib}
        most = math.inf
        ranges = {"forcerange": ("forcelimited", 1.0)}
        if motor.tag == "motor" or (motor.tag == "general" and said.get("biastype", "none") == "none"):
            ranges["ctrlrange"] = ("ctrllimited", 1.0 if motor.tag == "motor" else float(said["gainprm"].split()[0]))
        for name, (switch, gain) in ranges.items():
            if name in said and said.get(switch, "auto").replace("auto", limited) == "true":
                most = min(most, abs(gain) * max(abs(float(end)) for end in said[name].split()))
        if 0.0 < most < math.inf:
            yield motor.get("joint", ""), most * abs(float(said["gear"].split()[0]))


def is_nameless(path: Path) -> bool:
    """Return whether a file is an MJCF that does not say what its model is called; Drake asks for a name."""
    if path.suffix.lower() != ".xml" or not path.is_file():
        return False
    root = _root(path)
    return root.tag == "mujoco" and not root.get("model")


def tree(path: Path) -> Element:
    """Return the root of a description, of an MJCF with the files that it includes."""
    root = _root(path)
    if path.suffix.lower() == ".xml":
        _include(root, path.parent)
    return root


def _root(path: Path) -> Element:
    """Return the root of a file that Drake could read.

    An MJCF's is the caller's own, as what it includes is put into it; others are read by many, and changed by nobody.
    """
    text = path.read_bytes()
    return _read(text) if path.suffix.lower() == ".xml" else _kept(text)


@lru_cache(maxsize=16)  # a twin's arm is described in one or two files, and asked about some sixty times as it is built
def _kept(text: bytes) -> Element:
    return _read(text)


def _read(text: bytes) -> Element:
    """Return the root of an XML; namespaces need not be declared, and what is no XML holds nothing."""
    try:
        return ElementTree.fromstring(text)
    except ElementTree.ParseError:
        pass
    try:
        return ElementTree.fromstring(_PREFIX.sub(rb"\1_", text))
    except ElementTree.ParseError:
        return Element("unreadable")


def _urdf_or_sdf(root: Element) -> Iterator[tuple[str, float]]:
    for joint in root.iter("joint"):
        dynamics = joint.find("dynamics")
        inside = joint.find("axis/dynamics/friction")
        if dynamics is not None and dynamics.get("friction"):
            yield joint.get("name", ""), float(dynamics.get("friction", "0"))
        elif inside is not None and inside.text:
            yield joint.get("name", ""), float(inside.text)


def _mjcf(root: Element, folder: Path) -> Iterator[tuple[str, tuple[float, float, float, float]]]:
    """Yield dry friction, stiffness, rest position and rotor inertia of each joint that has a name."""
    _include(root, folder)
    degrees = all(compiler.get("angle", "degree") == "degree" for compiler in root.iter("compiler"))
    classes = of_classes(root, ("joint",))

    def walk(element: Element, inherited: str) -> Iterator[tuple[str, tuple[float, float, float, float]]]:
        inherited = element.get("childclass", inherited)
        for joint in element.findall("joint"):
            attributes = {**classes.get(joint.get("class", inherited), {}), **joint.attrib}
            scale = math.pi / 180.0 if degrees and attributes.get("type", "hinge") == "hinge" else 1.0
            keys = ("frictionloss", "stiffness", "springref", "armature")
            friction, stiffness, rest, rotor = (float(attributes.get(key, "0")) for key in keys)
            yield joint.get("name", ""), (friction, stiffness, scale * rest, rotor)
        for inner in element:
            if inner.tag in ("body", "frame"):
                yield from walk(inner, inherited)

    for world in root.findall("worldbody"):
        yield from walk(world, "main")


def of_classes(root: Element, tags: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return what each class of an MJCF's defaults says of elements of a kind, what it has from others among it."""
    classes: dict[str, dict[str, str]] = {"main": {}}
    for default in root.findall("default"):
        _defaults(default, tags, {}, classes)
    return classes


def _defaults(
    element: Element, tags: Sequence[str], inherited: Mapping[str, str], classes: dict[str, dict[str, str]]
) -> None:
    own = dict(inherited)
    for said in (child for child in element if child.tag in tags):
        own |= said.attrib
    classes[element.get("class", "main")] = own
    for nested in element.findall("default"):
        _defaults(nested, tags, own, classes)


def _include(element: Element, folder: Path) -> None:
    """Put the contents of included files in their place."""
    for child in list(element):
        if child.tag == "include" and (folder / child.get("file", "")).is_file():
            included = _root(folder / child.get("file", ""))
            _include(included, folder)
            element.extend(included)
        else:
            _include(child, folder)
