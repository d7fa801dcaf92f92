"""Lets Drake's parsers read descriptions as other programs write them.

What is put right in a copy: meshes as STL, COLLADA or GLB, OBJ without normals or with JPEGs, packages that lie above
the description, motors or materials of one name, motors of joints that are not there, fixed joints that claim to follow
another one, a name that lacks, shapes without volume, what pybullet says of contact in an SDF, MJCF's bodies without
mass or with several joints; in what a .dmd.yaml names, too. What needs none of it is parsed as it is.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

from pydrake.multibody.parsing import PackageMap, Parser
from pydrake.multibody.tree import ModelInstanceIndex

from twin_diagram.model.description import mesh_files, mjcf_bodies, named_files, unparsed

_KINDS = {".urdf": "urdf", ".sdf": "sdf", ".xml": "xml"}
"""Suffixes of descriptions, and what Drake calls these kinds of text."""

_MESH = {
    ".urdf": re.compile(rb"""(<mesh\b[^>]*?\bfilename\s*=\s*["'])([^"']+)"""),
    ".sdf": re.compile(rb"(<uri>)([^<]+)"),
    ".xml": re.compile(rb"""(<mesh\b[^>]*?\bfile\s*=\s*["'])([^"']+)"""),
}
"""What stands before a mesh's file, and the file."""

_COLLISION = re.compile(rb"<collision\b.*?</collision>", re.DOTALL)
"""Of a URDF or SDF: a shape that may be touched."""

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
"""Of an XML; what it holds is no element."""

_VISUAL = re.compile(rb"<visual\b[^>]*(?:/>|(?<!/)>.*?</visual>)", re.DOTALL)
"""Of a URDF: a shape that is only seen."""

_MESH_FOLDER = re.compile(rb"""<compiler\b[^>]*?\b(meshdir|assetdir)\s*=\s*["']([^"']*)""")
"""Of an MJCF: which attribute, and the folder."""
_INCLUDE = re.compile(rb"""<include\b[^>]*?\bfile\s*=\s*["']([^"']+)["'][^>]*?(?:/>|>\s*</include>)""")
"""Of an MJCF: the file that comes in its place."""
_WRAPPER = re.compile(rb"<\?xml[^>]*\?>|</?mujoco(?:include)?\b[^>]*>")
"""What goes around the contents of such a file."""
_EMPTY_NAME = re.compile(rb"""<mujoco\b([^>]*?)\bmodel\s*=\s*(?:""|'')""")
"""Of an MJCF, which Drake does not take."""
_INERTIAL = re.compile(rb"""<inertial\b[^>]*?\bmass\s*=\s*["']([^"']+)["'][^>]*?(/?)>""")
"""Of an MJCF: the mass, and whether the element ends there."""
_ROBOT = re.compile(rb"<robot\b(?![^>]*\bname\s*=)")
"""Of a URDF that does not say what it is called."""
_JOINT_NAME = re.compile(rb"""<joint\b[^>]*?\bname\s*=\s*["']([^"']*)""")
"""Of a URDF: a joint's name, where it is and where it is spoken of."""
_TRANSMISSION = re.compile(rb"<transmission\b.*?</transmission>", re.DOTALL)
"""Of a URDF: a motor and its joint."""
_ACTUATOR = re.compile(rb"""(<actuator\b[^>]*?\bname\s*=\s*["'])([^"']+)""")
"""What stands before a motor's name, and the name."""
_MATERIAL = re.compile(rb"""(<material\b[^>]*?\bname\s*=\s*["'])([^"']*)(["'][^>]*(?<!/)>.*?</material>)""", re.DOTALL)
"""Of a URDF: what stands before the name of a material, the name, and what the material is."""
_BARE_MATERIAL = re.compile(rb"""<material\b[^>]*?\bname\s*=\s*["']([^"']*)["'][^>]*(?:/>|>\s*</material>)""")
"""Of a URDF: the name of a material that is said elsewhere."""
_FIXED = re.compile(rb"""<joint\b[^>]*\btype\s*=\s*["']fixed["'][^>]*(?<!/)>.*?</joint>""", re.DOTALL)
"""Of a URDF: a fixed joint."""
_SHAPE = re.compile(rb"<(visual|collision)\b[^>]*(?<!/)>.*?</\1>", re.DOTALL)
"""Of a URDF: a shape, seen or touched."""
_EXTENT = re.compile(rb"""<(?:box|cylinder|capsule)\b([^>]*)>""")
"""What says how large one is, of the kinds that Drake ends the program for where they have no volume."""
_MEASURE = re.compile(rb"""\b(?:size|radius|length)\s*=\s*["']([^"']*)""")
"""Of these: the numbers [m]."""
_MIMIC = re.compile(rb"<mimic\b[^>]*/>")
"""What says that a joint follows another one."""

_BULLET = re.compile(
    rb"<contact>\s*(?:<((?:(?:lateral|rolling|spinning)_friction|contact_[ce][fr][mp]|stiffness|damping)\b)[^<]*</\1>\s*)+"
    rb"</contact>"
)
"""Of an SDF: what pybullet alone reads of a link's contact; SDFormat knows no such element there, and refuses it."""
_PAINT = re.compile(rb"<material\b.*?</material>", re.DOTALL)
"""Of an SDF's shape that is touched, and not seen: refused likewise."""

_INCLUDED = re.compile(rb"<(?:\w+:)?include\b")
"""Of an SDF: another model."""

_LITERAL = re.compile(r"<literal-string>\.\w+|<data-string>")
"""What Drake and SDFormat call a text; of what an MJCF says, too, Drake says `.urdf`."""

_NO_MASS = b'<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-15 1e-15 1e-15"'
"""In the place of no mass at all, which Drake ends the program for [kg], [kg·m²]."""


def add_models(
    reader: Parser, path: Path, *, still: bool = False, looked_at: bool = True
) -> tuple[ModelInstanceIndex, ...]:
    """Parse the models of a description.

    Args:
        reader: knows the packages that were told; those found above the description are added to it.
        path: of the description.
        still: of what stands still, wherever it is put: shapes of an MJCF's world get a body, which can be put there.
        looked_at: else a URDF's shapes that are there for eyes alone are left out: of an arm, two thirds of the time.

    Raises:
        ModelError: a mesh that cannot be read.
        RuntimeError: Drake's parser refuses the description.
    """
    kind = path.suffix.lower()
    if kind in named_files.DIRECTIVES and path.is_file():
        return _add_named(reader, path)
    text = _mended(reader, path, still, looked_at) or _unfiled(path)
    if text is None:
        return tuple(reader.AddModels(path))
    try:
        return tuple(reader.AddModelsFromString(text, _KINDS[kind]))
    except RuntimeError as error:
        raise RuntimeError(_LITERAL.sub(lambda _: str(path), str(error))) from error


def _add_named(reader: Parser, path: Path) -> tuple[ModelInstanceIndex, ...]:
    """Parse the models of the files that directives name; what has to be put right, in copies that are not kept."""
    packages, copies = folders_of(reader.package_map()), dict[Path, Path]()
    with TemporaryDirectory() as aside:

        def readable(place: Path) -> Path:
            """Return what is to be read in a file's place."""
            if place in copies:
                return copies[place]
            copies[place] = place
            if place.suffix.lower() in named_files.DIRECTIVES:
                given = text = place.read_text(encoding="utf-8")
                for name, other in named_files.named_in(place, packages):
                    if (copy := readable(other)) != other:
                        text = re.sub(re.escape(name) + r"""(?=["'\s,}]|$)""", copy.as_uri(), text)
                mended = None if text == given else text
            else:
                mended = _mended(reader, place)
            if mended is not None:
                copies[place] = Path(aside) / f"{len(copies)}_{place.name}"
                copies[place].write_text(mended, encoding="utf-8")
            return copies[place]

        try:
            return tuple(reader.AddModels(readable(path)))
        except RuntimeError as error:
            said = str(error)
            for place, copy in copies.items():
                said = said.replace(str(copy), str(place))
            raise RuntimeError(said) from error


def _mended(reader: Parser, path: Path, still: bool = False, looked_at: bool = True) -> str | None:
    """Return a description's text as Drake reads it, its files named by absolute paths; None: it does as it is."""
    kind = path.suffix.lower()
    if kind not in _KINDS or not path.is_file():
        return None
    given = path.read_bytes()
    has_geometry = reader.plant().geometry_source_is_registered()
    if has_geometry:
        for name, folder in named_files.packages_above(given, path, folders_of(reader.package_map())).items():
            reader.package_map().Add(name, folder)
    text = given
    if kind == ".xml":
        text = _mjcf(text, path, still)
    elif kind == ".urdf":
        text = _urdf(text if looked_at or not has_geometry else _untold(text))
    elif kind == ".sdf":
        text = _sdf(text)
    if has_geometry or kind == ".xml":
        text = _MESH[kind].sub(_readable(path, text, folders_of(reader.package_map())), text)
    if text == given:
        return None
    return named_files.anchored(text, path, b"" if kind == ".xml" else b"file://").decode(errors="replace")


def _unfiled(path: Path) -> str | None:
    """Return an SDF's text, its files named by absolute paths: SDFormat reads that in 1 to 15 ms, a file in 45 to 75.

    None where it is no such file, or names others that hold models.
    """
    if path.suffix.lower() != ".sdf" or not path.is_file() or _INCLUDED.search(text := path.read_bytes()):
        return None
    try:
        return named_files.anchored(text, path, b"file://").decode()
    except UnicodeDecodeError:
        return None


def folders_of(packages: PackageMap) -> dict[str, Path]:
    """Return the folders that need no download."""
    own = [name for name in packages.GetPackageNames() if name != "drake_models"]
    return {name: Path(packages.GetPath(name)) for name in own}


def _readable(path: Path, text: bytes, packages: Mapping[str, Path]) -> Callable[[re.Match[bytes]], bytes]:
    """Return what puts a file that Drake reads in the place of a mesh that it does not."""
    folder = path.parent
    if path.suffix.lower() == ".xml":
        said = {match[1]: match[2].decode() for match in _MESH_FOLDER.finditer(text)}
        folder = path.parent / said.get(b"meshdir", said.get(b"assetdir", ""))
    # Of a shape that may be touched Drake takes the hull, unless it is asked to press it in.
    touched = [] if b"hydroelastic" in text else [match.span() for match in _COLLISION.finditer(text)]

    def replaced(match: re.Match[bytes]) -> bytes:
        name = match[2].decode(errors="replace").strip()
        if Path(name).suffix.lower() not in mesh_files.TURNED | {".obj"}:
            return match[0]
        place = named_files.place_of(name, folder, packages)
        if place is None:
            return match[0]
        turned = mesh_files.readable(place)
        if any(start <= match.start() < end for start, end in touched):
            turned = mesh_files.hull_of(turned)
        return match[0] if turned == place else match[1] + str(turned).encode()

    return replaced


def _mjcf(text: bytes, path: Path, still: bool) -> bytes:
    """Return an MJCF in one piece, with a name, a joint a body, and a little mass where it says that there is none."""
    bodiless = still and mjcf_bodies.has_shapes_of_world(unparsed.tree(path))
    if unparsed.is_nameless(path):
        text = _EMPTY_NAME.sub(rb"<mujoco\1", text, count=1).replace(b"<mujoco", b'<mujoco model="robot"', 1)
    if bodiless or _asks_for_one_piece(text, path):
        text = _in_one_piece(text, path.parent, 0)
    if bodiless or not mjcf_bodies.is_plain(unparsed.tree(path)):
        root = ElementTree.fromstring(text)
        if bodiless:
            mjcf_bodies.embody_world(root)
        mjcf_bodies.make_plain(root)
        text = ElementTree.tostring(root)
    return _INERTIAL.sub(lambda match: _NO_MASS + match[2] + b">" if _is_zero(match[1]) else match[0], text)


def _asks_for_one_piece(text: bytes, path: Path) -> bool:
    """Return whether an MJCF includes a file that must be put right, too."""
    whole = _in_one_piece(text, path.parent, 0)
    meshes = (Path(match[2].decode(errors="replace")).suffix.lower() for match in _MESH[".xml"].finditer(whole))
    massless = any(_is_zero(match[1]) for match in _INERTIAL.finditer(whole))
    turned = any(suffix in mesh_files.TURNED for suffix in meshes)
    return massless or turned or not mjcf_bodies.is_plain(unparsed.tree(path))


def _in_one_piece(text: bytes, folder: Path, depth: int) -> bytes:
    """Return an MJCF with the files that it includes in their places, whose paths begin in the first one's folder."""

    def content(match: re.Match[bytes]) -> bytes:
        included = folder / match[1].decode(errors="replace")
        if depth > 8 or not included.is_file():
            return match[0]
        return _in_one_piece(_WRAPPER.sub(b"", included.read_bytes()), folder, depth + 1)

    return _INCLUDE.sub(content, text)


def _is_zero(number: bytes) -> bool:
    try:
        return float(number) == 0.0
    except ValueError:
        return False


def _is_nothing(shape: bytes) -> bool:
    """Return whether a URDF's shape has no volume: a placeholder, of which nothing is seen or touched."""
    return any(
        _is_zero(number)
        for extent in _EXTENT.finditer(shape)
        for measure in _MEASURE.finditer(extent[1])
        for number in measure[1].split()
    )


def _untold(text: bytes) -> bytes:
    """Return a URDF without comments and without shapes that nothing touches; lines keep their numbers."""
    for left_out in (_COMMENT, _VISUAL):
        text = left_out.sub(lambda match: b"\n" * match[0].count(b"\n"), text)
    return text


@lru_cache(maxsize=16)  # an arm is parsed seven times as a loop is built
def _urdf(text: bytes) -> bytes:
    """Return a URDF with a name and no shape without volume.

    In it no name means two things, or none, and no fixed joint follows another.
    """
    motors: set[bytes] = set()
    paints: dict[bytes, bytes] = {}

    def own_motor(match: re.Match[bytes]) -> bytes:
        name = next(each for each in _names(match[2]) if each not in motors)
        motors.add(name)
        return match[1] + name

    def own_paint(match: re.Match[bytes]) -> bytes:
        if _BARE_MATERIAL.fullmatch(match[0]):
            return match[0]
        paint = b"".join(match[3][1:].split())
        name = next(each for each in _names(match[2]) if paints.get(each, paint) == paint)
        paints[name] = paint
        return match[1] + name + match[3]

    there = set(_JOINT_NAME.findall(_TRANSMISSION.sub(b"", text)))

    def own_motors(match: re.Match[bytes]) -> bytes:
        known = there.issuperset(_JOINT_NAME.findall(match[0]))
        return _ACTUATOR.sub(own_motor, match[0]) if known else b"\n" * match[0].count(b"\n")

    text = _TRANSMISSION.sub(own_motors, _MATERIAL.sub(own_paint, text))
    text = _BARE_MATERIAL.sub(lambda match: match[0] if match[1] in paints else b"", text)
    text = _ROBOT.sub(b'<robot name="robot"', text, count=1)
    text = _SHAPE.sub(lambda shape: b"\n" * shape[0].count(b"\n") if _is_nothing(shape[0]) else shape[0], text)
    return _FIXED.sub(lambda joint: _MIMIC.sub(b"", joint[0]), text)


def _sdf(text: bytes) -> bytes:
    """Return an SDF without what pybullet puts into it; lines keep their numbers."""

    def lines(match: re.Match[bytes]) -> bytes:
        return b"\n" * match[0].count(b"\n")

    return _COLLISION.sub(lambda shape: _PAINT.sub(lines, shape[0]), _BULLET.sub(lines, text))


def _names(name: bytes) -> Iterator[bytes]:
    yield name
    for number in itertools.count(2):
        yield b"%s_%d" % (name, number)
