"""The command `twin-diagram assets`: build, list, check, remove, improve. Cheap to import, as the command line is."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin_diagram.errors import AssetError
from twin_diagram.runtime.command_parser import add_command
from twin_diagram.runtime.progress import say_beside

if TYPE_CHECKING:
    from twin_diagram.assets.building.from_mesh import BuiltAsset
    from twin_diagram.assets.library import LibraryEntry


def add_asset_commands(commands: Any) -> None:
    """Add the commands about objects."""
    assets = add_command(commands, "assets", "build, list, check and remove the known objects of a library")
    ways = assets.add_subparsers(metavar="WHAT", required=True)

    build = add_command(ways, "build", "make an asset of pictures or a mesh, for a scenario's twin.library")
    build.add_argument(
        "source",
        type=Path,
        metavar="SOURCE",
        help="a folder of posed RGB-D frames (BOP's layout, or Nerfstudio's transforms.json with depth), VGGT's "
        "predictions (.npz), or a mesh: .obj, .stl, .ply (z upwards), .glb or .gltf (y upwards), .dae (as it says)",
    )
    build.add_argument("--name", required=True, help="of the asset: letters, digits, '_', '-'")
    build.add_argument("--mass", type=float, help="of the object [kg]")
    build.add_argument("--density", type=float, help="[kg/m³], instead of a mass (default: water's)")
    build.add_argument("--masks", type=Path, metavar="D", help="folder of masks, beside or instead of the frames' own")
    build.add_argument("--cube-edge", type=float, metavar="M", help="edge of the green cube in predictions [m]")
    build.add_argument("--unit", default="m", help="of the mesh: m, cm, mm or in (default: %(default)s)")
    build.add_argument(
        "--root",
        type=Path,
        metavar="DIR",
        help="folder within which a mesh may name textures, also without their folder, as those in "
        "DIR/materials/textures (default: its own)",
    )
    build.add_argument("--replace", action="store_true", help="write an asset of that name anew")
    build.set_defaults(command=_build)

    listed = add_command(ways, "list", "what is in a library; what is corrupt is named and left out")
    listed.set_defaults(command=_list)
    check = add_command(ways, "check", "read every file of an asset, or of all; exits with 2 where one is corrupt")
    check.add_argument("name", nargs="?", help="without it: all")
    check.set_defaults(command=_check)
    remove = add_command(ways, "remove", "take an asset out of a library")
    remove.add_argument("name", help="of the asset")
    remove.set_defaults(command=_remove)
    improve = add_command(ways, "improve", "hold an asset more closely by CoACD's convex pieces, which takes minutes")
    improve.add_argument("name")
    improve.add_argument("--limit", type=float, metavar="S", help="give up after so long [s] (default: 600)")
    improve.set_defaults(command=_improve)
    for way in (build, listed, check, remove, improve):
        way.add_argument("--library", required=True, type=Path, metavar="DIR", help="the folder of assets")


def _build(arguments: argparse.Namespace) -> int:
    built = _built(arguments)
    for note in built.notes:
        print(f"note: {note}", file=sys.stderr)
    print(f"{built.folder}: {_size(built.size)}, {built.mass:.4g} kg")
    print(f"in a scenario: twin: {{library: {{{arguments.name}: {built.folder.resolve()}}}}}")
    return 0


def _built(arguments: argparse.Namespace) -> BuiltAsset:
    """Build from what the source is: a folder of frames, predictions or a mesh.

    Refuse options of another kind of source.
    """
    from twin_diagram.assets.building.from_frames import build_from_frames, build_from_predictions
    from twin_diagram.assets.building.from_mesh import build_from_mesh

    source, name, library = arguments.source, arguments.name, arguments.library
    mass, density, masks, again = arguments.mass, arguments.density, arguments.masks, arguments.replace
    frames, predictions = source.is_dir(), source.suffix.lower() == ".npz"

    if (frames or predictions) and arguments.unit != "m":
        raise AssetError(f"--unit {arguments.unit}: is of a mesh; frames are in mm, predictions scaled by --cube-edge")
    if arguments.cube_edge is not None and not predictions:
        raise AssetError(f"--cube-edge {arguments.cube_edge:g}: scales predictions (.npz) alone; {source} has a unit")
    if arguments.root is not None and (frames or predictions):
        raise AssetError(f"--root {arguments.root}: is of a mesh; {source} names no files")
    if frames:
        return build_from_frames(source, name, library, mass, density, masks, again, say_beside)
    if predictions:
        if arguments.cube_edge is None:
            raise AssetError(f"{source}: predictions have no unit; tell --cube-edge [m] of a green cube in them")
        return build_from_predictions(
            source, name, library, arguments.cube_edge, mass, density, masks, again, say_beside
        )
    if masks is not None:
        raise AssetError(f"--masks {masks}: masks are of frames; {source} is a mesh")
    return build_from_mesh(source, name, library, mass, density, arguments.unit, again, arguments.root, say_beside)


def _size(lengths: Iterable[float]) -> str:
    return " × ".join(f"{x * 1e3:.4g}" for x in lengths) + " mm"


def _entries(library: Path) -> list[LibraryEntry]:
    """Return what a library holds, of one that is there; that it is empty is said."""
    from twin_diagram.assets.library import entries

    if not library.is_dir():
        raise AssetError(f"--library {library}: no such folder")
    found = entries(library)
    if not found:
        print(f"note: {library} holds no asset", file=sys.stderr)
    return found


def _list(arguments: argparse.Namespace) -> int:
    for entry in _entries(arguments.library):
        if entry.asset is None or entry.extent is None:
            print(f"warning: {entry.name} is corrupt and left out: {entry.wrong}", file=sys.stderr)
        else:
            pieces = len(entry.asset.convex_pieces)
            print(f"{entry.name}: {_size(entry.extent)}, {entry.asset.mass:.4g} kg, in {pieces} convex pieces")
    return 0


def _check(arguments: argparse.Namespace) -> int:
    from twin_diagram.assets.library import entry
    from twin_diagram.assets.same_thing import told

    found = _entries(arguments.library) if arguments.name is None else [entry(arguments.library, arguments.name)]
    corrupt = [one for one in found if one.wrong is not None]
    for one in found:
        if one.wrong is None:
            print(f"{one.name}: whole")
    for line in told({one.name: one.asset for one in found if one.asset is not None}):
        print(line, file=sys.stderr)
    if corrupt:
        raise AssetError("; ".join(f"{one.name} is corrupt: {one.wrong}" for one in corrupt))
    return 0


def _improve(arguments: argparse.Namespace) -> int:
    from twin_diagram.assets.building.improve import improve_pieces

    print("taking it apart with CoACD, at low priority; Ctrl-C leaves it as it is", file=sys.stderr, flush=True)
    done = improve_pieces(arguments.name, arguments.library, arguments.limit)
    before, after = (f"{1e6 * volume:.4g} cm³" for volume in (done.before, done.after))
    if done.taken:
        print(f"{done.folder}: {done.pieces} convex pieces hold it in {after}, before in {before}")
    else:
        print(f"{done.folder}: left as it is: {done.why}" + (f" ({after}, its own {before})" if done.after > 0 else ""))
    return 0


def _remove(arguments: argparse.Namespace) -> int:
    from twin_diagram.assets.library import remove

    left = remove(arguments.library, arguments.name)
    print(f"{arguments.library / arguments.name}: removed" + (f", except for {', '.join(left)}" if left else ""))
    return 0
