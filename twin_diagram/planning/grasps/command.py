"""The command `twin-diagram grasps`. Cheap to import, as the command line is."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin_diagram.runtime.command_parser import add_command

if TYPE_CHECKING:
    from twin_diagram.planning.grasps.gripper import Gripper
    from twin_diagram.planning.grasps.known_object import KnownObject
    from twin_diagram.planning.grasps.proposal import Grasps


def add_grasps_command(commands: Any) -> None:
    """Add the command that proposes grasps of an object."""
    grasps = add_command(commands, "grasps", "propose and rank grasps of an asset or a mesh: table, JSON, a page")
    grasps.add_argument(
        "source",
        type=Path,
        metavar="ASSET_OR_MESH",
        help="the folder of an asset, the name of one that comes along (objects/mug), or a mesh: .obj, .stl, .ply (z "
        "upwards), .glb, .gltf (y upwards) or .dae",
    )
    grasps.add_argument(
        "--gripper",
        default="panda_hand",
        metavar="NAME_OR_FILE",
        help="panda_hand, wsg50, a YAML file with a gripper's figures, or the URDF, SDF or MJCF of an arm with a hand "
        "(default: %(default)s)",
    )
    grasps.add_argument("--count", type=int, default=10, help="of grasps (default: %(default)s)")
    grasps.add_argument("--seed", type=int, default=0, help="of what is drawn (default: %(default)s)")
    grasps.add_argument("--mass", type=float, help="[kg], so that the weight's torque counts; an asset has its own")
    grasps.add_argument("--unit", default="m", help="of a mesh: m, cm, mm or in (default: %(default)s)")
    grasps.add_argument("--table", action="store_true", help="the object stands on a table, z upwards: keep off it")
    grasps.add_argument("--json", action="store_true", help="print JSON in place of the table")
    grasps.add_argument("--out", type=Path, metavar="DIR", help="write grasps.json and grasps.html, a page to look at")
    grasps.set_defaults(command=_grasps)


def _grasps(arguments: argparse.Namespace) -> int:
    from twin_diagram.planning.grasps.kept_grasps import grasps_of
    from twin_diagram.planning.grasps.known_object import read_known
    from twin_diagram.planning.grasps.page import page
    from twin_diagram.planning.grasps.proposal import Wanted
    from twin_diagram.planning.grasps.target import GraspError
    from twin_diagram.runtime import atomic_file
    from twin_diagram.runtime.output_place import why_not

    Wanted(arguments.count, arguments.seed)  # refused before anything is read
    if arguments.out is not None and (why := why_not(arguments.out, folder=True)):
        raise GraspError(f"--out {arguments.out}: {why}")
    gripper = _gripper(arguments.gripper)
    known = read_known(arguments.source, arguments.unit, arguments.mass)
    grasps = grasps_of(known, gripper, count=arguments.count, seed=arguments.seed, table=arguments.table)
    said = _said(known, gripper, grasps, arguments)
    text = json.dumps(said, indent=1)
    if arguments.out is not None:
        with atomic_file.folder(arguments.out, parts=("grasps.json", "grasps.html")) as aside:
            (aside / "grasps.json").write_text(text + "\n", encoding="utf-8")
            (aside / "grasps.html").write_text(page(known, gripper, grasps), encoding="utf-8")
    print(text if arguments.json else _table(known, gripper, grasps, arguments.out))
    return 0


def _gripper(said: str) -> Gripper:
    """Return the gripper that the command names, as a name or as a file."""
    from twin_diagram.planning.grasps.gripper import SHIPPED, gripper_of

    path = Path(said)
    if said in SHIPPED or path.suffix.lower() not in (".urdf", ".sdf", ".xml") or not path.is_file():
        return gripper_of(said)
    from twin_diagram.planning.grasps.own_gripper import gripper_of_description

    return gripper_of_description(path)


def _said(known: KnownObject, gripper: Gripper, grasps: Grasps, arguments: argparse.Namespace) -> dict[str, Any]:
    """Return all that is known of the grasps, for programs."""
    from dataclasses import asdict

    from twin_diagram.planning.grasps.kept_grasps import as_json

    lists = as_json(grasps)
    approach = grasps.approach.tolist()
    each = [
        {
            "rank": k + 1,
            "score": lists["score"][k],
            "terms": {name: term[k] for name, term in lists["terms"].items()},
            "width": lists["width"][k],
            "X_OG": {"rotation_wxyz": lists["poses"][k][:4], "translation": lists["poses"][k][4:]},
            "approach_O": approach[k],
            "contacts_O": lists["contacts"][k],
        }
        for k in range(len(grasps))
    ]
    return {
        "object": known.name,
        "frame_O": "of the asset" if known.folder is not None else "of the mesh, in m, z upwards",
        "frame_G": "tool frame: z along the approach, y along the closing axis, origin between the finger tips",
        "gripper": asdict(gripper),
        "seed": arguments.seed,
        "mass": known.mass,
        "table": arguments.table,
        "grasps": each,
        "no_grasp": grasps.why_empty(),
        "left_out": grasps.reasons,
    }


def _table(known: KnownObject, gripper: Gripper, grasps: Grasps, out: Path | None) -> str:
    """Return what people read."""
    if not len(grasps):
        lines = [f"{known.name}, {gripper.name}: no grasp: {grasps.why_empty()}"]
    else:
        lines = [
            f"{known.name}, {gripper.name}: {len(grasps)} grasps (score: lower is better; approach, place: in O)",
            "rank  score  width [mm]  approach               place of G [mm]",
        ]
        for k, (a, p) in enumerate(
            zip(grasps.approach.round(2) + 0.0, (1e3 * grasps.poses[:, 4:]).round(1) + 0.0, strict=True)
        ):
            lines.append(
                f"{k + 1:4}  {grasps.score[k]:5.3f}  {1e3 * grasps.width[k]:10.1f}  "
                f"{a[0]:6.2f} {a[1]:6.2f} {a[2]:6.2f}  {p[0]:7.1f} {p[1]:7.1f} {p[2]:7.1f}"
            )
    if out is not None:
        lines.append(f"see {out / 'grasps.html'}")
    return "\n".join(lines)
