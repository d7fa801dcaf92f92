"""Tells an MJCF's bodies as Drake reads them: one joint each, no `<frame>`, no shape fitted to a mesh, whole defaults.

Of several joints of a body Drake puts the last one, not the first, where the body stands, and it passes over frames
with all that is in them. So each joint but the last gets a body of its own around the body, and a frame becomes a body
without a joint, which is the same. A sphere or box that is as large as its mesh is refused by Drake: the mesh, as its
convex hull, takes its place. What a class of defaults has from those around it Drake forgets where the class says
nothing of its own of that kind, axes of joints among it: the class gets an empty element.
"""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree.ElementTree import Element

from twin_diagram.errors import ModelError

_OUTSIDE = ("pos", "quat", "axisangle", "xyaxes", "zaxis", "euler", "childclass")
"""Attributes of a body that go to the outermost of those around it: where it stands, and what holds for its joints."""

_BY_DEFAULT = ("joint", "geom", "mesh", "general", "motor", "position", "velocity")
"""What classes of defaults speak of, and Drake takes from them."""


def is_plain(root: Element) -> bool:
    """Return whether a file holds none of these."""
    if any(True for _ in _forgotten(root)):
        return False
    several = any(len(body.findall("joint")) > 1 for body in root.iter("body"))
    return root.find(".//frame") is None and not several and not any(_is_fitted(geom) for geom in root.iter("geom"))


def make_plain(root: Element) -> None:
    """Put an MJCF's bodies, frames and shapes right.

    Raises:
        ModelError: a frame holds a joint or the mass of the body around it.
    """
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
    for parent in list(root.iter()):
        for place, child in enumerate(parent):
            if child.tag == "body":
                parent[place] = _one_joint_each(child)


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
