"""How large things come out whose underside no view can see, and what is told of it: prints a table, worst thing last.

`python sims/benchmarks/open_below.py [--views 40 20 8] [--things plate lid …] [--first 0] [--seeds 1] [--rings 35 55]`.
Flat things, things open below, with legs or flaps, and beside them closed ones that must not be told worse. Pictures
are those of `rendered_views` (D415's noise, told poses 2 mm / 0.2° off). The truth is in the scorer alone. Of volume,
the centre's height and the worst moment it prints by how much they are off and what is told, as a share of the truth
(the height: in mm), and how many times what is told that is.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from rendered_views import TrueObject, pictures, write_scene

from twin_diagram.assets.building.from_frames import build_from_frames
from twin_diagram.assets.description import read_spec
from twin_diagram.native import import_open3d
from twin_diagram.runtime.threads import one_thread
from twin_diagram.signals.arrays import Array

Profile = Sequence[tuple[float, float]]
STEP = 0.0006
"""Edge of the cells by which a truth is counted [m]."""


def lathed(*profile: tuple[float, float]) -> trimesh.Trimesh:
    """Return what a closed line of radius and height [mm] holds, turned about z."""
    return trimesh.creation.revolve(np.array([*profile, profile[0]]) / 1000, sections=96)


def block(x: float, y: float, z: float, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    """Return a box whose foot's middle is at a place [mm]."""
    made = trimesh.creation.box((x / 1000, y / 1000, z / 1000))
    made.apply_translation(np.array([at[0], at[1], at[2] + z / 2]) / 1000)
    return made


def shell(outer: Profile, wall: float) -> trimesh.Trimesh:
    """Return a wall below a line of radius and height [mm], from its top's middle down to the ground."""
    top, wide = outer[0][1], outer[-1][0]
    inner = [(max(0.0, r - wall), max(0.0, z - wall * (1 if r < 0.97 * wide else 0))) for r, z in outer]
    inner[0] = (0.0, top - wall)
    return lathed(*outer, *inner[::-1])


def frustum(bottom: tuple[float, float], top: tuple[float, float], low: float, high: float) -> trimesh.Trimesh:
    """Return the body between two rectangles [mm]."""
    corners = [
        [sx * a / 2, sy * b / 2, z] for (a, b), z in ((bottom, low), (top, high)) for sx in (-1, 1) for sy in (-1, 1)
    ]
    return trimesh.convex.convex_hull(np.array(corners) / 1000)


def flap(length: float, along: float, out: float, high: float, turn: float) -> trimesh.Trimesh:
    """Return a carton's flap that hangs outwards from a rim, 35° below level [mm, rad]."""
    made = block(length, along, 3.0, (length / 2, 0.0, -3.0))
    tilt = trimesh.transformations.rotation_matrix(np.radians(35.0), [0, 1, 0])
    made.apply_transform(tilt)
    made.apply_translation(np.array([out, 0.0, high]) / 1000)
    made.apply_transform(trimesh.transformations.rotation_matrix(turn, [0, 0, 1]))
    return made


def carton() -> list[trimesh.Trimesh]:
    """Return a carton without a lid, whose four flaps hang out."""
    x, y, h, t = 120.0, 90.0, 100.0, 3.0
    walls = [block(t, y, h, (s * (x - t) / 2, 0, 0)) for s in (-1, 1)]
    walls += [block(x, t, h, (0, s * (y - t) / 2, 0)) for s in (-1, 1)]
    flaps = [flap(45.0, y, x / 2, h, turn) for turn in (0.0, np.pi)]
    flaps += [flap(40.0, x, y / 2, h, turn) for turn in (np.pi / 2, -np.pi / 2)]
    return [block(x, y, t), *walls, *flaps]


def tray() -> list[trimesh.Trimesh]:
    """Return a tray with a floor of 3 mm."""
    x, y, h, t = 220.0, 150.0, 25.0, 3.0
    walls = [block(t, y, h, (s * (x - t) / 2, 0, 0)) for s in (-1, 1)]
    return [block(x, y, t), *walls, *(block(x, t, h, (0, s * (y - t) / 2, 0)) for s in (-1, 1))]


def mug() -> list[trimesh.Trimesh]:
    """Return a mug with a handle and a recess below."""
    body = lathed((0, 4), (34, 4), (34, 0), (40, 0), (40, 95), (36, 95), (36, 8), (0, 8))
    path = [(38 + 26 * np.sin(a), 48 + 28 * np.cos(a)) for a in np.linspace(0, np.pi, 13)]
    handle = [
        trimesh.creation.cylinder(0.005, segment=np.array([[a[0], 0, a[1]], [b[0], 0, b[1]]]) / 1000, sections=16)
        for a, b in pairwise(path)
    ]
    return [body, *handle]


def stool() -> list[trimesh.Trimesh]:
    """Return a seat on four legs."""
    seat = lathed((0, 80), (55, 80), (55, 92), (0, 92))
    return [seat, *(block(12, 12, 82, (x, y, 0)) for x in (-32, 32) for y in (-32, 32))]


def ring() -> trimesh.Trimesh:
    """Return a ring that lies."""
    return lathed(*((40 + 9 * np.cos(a), 9 + 9 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 32, endpoint=False)))


BOWL = [(0, 62), (22, 62), (22, 58), (40, 50), (58, 34), (68, 16), (72, 0)]
CUP = [(0, 95), (29, 95), (31, 92), (40, 0)]
LID = [(0, 42), (13, 42), (14, 24), (35, 22), (70, 14), (78, 10), (78, 0)]
THINGS = {
    "plate": lambda: [
        lathed((0, 3), (52, 3), (52, 0), (57, 0), (60, 3.5), (110, 20), (110, 24), (62, 8.5), (55, 7.5), (0, 7.5))
    ],
    "bowl, turned over": lambda: [shell(BOWL, 4.0)],
    "cup, turned over": lambda: [shell(CUP, 2.5)],
    "lid": lambda: [shell([*LID[:2], (13, 24), *LID[3:]], 3.0)],
    "tray": tray,
    "box with flaps": carton,
    "stool": stool,
    "ring": lambda: [ring()],
    "L": lambda: [block(110, 40, 20), block(25, 40, 85, (-42.5, 0, 0))],
    "arch": lambda: [block(120, 40, 15, (0, 0, 55)), *(block(20, 40, 56, (x, 0, 0)) for x in (-50, 50))],
    "box": lambda: [block(110, 70, 60)],
    "flat box": lambda: [block(150, 100, 28)],
    "can": lambda: [lathed((0, 4), (30, 4), (30, 0), (34, 0), (34, 102), (0, 102))],
    "tuna can": lambda: [lathed((0, 2), (38, 2), (38, 0), (43, 0), (43, 33), (0, 33))],
    "mug": mug,
    "bottle": lambda: [lathed((0, 0), (33, 0), (36, 4), (36, 110), (14, 150), (14, 190), (0, 190))],
    "soap": lambda: [trimesh.creation.icosphere(4).apply_scale((0.045, 0.03, 0.02)).apply_translation((0, 0, 0.019))],
    "weight": lambda: [lathed((0, 0), (45, 0), (38, 30), (15, 38), (15, 55), (0, 55))],
}
"""Meshes of which each is closed; where they overlap they count once."""


def pictured(name: str) -> TrueObject:
    """Return a thing as it is pictured, of one colour."""
    whole = trimesh.util.concatenate(THINGS[name]())
    whole.apply_translation([0, 0, -whole.bounds[0, 2]])
    vertices = np.asarray(whole.vertices)
    grey = np.full((4, 4, 3), 170, np.uint8)
    return TrueObject(name, vertices, np.asarray(whole.faces), np.full((len(vertices), 2), 0.5), grey)


def truth(name: str) -> tuple[float, Array, Array]:
    """Return the volume [m³], centre (3,) [m] and second moments (3, 3) about it [m⁵], counted by cells."""
    o3d = import_open3d()
    meshes = THINGS[name]()
    whole = trimesh.util.concatenate(meshes)
    axes = [np.arange(a + STEP / 2, b, STEP) for a, b in zip(*whole.bounds, strict=True)]
    inside = np.zeros([len(axis) for axis in axes], bool)
    for mesh in meshes:
        scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
        scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(faces))
        ends = [np.searchsorted(axis, mesh.bounds[:, k]) for k, axis in enumerate(axes)]
        own = [axis[slice(*end)] for axis, end in zip(axes, ends, strict=True)]
        grid = np.stack(np.meshgrid(*own, indexing="ij"), axis=-1).astype(np.float32)
        inside[tuple(slice(*end) for end in ends)] |= scene.compute_occupancy(o3d.core.Tensor(grid)).numpy() > 0
    at = np.argwhere(inside)
    points = np.stack([axis[i] for axis, i in zip(axes, at.T, strict=True)], axis=1) - [0.0, 0.0, whole.bounds[0, 2]]
    centre = points.mean(axis=0)
    aside = points - centre
    return len(points) * STEP**3, centre, aside.T @ aside * STEP**3


@one_thread()
def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--things", nargs="+", default=list(THINGS))
    parser.add_argument("--views", nargs="+", type=int, default=[40, 20, 8])
    parser.add_argument("--noise", type=float, default=0.0015, help="RMS at 1 m [m]")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--rings", nargs="+", type=float, default=[], help="elevations [deg], instead of a spiral")
    args = parser.parse_args()
    print("thing             views seed | volume %  told times | height mm  told times | moment %  told times")
    ratios: dict[str, list[tuple[float, ...]]] = {}
    for name in args.things:
        item, (volume, centre, second) = pictured(name), truth(name)
        moments = np.diag(np.trace(second) * np.eye(3) - second)
        for views in args.views:
            for seed in range(args.first, args.first + args.seeds):
                shots = pictures(item, views, args.noise, seed=seed, elevations=args.rings)
                with tempfile.TemporaryDirectory() as aside:
                    scene = write_scene(Path(aside) / "scene", shots, False)
                    built = build_from_frames(scene, "built", Path(aside) / "library", density=1000.0)
                    spec = read_spec(built.folder)
                found, std = (float(x or np.nan) / volume * 100 for x in (spec.volume, spec.volume_std))
                high = (np.array(spec.origin)[2] - centre[2]) * 1000
                high_std = float((spec.centre_std or [np.nan] * 3)[2]) * 1000
                own = np.array(spec.inertia)[:3] / 1000.0
                own_std = np.array(spec.inertia_std or [np.nan] * 6)[:3] / 1000.0
                worst = int(np.argmax(np.abs(own - moments) / own_std))
                off, told = ((x / moments[worst]) * 100 for x in ((own - moments)[worst], own_std[worst]))
                times = (abs(found - 100) / std, abs(high) / high_std, abs(off) / told)
                ratios.setdefault(name, []).append(times)
                print(
                    f"{name:17} {views:5} {seed:4} | {found - 100:+8.1f} {std:5.1f} {times[0]:5.1f} | {high:+9.2f} "
                    f"{high_std:5.2f} {times[1]:5.1f} | {off:+8.1f} {told:5.1f} {times[2]:5.1f}",
                    flush=True,
                )
    for name, all_times in sorted(ratios.items(), key=lambda one: np.max(one[1])):
        print(f"{name:17} at most {', '.join(f'{x:.1f}' for x in np.max(all_times, axis=0))} times what is told")


if __name__ == "__main__":
    main()
