"""The command `twin-diagram assets`: build, list, check, remove. Cheap to import, as the command line is."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from twin_diagram.errors import AssetError


def add_asset_commands(commands: Any) -> None:
    """Add the commands about objects."""
    assets = commands.add_parser("assets", help="build, list, check and remove the known objects of a library")
    ways = assets.add_subparsers(metavar="WHAT", required=True)

    build = ways.add_parser("build", help="make an asset of pictures or a mesh, for use in a scenario under twin.library")
    build.add_argument(
        "source",
        type=Path,
        metavar="SOURCE",
        help="a folder of posed RGB-D frames (BOP), or a mesh: .obj, .stl (z upwards), .glb or .gltf (y upwards)",
    )
    build.add_argument("--name", required=True, help="of the asset: letters, digits, '_', '-'")
    build.add_argument("--mass", type=float, help="[kg]")
    build.add_argument("--density", type=float, help="[kg/m³], instead of a mass (default: water's)")
    build.add_argument("--masks", type=Path, metavar="D", help="folder of masks, beside or instead of the frames' own")
    build.add_argument("--unit", default="m", help="of the mesh: m, cm, mm or in (default: %(default)s)")
    build.add_argument("--replace", action="store_true", help="write an asset of that name anew")
    build.set_defaults(command=_build)

    listed = ways.add_parser("list", help="what is in a library; what is corrupt is named and left out")
    listed.set_defaults(command=_list)
    check = ways.add_parser("check", help="read every file of an asset, or of all; exits with 2 where one is corrupt")
    check.add_argument("name", nargs="?", help="without it: all")
    check.set_defaults(command=_check)
    remove = ways.add_parser("remove", help="take an asset out of a library")
    remove.add_argument("name")
    remove.set_defaults(command=_remove)
    for way in (build, listed, check, remove):
        way.add_argument("--library", required=True, type=Path, metavar="DIR", help="the folder of assets")


def _build(arguments: argparse.Namespace) -> int:
    from twin_diagram.assets.building.from_frames import build_from_frames
    from twin_diagram.assets.building.from_mesh import build_from_mesh

    source, name, library = arguments.source, arguments.name, arguments.library
    mass, density = arguments.mass, arguments.density
    if source.is_dir():
        if arguments.unit != "m":
            raise AssetError(f"--unit {arguments.unit}: is of a mesh; frames say theirs in depth_scale and cam_t_w2c")
        built = build_from_frames(
            source, name, library, mass, density, arguments.masks, arguments.replace, lambda text: print(text, file=sys.stderr)
        )
    elif arguments.masks is not None:
        raise AssetError(f"--masks {arguments.masks}: masks are of frames; {source} is none of a folder")
    else:
        built = build_from_mesh(source, name, library, mass, density, arguments.unit, arguments.replace)
    for note in built.notes:
        print(f"note: {note}", file=sys.stderr)
    print(f"{built.folder}: {_size(built.size)}, {built.mass:.4g} kg")
    print(f"in a scenario: twin: {{library: {{{arguments.name}: {built.folder.resolve()}}}}}")
    return 0


def _size(lengths: Iterable[float]) -> str:
    return " × ".join(f"{x * 1e3:.4g}" for x in lengths) + " mm"


def _list(arguments: argparse.Namespace) -> int:
    from twin_diagram.assets.library import entries

    for entry in entries(arguments.library):
        if entry.asset is None or entry.extent is None:
            print(f"warning: {entry.name} is corrupt and left out: {entry.wrong}", file=sys.stderr)
        else:
            pieces = len(entry.asset.convex_pieces)
            print(f"{entry.name}: {_size(entry.extent)}, {entry.asset.mass:.4g} kg, in {pieces} convex pieces")
    return 0


def _check(arguments: argparse.Namespace) -> int:
    from twin_diagram.assets.library import entries, entry

    found = entries(arguments.library) if arguments.name is None else [entry(arguments.library, arguments.name)]
    corrupt = [one for one in found if one.wrong is not None]
    for one in found:
        if one.wrong is None:
            print(f"{one.name}: whole")
    if corrupt:
        raise AssetError("; ".join(f"{one.name} is corrupt: {one.wrong}" for one in corrupt))
    return 0


def _remove(arguments: argparse.Namespace) -> int:
    from twin_diagram.assets.library import remove

    left = remove(arguments.library, arguments.name)
    print(f"{arguments.library / arguments.name}: removed" + (f", except for {', '.join(left)}" if left else ""))
    return 0
