"""Tells an MJCF's bodies as Drake reads them: one joint each, no `<frame>`, no shape fitted to a mesh, whole defaults.

Also no shape that counts for no inertia, no box or ellipsoid between two points, no gravity that a flag takes off.

Of several joints of a body Drake puts the last one, not the first, where the body stands, and it passes over frames
with all that is in them. So each joint but the last gets a body of its own around the body, and a frame becomes a body
without a joint, which is the same. A sphere or box that is as large as its mesh is refused by Drake: the mesh, as its
convex hull, takes its place. What a class of defaults has from those around it Drake forgets where the class says
nothing of its own of that kind, axes of joints among it: the class gets an empty element. Shapes that have no part
in inertia, by their group or in a frame of a body that states its mass, Drake would weigh: they get a mass of 0. Boxes
and ellipsoids between two points it leaves out: they get a place and a size.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from xml.etree.ElementTree import Element

import numpy as np

from twin_diagram.errors import ModelError
from twin_diagram.model.description import unparsed

_OUTSIDE = ("pos", "quat", "axisangle", "xyaxes", "zaxis", "euler", "childclass")
"""Attributes of a body that go to the outermost of those around it: where it stands, and what holds for its joints."""

_BY_DEFAULT = ("joint", "geom", "mesh", "general", "motor", "position", "velocity")
"""What classes of defaults speak of, and Drake takes from them."""

_WORLDS = "shapes_of_world"
"""Name of the body that holds what a file puts into no body."""


def is_plain(root: Element) -> bool:
    """Return whether a file holds none of these."""
    if any(True for _ in _forgotten(root)):
        return False
    several = any(len(body.findall("joint")) > 1 for body in root.iter("body"))
    if root.find(".//frame") is not None or several or any(_is_fitted(geom) for geom in root.iter("geom")):
        return False
    return not (_weighs_by_group(root) or _is_weightless(root) or any(True for _ in _between_points(root)))


def make_plain(root: Element) -> None:
    """Put an MJCF's bodies, frames and shapes right.

    Raises:
        ModelError: a frame holds a joint or the mass of the body around it.
    """
    for geom, _, counts in shapes(root):
        if not counts:
            geom.set("mass", "0")
    for number, frame in enumerate(list(root.iter("frame"))):
        name = frame.get("name", "frame")
        if any(frame.find(tag) is not None for tag in ("joint", "freejoint", "inertial")):
            raise ModelError(f"{name!r}: a joint or a mass within a frame is not read; put it into its body")
        frame.tag = "body"
        frame.set("name", f"{name}_{number}")
    for geom in filter(_is_fitted, root.iter("geom")):
        geom.set("type", "mesh")
    for defaults, tag in _forgotten(root):
        defaults.insert(0, Element(tag))
    for geom, said in _between_points(root):
        _place(geom, said)
    if _is_weightless(root):
        for option in root.iter("option"):
            option.set("gravity", "0 0 0")
    for parent in list(root.iter()):
        for place, child in enumerate(parent):
            if child.tag == "body":
                parent[place] = _one_joint_each(child)


def has_shapes_of_world(root: Element) -> bool:
    """Return whether a file holds shapes that belong to no body: a floor, a pillar."""
    return any(world.find("geom") is not None for world in root.iter("worldbody"))


def embody_world(root: Element) -> None:
    """Give the shapes of an MJCF's world a body that stands at its origin."""
    for number, world in enumerate(root.iter("worldbody")):
        loose = world.findall("geom")
        if loose:
            body = Element("body", {"name": f"{_WORLDS}_{number}"})
            body.extend(loose)
            for geom in loose:
                world.remove(geom)
            world.insert(0, body)


def _forgotten(root: Element) -> Iterator[tuple[Element, str]]:
    """Yield, from the outermost in, each class of defaults and a kind that only the class around it speaks of."""
    for around in root.iter("default"):
        for defaults in around.findall("default"):
            for tag in _BY_DEFAULT:
                if around.find(tag) is not None and defaults.find(tag) is None:
                    yield defaults, tag


def _is_fitted(geom: Element) -> bool:
    """Return whether a shape is of a simple kind, and takes its size from a mesh."""
    return geom.get("mesh") is not None and geom.get("type", "mesh") not in ("mesh", "sdf")


def _weighs_by_group(root: Element) -> bool:
    return any(compiler.get("inertiagrouprange") for compiler in root.iter("compiler"))


def _is_weightless(root: Element) -> bool:
    return any(flag.get("gravity") == "disable" for option in root.iter("option") for flag in option.iter("flag"))


def shapes(root: Element) -> Iterator[tuple[Element, Mapping[str, str], bool]]:
    """Yield each shape of an MJCF's bodies, what is said of it, by its class, too, and whether it has part in inertia.

    It has none where its body, or the one around its frame, states a mass, or where its group does not count.
    """
    classes = unparsed.of_classes(root, ("geom",))
    by_shapes = any(compiler.get("inertiafromgeom") == "true" for compiler in root.iter("compiler"))
    groups = [compiler.get("inertiagrouprange", "").split() for compiler in root.iter("compiler")]
    low, high = ([float(word) for words in groups for word in words] or [-np.inf, np.inf])[-2:]

    def walk(element: Element, inherited: str, counts: bool) -> Iterator[tuple[Element, Mapping[str, str], bool]]:
        inherited = element.get("childclass", inherited)
        for geom in element.findall("geom"):
            said = {**classes.get(geom.get("class", inherited), {}), **geom.attrib}
            yield geom, said, counts and low <= float(said.get("group", "0")) <= high
        for inner in element:
            if inner.tag == "body":
                yield from walk(inner, inherited, by_shapes or inner.find("inertial") is None)
            elif inner.tag == "frame":
                yield from walk(inner, inherited, counts)

    for world in root.findall("worldbody"):
        yield from walk(world, "main", True)


def _between_points(root: Element) -> Iterator[tuple[Element, Mapping[str, str]]]:
    for geom, said, _ in shapes(root):
        if "fromto" in said and said.get("type") in ("box", "ellipsoid"):
            yield geom, said


def _place(geom: Element, said: Mapping[str, str]) -> None:
    """Say of a shape between two points where it stands, along what, and how large it is."""
    ends = np.array([float(word) for word in said["fromto"].split()]).reshape(2, 3)
    along, wide = ends[1] - ends[0], said.get("size", "0").split()[0]
    geom.attrib.pop("fromto", None)
    geom.set("pos", " ".join(map(repr, ends.mean(axis=0).tolist())))
    geom.set("zaxis", " ".join(map(repr, along.tolist())))
    geom.set("size", f"{wide} {wide} {0.5 * float(np.linalg.norm(along))!r}")


def _one_joint_each(body: Element) -> Element:
    """Return the outermost of the bodies that stand for one."""
    outer = body
    for number, joint in enumerate(reversed(body.findall("joint")[:-1])):
        body.remove(joint)
        around = Element("body", {"name": f"{body.get('name', 'body')}_around_{number}"})
        around.extend([joint, outer])
        outer = around
    if outer is not body:
        outer.attrib |= {key: body.attrib.pop(key) for key in _OUTSIDE if key in body.attrib}
    return outer
